#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <opencv2/core.hpp>

namespace tagdock {

struct GigeServerSettings {
  std::string address = "127.0.0.1";  ///< numeric; an address that the loopback device carries
  std::string serial = "TD000001";    ///< at most 15 characters
  std::string model = "Simulated";
  std::string user_name = "dock";
  int width = 1280;  ///< of the sensor [px]
  int height = 1024;
  double exposure_us = 5000.0;  ///< until a client sets it
  double gain = 0.0;            ///< dB, until a client sets it
  double frame_rate = 25.0;     ///< 1/s, until a client sets it
};

/// A picture for the wire.
struct ServedFrame {
  cv::Mat1b gray;            ///< the whole sensor; must not be written any more
  std::uint64_t number = 0;  ///< the wire carries number % 65535 + 1; a gap is a lost frame to the client
  std::chrono::nanoseconds camera_time{0};  ///< mid-exposure by the camera's clock; reaches the client unchanged
};

/// What the client has set, as of the last turn of the stream. Before the first client: the settings of the server.
struct ServedSettings {
  double exposure_us = 0.0;
  double gain = 0.0;        ///< dB
  double frame_rate = 0.0;  ///< 1/s
  cv::Rect region;          ///< what of the sensor is sent
  bool streaming = false;   ///< a client has the stream running
};

/// A GigE Vision camera on the loopback device that shows what a producer publishes: Aravis' own camera server with our
/// registers. Frames go out when a new one was published (looked for every 5 ms), and no faster than the client's frame
/// rate; a frame that was replaced before its turn is never sent.
/// It also answers discovery broadcasts that come in from other interfaces (Aravis binds 255.255.255.255); a private
/// network namespace rules that out.
class GigeServer {
 public:
  /// @throws Failure (camera) when another simulator holds the address, or the loopback device does not carry it;
  ///         Failure (usage) for an address outside 127.0.0.0/8
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

  // Faults, for tests and demonstrations. Any thread.
  void lose_packets(double ratio);  ///< each packet of the stream is lost with this probability, 0 to 1
  void silence(bool on);            ///< the stream stops; control and discovery still answer
  void stop();                      ///< the camera dies; for good

 private:
  class Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace tagdock
