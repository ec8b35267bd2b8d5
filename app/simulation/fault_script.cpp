#include "app/simulation/fault_script.h"

#include <charconv>
#include <cmath>
#include <sstream>
#include <thread>
#include <vector>

#include "app/failure.h"
#include "app/simulation/gige_server.h"
#include "app/simulation/malformed.h"

namespace tagdock {
namespace {

using What = FaultCommand::What;
enum class Argument { none, share, on_off, milliseconds, count };
struct Word {
  const char* name;
  What what;
  Argument argument;
  const char* help;
};
constexpr Word words[] = {
    {"lose", What::lose, Argument::share,
     "lose SHARE          each packet of the stream is lost with this probability, 0 to 1"},
    {"freeze", What::freeze, Argument::on_off, "freeze on|off       new frames show the old picture"},
    {"stale", What::stale, Argument::on_off, "stale on|off        the time stamps stand still"},
    {"jump", What::jump, Argument::milliseconds,
     "jump MS             the camera's clock is set forth (or back, if negative)"},
    {"size", What::size, Argument::on_off, "size on|off         frames come with half the lines that were agreed on"},
    {"silence", What::silence, Argument::on_off, "silence on|off      no frames; control and discovery still answer"},
    {"malformed", What::malformed, Argument::count,
     "malformed N [RATE]  N malformed datagrams to the client's stream port, RATE a second"},
    {"die", What::die, Argument::none, "die                 the camera is gone, without a word to its client"},
    {"status", What::status, Argument::none, "status              one line: frames sent, what the client has set"},
    {"quit", What::quit, Argument::none, "quit                the end"},
};

bool number(const std::string& text, double& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && std::isfinite(value);
}

}  // namespace

std::string fault_words() {
  std::string text;
  for (const Word& word : words) text += std::string("  ") + word.help + "\n";
  return text;
}

FaultCommand parse_fault(const std::string& text) {
  const auto refuse = [&](const std::string& why) {
    throw Failure(ExitCode::usage, "fault '" + text + "': " + why + "\n" + fault_words() +
                                       "each may begin with the seconds after which it happens: 5 lose 0.01");
  };
  std::istringstream stream(text);
  std::vector<std::string> parts;
  for (std::string part; stream >> part;) parts.push_back(part);
  FaultCommand command;
  if (double seconds = 0.0; !parts.empty() && number(parts.front(), seconds)) {
    if (seconds < 0.0 || seconds > 1e6) refuse("the time must be between 0 and 1e6 s");
    command.at = std::chrono::nanoseconds(std::llround(1e9 * seconds));
    parts.erase(parts.begin());
  }
  if (parts.empty()) refuse("no command");
  for (const Word& word : words) {
    if (parts.front() != word.name) continue;
    command.what = word.what;
    const std::size_t most = word.argument == Argument::none ? 1 : word.argument == Argument::count ? 3 : 2;
    if (parts.size() > most || (word.argument != Argument::none && parts.size() < 2))
      refuse("must be: " + std::string(word.help));
    if (word.argument == Argument::on_off) {
      if (parts[1] != "on" && parts[1] != "off") refuse("'" + parts[1] + "' must be on or off");
      command.value = parts[1] == "on" ? 1.0 : 0.0;
    } else if (word.argument != Argument::none && !number(parts[1], command.value)) {
      refuse("'" + parts[1] + "' must be a number");
    }
    if (word.argument == Argument::share && (command.value < 0.0 || command.value > 1.0))
      refuse("the share must be between 0 and 1");
    if (word.argument == Argument::milliseconds && std::abs(command.value) > 1e9)
      refuse("the jump must be within 1e9 ms");
    if (word.argument == Argument::count && (command.value < 1.0 || command.value > 1e7))
      refuse("the number of datagrams must be between 1 and 1e7");
    if (parts.size() == 3 && (!number(parts[2], command.rate) || command.rate < 1.0 || command.rate > 1e6))
      refuse("the rate must be between 1 and 1e6 a second");
    return command;
  }
  refuse("'" + parts.front() + "' is not known");
  return command;
}

void apply(const FaultCommand& command, GigeServer& server, std::uint64_t seed) {
  GigeFaults faults = server.faults();
  const bool on = command.value != 0.0;
  switch (command.what) {
    case What::lose:
      faults.lost_packets = command.value;
      break;
    case What::freeze:
      faults.frozen = on;
      break;
    case What::stale:
      faults.stale_times = on;
      break;
    case What::jump:
      faults.time_jump += std::chrono::nanoseconds(std::llround(1e6 * command.value));
      break;
    case What::size:
      faults.wrong_size = on;
      break;
    case What::silence:
      faults.silent = on;
      break;
    case What::malformed: {
      MalformedDatagrams datagrams(seed);
      const auto begin = std::chrono::steady_clock::now();
      for (double sent = 0.0; sent < command.value; ++sent) {
        const std::vector<std::uint8_t> datagram = datagrams.next();
        server.send_to_stream(datagram.data(), datagram.size());
        std::this_thread::sleep_until(begin +
                                      std::chrono::nanoseconds(std::llround(1e9 * (sent + 1.0) / command.rate)));
      }
      return;
    }
    case What::die:
    case What::status:
    case What::quit:
      return;
  }
  server.faults(faults);
}

}  // namespace tagdock
