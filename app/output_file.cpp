#include "app/output_file.h"

#include <fstream>

#include "app/failure.h"

namespace tagdock {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void refuse(const std::string& option, const fs::path& file, const std::string& why) {
  throw Failure(ExitCode::usage, option + " " + file.string() + ": " + why);
}

}  // namespace

void check_not_an_input(const std::string& option, const fs::path& file, const std::vector<std::string>& inputs) {
  std::error_code error;
  for (const std::string& input : inputs)
    if (!file.empty() && !input.empty() && fs::equivalent(file, input, error))
      refuse(option, file, "is what is read; name another file");
}

void check_outputs(const std::vector<std::pair<std::string, fs::path>>& outputs,
                   const std::vector<std::string>& inputs) {
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const auto& [option, file] = outputs[i];
    if (file.empty()) continue;
    check_not_an_input(option, file, inputs);
    std::error_code error;
    const fs::path place = fs::weakly_canonical(file, error);
    // What is no file keeps nothing: /dev/null may take all of them.
    if (fs::exists(file, error) && !fs::is_regular_file(file, error)) continue;
    for (std::size_t k = 0; k < i; ++k)
      if (!outputs[k].second.empty() && fs::weakly_canonical(outputs[k].second, error) == place)
        refuse(option, file, "is what " + outputs[k].first + " writes; name another file");
  }
  for (const auto& [option, file] : outputs) check_writable(option, file);
}

std::vector<std::string> files_in(const fs::path& folder) {
  std::vector<std::string> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) files.push_back(entry.path().string());
  return files;
}

void check_new(const std::string& option, const fs::path& file) {
  std::error_code error;
  if (!file.empty() && fs::is_regular_file(file, error)) refuse(option, file, "is there already; name a new file");
}

void check_writable(const std::string& option, const fs::path& file) {
  if (file.empty()) return;
  std::error_code error;
  const bool was_there = fs::exists(file, error);
  // Who reads a pipe would take the end of this trial for the end of the result.
  if (was_there && !fs::is_regular_file(file, error) && !fs::is_directory(file, error)) return;
  if (!std::ofstream(file, std::ios::binary | std::ios::app)) refuse(option, file, "cannot be written");
  if (!was_there) fs::remove(file, error);
}

void make_result_folder(const std::string& option, const fs::path& folder, const std::vector<std::string>& results) {
  if (folder.empty()) return;
  std::error_code error;
  for (const std::string& result : results)
    if (fs::exists(folder / result, error)) refuse(option, folder, "has a " + result + " already; name a new folder");
  fs::create_directories(folder, error);
  if (!fs::is_directory(folder, error)) refuse(option, folder, "cannot be made");
}

}  // namespace tagdock
