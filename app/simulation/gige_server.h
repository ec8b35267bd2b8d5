#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

namespace tagdock {

struct GigeServerSettings {
  std::string address = "127.0.0.1";  ///< numeric, inside 127.0.0.0/8
  std::string serial = "TD000001";    ///< at most 15 characters
  std::string model = "Simulated";
  std::string user_name = "dock";
  int width = 1280;  ///< of the sensor [px]
  int height = 1024;
  double exposure_us = 5000.0;  ///< until a client sets it
  double gain = 0.0;            ///< dB, until a client sets it
  double frame_rate = 25.0;     ///< 1/s, until a client sets it
  bool resend = false;          ///< offers to send lost packets again, as good cameras do
};

/// A picture for the wire.
struct ServedFrame {
  cv::Mat1b gray;            ///< the whole sensor; must not be written any more
  std::uint64_t number = 0;  ///< the wire carries number % 65535 + 1; a gap is a lost frame to the client
  std::chrono::nanoseconds camera_time{0};  ///< mid-exposure by the camera's clock; reaches the client unchanged
  std::optional<double> exposure_us = {};   ///< that it was taken with; without, what the client has set
  std::optional<double> gain = {};          ///< dB
};

/// What the client has set. Before the first client: the settings of the server.
struct ServedSettings {
  double exposure_us = 0.0;
  double gain = 0.0;        ///< dB
  double frame_rate = 0.0;  ///< 1/s
  cv::Rect region;          ///< what of the sensor is sent
  bool streaming = false;   ///< a client has the stream running
};

/// What a camera can do wrong on the wire. Everything is off by default and can be changed while it streams.
struct GigeFaults {
  double lost_packets = 0.0;              ///< each packet of the stream is lost with this probability, 0 to 1
  bool silent = false;                    ///< the stream stops; control and discovery still answer
  bool frozen = false;                    ///< new frames with new numbers and times show the old picture
  bool stale_times = false;               ///< the time stamps stand still
  std::chrono::nanoseconds time_jump{0};  ///< added to every time stamp; a change of it is a jump of the camera's clock
  bool wrong_size = false;                ///< frames have half the lines that were agreed on

  bool operator==(const GigeFaults&) const = default;
};

/// A GigE Vision 1.2 camera on a loopback address that shows what a producer publishes: control (GVCP) and stream
/// (GVSP) by plain sockets, registers described in GenICam. A frame goes out when it was published, and no faster than
/// the client's frame rate; a frame that was replaced before its turn is never sent. Each frame is one burst of
/// packets, unless the client sets a packet delay.
/// It answers whoever asks at its address, and never a broadcast.
class GigeServer {
 public:
  /// @throws Failure (camera) when another simulator holds the address; Failure (usage) for an address outside
  ///         127.0.0.0/8
  explicit GigeServer(const GigeServerSettings& settings);
  ~GigeServer();
  GigeServer(const GigeServer&) = delete;
  GigeServer& operator=(const GigeServer&) = delete;

  /// Makes this the next frame to be sent. Any thread. @throws Failure (internal) if it is not of the sensor's size
  void publish(const ServedFrame& frame);

  /// What the client asked for, for the producer to follow. Any thread.
  [[nodiscard]] ServedSettings client() const;

  /// Frames handed to the wire so far, those with lost packets included. Any thread.
  [[nodiscard]] std::uint64_t sent() const;
  /// Packets that the client asked for once more and got. Any thread.
  [[nodiscard]] std::uint64_t sent_again() const;

  // Faults, for tests and demonstrations. Any thread.
  void faults(const GigeFaults& faults);
  [[nodiscard]] GigeFaults faults() const;
  void lose_packets(double ratio);  ///< as GigeFaults::lost_packets
  void silence(bool on);            ///< as GigeFaults::silent
  /// Sends one datagram of any content to the client's stream port; none is sent when no client streams.
  /// @return whether it was sent
  bool send_to_stream(const void* bytes, std::size_t size);
  void stop();  ///< the camera dies; for good

 private:
  class Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace tagdock
