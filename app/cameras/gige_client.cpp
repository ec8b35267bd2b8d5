#include "app/cameras/gige_client.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <future>
#include <mutex>
#include <sstream>
#include <thread>
#include <utility>
#include <vector>

#include <arv.h>

#include "app/cameras/clock_map.h"
#include "app/cameras/frame_counter.h"
#include "app/cameras/gvcp_probe.h"
#include "app/cameras/mailbox.h"
#include "app/cameras/receive_buffer.h"
#include "app/cameras/wire_format.h"
#include "app/failure.h"

namespace tagdock {

namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

constexpr milliseconds pop_timeout{20};          // how soon the grab thread sees that it shall end
constexpr milliseconds probe_timeout{50};        // an answer takes 0.2 ms; the rest is for a machine under load
constexpr milliseconds probe_period{50};         // while waiting for a camera
constexpr milliseconds patience_at_start{1500};  // a simulated camera may be starting in another process
constexpr milliseconds shortest_loss{250};       // 2.5 cm at 0.1 m/s
constexpr int periods_to_loss = 5;
constexpr int probes_to_loss = 2;
constexpr milliseconds silent_restart{600};  // a camera that answers but sends nothing is started again after this
constexpr milliseconds triggered_patience{2000};
constexpr milliseconds lease{3200};                // of a controller that died: heartbeat of 3 s, and a little
constexpr milliseconds patience_with_stream{300};  // letting a living camera go takes 5 ms, ten times that under load
constexpr milliseconds patience_with_dead{20000};  // letting a dead one go takes 7 s
constexpr int pool_size = 12;  // 3 in the stream, 1 in the mailbox, 1 in the loop, the rest for a recorder that lags

struct Unref {
  void operator()(gpointer object) const { g_object_unref(object); }
};
template <typename Object>
using Handle = std::unique_ptr<Object, Unref>;

/// Where a call of Aravis puts what went wrong.
class ArvError {
 public:
  ArvError() = default;
  ~ArvError() { g_clear_error(&error_); }
  ArvError(const ArvError&) = delete;
  ArvError& operator=(const ArvError&) = delete;
  GError** out() {
    g_clear_error(&error_);
    return &error_;
  }
  explicit operator bool() const { return error_ != nullptr; }
  [[nodiscard]] std::string text() const { return error_ != nullptr ? error_->message : ""; }

 private:
  GError* error_ = nullptr;
};

/// A frame as it came off the wire.
struct Grabbed {
  cv::Mat1b gray;
  std::uint64_t id = 0;
  nanoseconds camera_time{0};
  std::optional<double> exposure_us;  ///< of this frame, where the camera sends it along
  std::optional<double> gain;
};

enum class Pop { nothing, incomplete, good };

std::string describe(const CameraIdentity& identity) {
  return identity.vendor + " " + identity.model + " " + identity.serial;
}

/// One opened camera with its running stream; rebuilt from nothing after every loss, since Aravis never recovers.
class Connection {
 public:
  Connection(const GigeSettings& settings, const CameraIdentity& identity, const GigeClientHooks& hooks,
             const std::function<void(const char*)>& enter)
      : where_(identity.address) {
    arv_disable_interface("USB3Vision");  // or opening would look through the USB devices
    ArvError error;
    // A numeric loopback address: unicast to it only. Anything else would make Aravis ask a name service and broadcast.
    camera_.reset(arv_camera_new(where_.c_str(), error.out()));
    if (!camera_) fail("the camera at " + where_ + " answers, but cannot be opened", error);
    enter("claiming");
    claim();
    enter("configuring");
    // Before anything else: a camera whose last controller died may still stream to it, and never notice us.
    arv_camera_stop_acquisition(camera_.get(), error.out());
    configure(settings);
    actual_.identity = describe(identity);
    actual_.address = identity.address;
    start(settings, hooks);
  }

  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Takes 7 s when the camera is dead and has not been abandoned, 5 s when it has.
  ~Connection() {
    if (!abandoned_) arv_camera_stop_acquisition(camera_.get(), nullptr);
    stream_.reset();
    for (ArvBuffer* buffer : lent_) g_object_unref(buffer);
    parser_.reset();
    g_signal_handlers_disconnect_by_data(arv_camera_get_device(camera_.get()), &control_lost_);
    camera_.reset();
  }

  /// The camera is dead: do not talk to it more than Aravis insists on.
  void abandon() { abandoned_ = true; }

  [[nodiscard]] const CameraSettings& actual() const { return actual_; }
  [[nodiscard]] bool control_lost() const { return control_lost_; }

  /// Next buffer of the stream. Of one that is not complete nothing but its state and id are read: it may have no
  /// leader.
  Pop pop(Grabbed& grabbed, milliseconds timeout) {
    take_back();
    ArvBuffer* buffer =
        arv_stream_timeout_pop_buffer(stream_.get(), static_cast<guint64>(std::chrono::microseconds(timeout).count()));
    if (buffer == nullptr) return Pop::nothing;
    // Of a buffer that is not complete this is an older one's where the leader is missing; nothing else is read of it.
    grabbed.id = arv_buffer_get_frame_id(buffer);
    if (!good(buffer)) {
      arv_stream_push_buffer(stream_.get(), buffer);
      return Pop::incomplete;
    }
    grabbed.camera_time = nanoseconds(arv_buffer_get_timestamp(buffer));
    if (parser_) {
      grabbed.exposure_us = chunk(buffer, "ChunkExposureTime");
      grabbed.gain = chunk(buffer, "ChunkGain");
    }
    if (format_->bits_on_wire == 8) {
      grabbed.gray = memory(buffer).rowRange(0, actual_.height);
      lent_.push_back(buffer);
      return Pop::good;
    }
    const bool converted = narrow(buffer, grabbed.gray);
    arv_stream_push_buffer(stream_.get(), buffer);
    return converted ? Pop::good : Pop::incomplete;
  }

  /// Packets that were sent again because they were missed.
  [[nodiscard]] std::uint64_t resent() const {
    return arv_stream_get_info_uint64_by_name(stream_.get(), "n_resent_packets");
  }

  /// Within the camera's bounds; what it made of them is in actual(). A camera that refuses keeps what it has.
  void adjust(double exposure_us, double gain) {
    double low = 0.0, high = 0.0;
    ArvError error;
    arv_camera_get_exposure_time_bounds(camera_.get(), &low, &high, error.out());
    if (!error)
      arv_camera_set_exposure_time(camera_.get(), std::clamp(exposure_us, low, std::max(low, high)), error.out());
    if (!error) arv_camera_get_gain_bounds(camera_.get(), &low, &high, error.out());
    if (!error) arv_camera_set_gain(camera_.get(), std::clamp(gain, low, std::max(low, high)), error.out());
    const double exposure_made = arv_camera_get_exposure_time(camera_.get(), error.out());
    if (!error) actual_.exposure_us = exposure_made;
    const double gain_made = arv_camera_get_gain(camera_.get(), error.out());
    if (!error) actual_.gain = gain_made;
  }

  void trigger() { arv_camera_software_trigger(camera_.get(), nullptr); }

  /// Starts the stream of a camera that answers but sends nothing once more.
  void restart() {
    arv_camera_stop_acquisition(camera_.get(), nullptr);
    arv_camera_start_acquisition(camera_.get(), nullptr);
  }

 private:
  [[noreturn]] static void fail(const std::string& sentence, const ArvError& error) {
    throw Failure(ExitCode::camera, error ? sentence + ": " + error.text() : sentence);
  }

  ArvGvDevice* device() { return ARV_GV_DEVICE(arv_camera_get_device(camera_.get())); }

  /// Opening succeeds even when another program has the control; then every write would be dropped without a word.
  void claim() {
    if (arv_gv_device_is_controller(device())) return;
    ArvError error;
    if (!arv_gv_device_take_control(device(), error.out()) || !arv_gv_device_is_controller(device()))
      fail("the camera at " + where_ + " is controlled by another program: end that program and try again", error);
  }

  void configure(const GigeSettings& settings) {
    ArvError error;
    // By default Aravis writes any value and the camera silently makes something of it.
    arv_camera_set_range_check_policy(camera_.get(), ARV_RANGE_CHECK_POLICY_ENABLE);
    if (arv_camera_is_feature_available(camera_.get(), "AcquisitionMode", nullptr))
      arv_camera_set_acquisition_mode(camera_.get(), ARV_ACQUISITION_MODE_CONTINUOUS, error.out());
    if (error) fail("the camera cannot stream continuously", error);
    set_format(settings.pixel_format);
    set_region(settings);
    if (settings.frame_rate)
      actual_.frame_rate = set("frame rate", "1/s", *settings.frame_rate, arv_camera_get_frame_rate_bounds,
                               arv_camera_set_frame_rate, arv_camera_get_frame_rate);
    else
      actual_.frame_rate = arv_camera_get_frame_rate(camera_.get(), nullptr);
    if (settings.exposure_us) {
      if (arv_camera_is_exposure_auto_available(camera_.get(), nullptr))
        arv_camera_set_exposure_time_auto(camera_.get(), ARV_AUTO_OFF, nullptr);
      actual_.exposure_us = set("exposure", "us", *settings.exposure_us, arv_camera_get_exposure_time_bounds,
                                arv_camera_set_exposure_time, arv_camera_get_exposure_time);
    } else {
      actual_.exposure_us = arv_camera_get_exposure_time(camera_.get(), nullptr);
    }
    if (settings.gain)
      actual_.gain =
          set("gain", "dB", *settings.gain, arv_camera_get_gain_bounds, arv_camera_set_gain, arv_camera_get_gain);
    else
      actual_.gain = arv_camera_get_gain(camera_.get(), nullptr);
    arv_camera_gv_set_packet_size(camera_.get(), settings.packet_size, error.out());
    if (error) fail("the camera refuses packets of " + std::to_string(settings.packet_size) + " bytes", error);
    set_trigger(settings.triggered);
    if (settings.ptp) start_ptp();
    if (settings.chunks)
      start_chunks();
    else if (arv_camera_are_chunks_available(camera_.get(), nullptr))
      arv_camera_set_chunk_mode(camera_.get(), FALSE, nullptr);  // the camera keeps what its last controller set
  }

  void set_format(const std::string& name) {
    format_ = wire_format(name);
    if (format_ == nullptr)
      throw Failure(ExitCode::usage, "camera pixel format '" + name +
                                         "' is not known: Mono8, Mono10, Mono10Packed, Mono12, Mono12Packed or Mono16");
    ArvError error;
    arv_camera_set_pixel_format(camera_.get(), format_->value, error.out());
    if (error) fail("the camera does not send grey pictures as " + name, error);
  }

  /// By feature names of the SFNC: Aravis' own helper also touches triggers that the camera may not have.
  void set_trigger(bool on) {
    if (!arv_camera_is_feature_available(camera_.get(), "TriggerMode", nullptr)) {
      if (on) throw Failure(ExitCode::usage, "this camera has no trigger");
      return;
    }
    ArvError error;
    if (arv_camera_is_feature_available(camera_.get(), "TriggerSelector", nullptr))
      arv_camera_set_string(camera_.get(), "TriggerSelector", "FrameStart", error.out());
    if (on && !error) arv_camera_set_string(camera_.get(), "TriggerSource", "Software", error.out());
    if (!error) arv_camera_set_string(camera_.get(), "TriggerMode", on ? "On" : "Off", error.out());
    if (error) fail("the camera's trigger cannot be set", error);
  }

  void start_ptp() {
    ArvError error;
    if (!arv_camera_is_feature_available(camera_.get(), "PtpEnable", nullptr)) {
      actual_.notes.emplace_back("this camera has no PTP; its clock is mapped to ours by the arrivals alone");
      return;
    }
    arv_camera_set_boolean(camera_.get(), "PtpEnable", TRUE, error.out());
    if (error) fail("the camera refuses PTP", error);
    const char* status = arv_camera_get_string(camera_.get(), "PtpStatus", nullptr);
    actual_.notes.push_back(std::string("PTP is on, its status is ") + (status != nullptr ? status : "not told") +
                            "; times are mapped by the arrivals all the same");
  }

  void start_chunks() {
    ArvError error;
    if (!arv_camera_are_chunks_available(camera_.get(), nullptr)) {
      actual_.notes.emplace_back(
          "this camera sends no chunk data; exposure and gain of a frame are those that were set");
      return;
    }
    arv_camera_set_chunks(camera_.get(), "ExposureTime,Gain", error.out());
    if (error) fail("the camera refuses chunk data", error);
    parser_.reset(arv_camera_create_chunk_parser(camera_.get()));
  }

  std::optional<double> chunk(ArvBuffer* buffer, const char* name) {
    ArvError error;
    const double value = arv_chunk_parser_get_float_value(parser_.get(), buffer, name, error.out());
    if (error) return std::nullopt;
    return value;
  }

  /// The upper 8 bits of a wide picture, into a free one of ours.
  bool narrow(ArvBuffer* buffer, cv::Mat1b& gray) {
    for (cv::Mat1b& free : narrow_) {
      if (CV_XADD(&free.u->refcount, 0) != 1) continue;
      gray = free.rowRange(0, actual_.height);
      tagdock::narrow(memory(buffer).data, *format_, gray);
      return true;
    }
    return false;
  }

  /// Sets one number within the bounds that the camera tells, and reads back what it made of it.
  template <typename Bounds, typename Set, typename Get>
  double set(const std::string& name, const std::string& unit, double asked, Bounds bounds, Set write, Get read) {
    ArvError error;
    double low = 0.0, high = 0.0;
    bounds(camera_.get(), &low, &high, error.out());
    if (error) fail("the camera does not tell its bounds of " + name, error);
    std::ostringstream sentence;
    if (!(asked >= low && asked <= high)) {
      sentence << "camera " << name << " of " << asked << " " << unit << " was asked for; this camera allows " << low
               << " to " << high;
      throw Failure(ExitCode::usage, sentence.str());
    }
    write(camera_.get(), asked, error.out());
    if (error) fail("the camera refuses the " + name, error);
    const double made = read(camera_.get(), error.out());
    if (error) fail("the camera does not tell its " + name, error);
    // Cameras round to their own steps; half a percent is below what exposure or rate matter for.
    if (std::abs(made - asked) > 0.005 * std::abs(asked)) {
      sentence << "camera " << name << ": asked for " << asked << " " << unit << ", the camera made it " << made;
      actual_.notes.push_back(sentence.str());
    }
    return made;
  }

  /// Pixels that the camera can average in each direction; 1 if it cannot.
  int most_binning() {
    if (!arv_camera_is_binning_available(camera_.get(), nullptr)) return 1;
    gint least = 1, most_x = 1, most_y = 1;
    arv_camera_get_x_binning_bounds(camera_.get(), &least, &most_x, nullptr);
    arv_camera_get_y_binning_bounds(camera_.get(), &least, &most_y, nullptr);
    return std::max(1, std::min(most_x, most_y));
  }

  /// Also back to 1: the camera keeps what its last controller set.
  void set_binning(int binning) {
    actual_.binning = binning;
    if (!arv_camera_is_binning_available(camera_.get(), nullptr)) return;
    ArvError error;
    // Cameras that can sum instead would saturate.
    for (const char* mode : {"BinningHorizontalMode", "BinningVerticalMode"})
      if (arv_camera_is_feature_available(camera_.get(), mode, nullptr))
        arv_camera_set_string(camera_.get(), mode, "Average", nullptr);
    arv_camera_set_binning(camera_.get(), binning, binning, error.out());
    gint made_x = 0, made_y = 0;
    if (!error) arv_camera_get_binning(camera_.get(), &made_x, &made_y, error.out());
    if (error || made_x != binning || made_y != binning)
      fail("the camera refuses to bin " + std::to_string(binning) + "x" + std::to_string(binning) + " pixels", error);
  }

  void set_region(const GigeSettings& settings) {
    ArvError error;
    arv_camera_get_sensor_size(camera_.get(), &actual_.sensor_width, &actual_.sensor_height, error.out());
    if (error) fail("the camera does not tell the size of its sensor", error);
    int x = settings.offset_x;
    int y = settings.offset_y;
    int width = settings.width > 0 ? settings.width : actual_.sensor_width - x;
    int height = settings.height > 0 ? settings.height : actual_.sensor_height - y;
    // Aravis checks each number, but not the sum.
    if (x < 0 || y < 0 || width <= 0 || height <= 0 || width > actual_.sensor_width - x ||
        height > actual_.sensor_height - y) {
      std::ostringstream sentence;
      sentence << "camera region " << width << "x" << height << " at (" << x << ", " << y
               << ") does not lie on the sensor of " << actual_.sensor_width << "x" << actual_.sensor_height
               << " pixels";
      throw Failure(ExitCode::usage, sentence.str());
    }
    const RegionSize wanted{width, height};
    const std::size_t granted = granted_receive_buffer(settings.receive_buffer);
    const SmallerImage fits = image_that_fits(wanted, granted, most_binning());
    // Offsets first to zero, or the old ones would bound the new size.
    for (const char* offset : {"OffsetX", "OffsetY"}) {
      arv_camera_set_integer(camera_.get(), offset, 0, error.out());
      if (error) fail(std::string("the camera refuses ") + offset + " 0", error);
    }
    set_binning(fits.binning);
    if (fits != SmallerImage{1, wanted}) {
      constexpr int step = 8;  // offsets of most cameras go in steps of 2, 4 or 8 pixels
      x = (x + (width - fits.size.width * fits.binning) / 2) / fits.binning / step * step;
      y = (y + (height - fits.size.height * fits.binning) / 2) / fits.binning / step * step;
      std::ostringstream sentence;
      sentence << "the kernel grants " << granted << " bytes of receive buffer, frames of " << width << "x" << height
               << " need " << needed_receive_buffer(wanted) << ": going on with " << fits.size.width << "x"
               << fits.size.height << " pixels";
      if (fits.binning > 1)
        sentence << " of " << fits.binning << "x" << fits.binning << " each (coarser, with the same view)";
      else
        sentence << " at (" << x << ", " << y << "), a part of the view (this camera cannot bin pixels)";
      sentence << "; for whole frames run: sudo sysctl -w net.core.rmem_max=" << GigeSettings{}.receive_buffer;
      actual_.notes.push_back(sentence.str());
      width = fits.size.width;
      height = fits.size.height;
    }
    const std::pair<const char*, int> writes[] = {{"Width", width}, {"Height", height}, {"OffsetX", x}, {"OffsetY", y}};
    for (const auto& [feature, value] : writes) {
      arv_camera_set_integer(camera_.get(), feature, value, error.out());
      if (error) fail(std::string("the camera refuses ") + feature + " " + std::to_string(value), error);
    }
    arv_camera_get_region(camera_.get(), &actual_.offset_x, &actual_.offset_y, &actual_.width, &actual_.height,
                          error.out());
    if (error) fail("the camera does not tell its region", error);
    if (actual_.width != width || actual_.height != height || actual_.offset_x != x || actual_.offset_y != y) {
      std::ostringstream sentence;
      sentence << "camera region: asked for " << width << "x" << height << " at (" << x << ", " << y
               << "), the camera made it " << actual_.width << "x" << actual_.height << " at (" << actual_.offset_x
               << ", " << actual_.offset_y << ")";
      actual_.notes.push_back(sentence.str());
    }
  }

  void start(const GigeSettings& settings, const GigeClientHooks& hooks) {
    ArvError error;
    // The other way to receive, a packet ring, needs the right to open raw sockets; one way for everybody.
    arv_camera_gv_set_stream_options(camera_.get(), ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
    stream_.reset(arv_camera_create_stream(camera_.get(), nullptr, nullptr, error.out()));
    if (!stream_) fail("the camera at " + where_ + " gives no stream", error);
    g_object_set(stream_.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size",
                 static_cast<gint>(settings.receive_buffer), nullptr);
    const guint payload = arv_camera_get_payload(camera_.get(), error.out());
    if (error) fail("the camera does not tell the size of its frames", error);
    const auto bytes = static_cast<int>(payload);
    const int rows =
        std::max(actual_.height, (bytes + actual_.width - 1) / actual_.width);  // of bytes: wide pixels take two
    const bool direct = format_->bits_on_wire == 8;
    std::vector<cv::Mat1b> pictures;
    if (hooks.pictures) pictures = hooks.pictures(pool_size, direct ? rows : actual_.height, actual_.width);
    while (static_cast<int>(pictures.size()) < pool_size) pictures.emplace_back(rows, actual_.width);
    if (!direct) {
      narrow_.swap(pictures);
      for (int i = 0; i < pool_size; ++i) pictures.emplace_back(rows, actual_.width);
    }
    for (const cv::Mat1b& memory : pictures) {
      // Aravis writes straight into the picture; the buffer keeps one reference to it.
      auto* picture = new cv::Mat1b(memory);
      arv_stream_push_buffer(stream_.get(), arv_buffer_new_full(payload, picture->data, picture, [](void* kept) {
                               delete static_cast<cv::Mat1b*>(kept);
                             }));
    }
    // Comes 5 s after a death: only a last resort beside the watchdog. Sent from Aravis' heartbeat thread.
    g_signal_connect(device(), "control-lost", G_CALLBACK(+[](ArvGvDevice*, std::atomic<bool>* lost) { *lost = true; }),
                     &control_lost_);
    arv_camera_start_acquisition(camera_.get(), error.out());
    if (error) fail("the camera at " + where_ + " does not start its stream", error);
  }

  bool good(ArvBuffer* buffer) const {
    if (arv_buffer_get_status(buffer) != ARV_BUFFER_STATUS_SUCCESS) return false;
    constexpr int with_chunks = 0x4000;
    if ((arv_buffer_get_payload_type(buffer) & ~(parser_ ? with_chunks : 0)) != ARV_BUFFER_PAYLOAD_TYPE_IMAGE)
      return false;
    size_t size = 0;
    // Malformed leaders were seen to give complete buffers of size 0, or of another width and height.
    const void* data = arv_buffer_get_image_data(buffer, &size);
    return data != nullptr && arv_buffer_get_image_width(buffer) == actual_.width &&
           arv_buffer_get_image_height(buffer) == actual_.height &&
           arv_buffer_get_image_pixel_format(buffer) == format_->value &&
           size >= format_->bytes(actual_.width, actual_.height);
  }

  static const cv::Mat1b& memory(ArvBuffer* buffer) {
    return *static_cast<const cv::Mat1b*>(arv_buffer_get_user_data(buffer));
  }

  /// Gives buffers whose picture nobody else holds any more back to the stream. A picture may outlive the connection.
  void take_back() {
    std::erase_if(lent_, [&](ArvBuffer* buffer) {
      const bool free = CV_XADD(&memory(buffer).u->refcount, 0) == 1;
      if (free) arv_stream_push_buffer(stream_.get(), buffer);
      return free;
    });
  }

  std::string where_;
  std::atomic<bool> control_lost_{false};
  bool abandoned_ = false;
  CameraSettings actual_;
  std::vector<ArvBuffer*> lent_;  ///< buffers whose pictures are out
  const WireFormat* format_ = nullptr;
  std::vector<cv::Mat1b> narrow_;  ///< where wide pictures are put
  Handle<ArvCamera> camera_;
  Handle<ArvChunkParser> parser_;
  Handle<ArvStream> stream_;
};

/// Lets a dead camera go on a thread of its own, since Aravis waits up to 5 s for its answers.
/// Never more than two at once: then the grab thread waits instead, and a camera that flickers cannot pile up threads.
void reap(std::unique_ptr<Connection> connection, const std::function<void()>& stuck) {
  static std::atomic<int> at_work{0};
  constexpr int at_most = 2;
  connection->abandon();
  const auto give_up = steady_clock::now() + patience_with_dead;
  while (at_work >= at_most) {
    std::this_thread::sleep_for(milliseconds(50));
    if (stuck && steady_clock::now() > give_up) stuck();
  }
  ++at_work;
  std::thread([dead = std::move(connection)]() mutable {
    dead.reset();
    --at_work;
  }).detach();
}

/// Lets a camera go that is alive, so that it is free for the next connection. A stream whose receive buffer is full of
/// malformed packets does not end before it has chewed them all: 8 MB of them took 40 s under the thread sanitizer.
void let_go(std::unique_ptr<Connection> connection, const std::function<void()>& stuck) {
  if (!stuck) return;
  auto gone = std::async(std::launch::async, [last = std::move(connection)]() mutable { last.reset(); });
  if (gone.wait_for(patience_with_stream) != std::future_status::ready) stuck();
}

class GigeCamera : public Camera {
 public:
  GigeCamera(const GigeSettings& settings, steady_clock::time_point session_start, const GigeClientHooks& hooks)
      : settings_(settings), session_start_(session_start), hooks_(hooks) {
    if (settings_.address.empty() && settings_.serial.empty())
      throw Failure(ExitCode::usage, "a GigE camera is named by its address (gige:127.0.0.1) or its serial number");
    if (!settings_.address.empty()) address_.emplace(settings_.address);
    std::unique_ptr<Connection> connection = open(find_patiently());
    thread_ = std::thread([this, first = std::move(connection)]() mutable { run(std::move(first)); });
  }

  ~GigeCamera() override {
    end_ = true;
    thread_.join();
  }

  std::optional<CameraFrame> newest(nanoseconds) override { return mailbox_.take(); }

  CameraHealth health() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return health_;
  }

  CameraSettings actual() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return actual_;
  }

  void adjust(double exposure_us, double gain) override {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted_ = {exposure_us, gain};
  }

  void trigger() override { ++triggers_; }

 private:
  void say(const std::string& state, const std::string& reason = {}) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (health_.state == state && health_.reason == reason) return;
      enter(state);
      health_.reason = reason;
    }
    report();
  }

  /// The lock is held.
  void enter(const std::string& state) {
    if (health_.state == state) return;
    health_.state = state;
    constexpr std::size_t remembered = 16;
    health_.history.push_back({state, steady_clock::now() - session_start_});
    if (health_.history.size() > remembered) health_.history.erase(health_.history.begin());
  }

  void report() const {
    if (hooks_.changed) hooks_.changed(health());
  }

  [[nodiscard]] std::string name() const {
    return settings_.address.empty() ? "with serial number " + settings_.serial : "at " + settings_.address;
  }

  /// The camera that is meant, if it answers. @throws Failure if another one answers at its address
  std::optional<CameraIdentity> find() const {
    const std::string& serial = known_serial_.empty() ? settings_.serial : known_serial_;
    if (!address_) {
      for (CameraIdentity& one : probe_loopback(probe_timeout))
        if (one.serial == serial) return std::move(one);
      return std::nullopt;
    }
    std::optional<CameraIdentity> seen = probe_camera(*address_, probe_timeout);
    if (seen && !serial.empty() && seen->serial != serial)
      throw Failure(ExitCode::camera, "the camera at " + address_->text() + " has serial number " + seen->serial +
                                          ", not " + serial + ": another camera took its place");
    return seen;
  }

  CameraIdentity find_patiently() {
    say("probing");
    const auto deadline = steady_clock::now() + patience_at_start;
    while (steady_clock::now() < deadline) {
      if (auto seen = find()) return *seen;
      say("absent", "no camera " + name() + " answers yet");
      std::this_thread::sleep_for(probe_period);
    }
    throw Failure(ExitCode::camera, "no camera " + name() + " answers: is it switched on, and is the address right?");
  }

  /// A controller that died keeps the camera for its lease, a living one renews it.
  void wait_until_free(const LoopbackAddress& address) {
    const auto deadline = steady_clock::now() + settings_.take_over_wait;
    while (is_controlled(address, probe_timeout).value_or(false)) {
      say("claiming", "another program controls the camera " + name() + "; waiting whether it is alive");
      // Not asked again before the lease is over: asking renews it, whoever asks.
      const auto again = std::min(steady_clock::now() + lease, deadline);
      while (steady_clock::now() < again && !end_) std::this_thread::sleep_for(pop_timeout);
      if (end_ || (steady_clock::now() >= deadline && is_controlled(address, probe_timeout).value_or(false)))
        throw Failure(ExitCode::camera,
                      "the camera " + name() + " is controlled by another program: end that program and try again");
    }
  }

  std::unique_ptr<Connection> open(const CameraIdentity& identity) {
    wait_until_free(LoopbackAddress(identity.address));
    say("opening");
    auto connection =
        std::make_unique<Connection>(settings_, identity, hooks_, [this](const char* state) { say(state); });
    known_serial_ = identity.serial;
    opened_at_ = identity.address;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      actual_ = connection->actual();
      if (opened_before_) ++health_.reconnects;
    }
    opened_before_ = true;
    say("streaming");
    return connection;
  }

  void run(std::unique_ptr<Connection> connection) {
    while (!end_) {
      if (connection) {
        stream(std::move(connection));
        continue;
      }
      try {
        if (const auto seen = find()) connection = open(*seen);
      } catch (const Failure& failure) {
        say("lost", failure.what());
      }
      if (!connection) std::this_thread::sleep_for(probe_period);
    }
  }

  /// Hands frames over until the camera is lost or the end is asked for; lets the connection go.
  void stream(std::unique_ptr<Connection> connection) {
    const nanoseconds period(static_cast<std::int64_t>(1e9 / std::max(connection->actual().frame_rate, 0.5)));
    const nanoseconds loss = std::max<nanoseconds>(shortest_loss, periods_to_loss * period);
    auto last_good = steady_clock::now() + milliseconds(500);  // the first frame may take a while to be made
    auto quiet_since = last_good;                              // last good frame, or last start of the stream
    int unanswered = 0;
    std::uint64_t stale_since_good = 0;
    bool started_again = false;
    bool warm = false;  // Aravis sizes its receive buffer when the first packet comes: the first frame is often broken
    while (!end_) {
      obey(*connection);
      Grabbed grabbed;
      const Pop popped = connection->pop(grabbed, pop_timeout);
      const auto now = steady_clock::now();
      if (popped != Pop::nothing && !warm) {
        warm = true;
        last_good = quiet_since = std::max(last_good, now);
        continue;
      }
      if (popped == Pop::incomplete) {
        const std::lock_guard<std::mutex> lock(mutex_);
        ++health_.incomplete;
        incomplete_since_good_.push_back(counter_.would_be(grabbed.id));
      }
      if (popped == Pop::good && hand_over(grabbed, now, *connection)) {
        stale_since_good = 0;
        last_good = quiet_since = now;
        unanswered = 0;
        started_again = false;
        continue;
      }
      if (popped == Pop::good) ++stale_since_good;
      if (connection->control_lost()) {
        lose(std::move(connection),
             "the camera " + name() + " is under another program's control, or was restarted; opening it again");
        return;
      }
      // A triggered camera sends nothing when it is not asked; that it is there is asked now and then.
      if (now - last_good <= (settings_.triggered ? triggered_patience : loss)) continue;
      const auto seen = probe_camera(LoopbackAddress(opened_at_), probe_timeout);
      if (!seen) {
        if (++unanswered < probes_to_loss) continue;
        lose(std::move(connection),
             "the camera " + name() + " sends no frames and does not answer: check its power and cable");
        return;
      }
      unanswered = 0;
      if (seen->serial != known_serial_) {
        lose(std::move(connection), "another camera, " + seen->serial + ", answers in place of " + known_serial_);
        return;
      }
      if (settings_.triggered) {
        last_good = quiet_since = now;
        continue;
      }
      if (stale_since_good > 0)
        say("silent",
            "the camera " + name() + " sends frames whose numbers or time stamps stand still; they are not used");
      else
        say("silent",
            "the camera " + name() + " answers but sends no complete frame: check the network and its trigger");
      if (now - quiet_since <= silent_restart + loss) continue;
      if (started_again) {
        say("lost", "the camera " + name() + " answers but sends no frames; opening it again");
        break;  // it is alive: let it go properly, so that it is free
      }
      connection->restart();
      started_again = true;
      warm = false;
      quiet_since = now;
    }
    // Asked to end, nobody waits for longer than a moment: whoever asks kills the process then.
    if (end_)
      connection.reset();
    else
      let_go(std::move(connection), hooks_.stuck);
    lost();
  }

  void lose(std::unique_ptr<Connection> connection, const std::string& reason) {
    say("lost", reason);
    reap(std::move(connection), hooks_.stuck);
    lost();
  }

  void lost() {
    clock_ = ClockMap();
    counter_.reopened();
    last_number_ = 0;
    incomplete_since_good_.clear();
    last_camera_time_.reset();
  }

  /// What was asked from another thread, between two frames.
  void obey(Connection& connection) {
    std::optional<std::pair<double, double>> wanted;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      wanted.swap(wanted_);
    }
    if (wanted) {
      connection.adjust(wanted->first, wanted->second);
      const std::lock_guard<std::mutex> lock(mutex_);
      actual_ = connection.actual();
    }
    if (triggers_.exchange(0) > 0) connection.trigger();
  }

  /// @return whether it is a new frame
  bool hand_over(const Grabbed& grabbed, steady_clock::time_point now, const Connection& connection) {
    const CameraSettings& actual = connection.actual();
    const bool same_time =
        last_camera_time_ && grabbed.camera_time == *last_camera_time_ && grabbed.camera_time.count() != 0;
    const auto number = counter_.number(grabbed.id);
    if (same_time || !number) {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++health_.stale;
      return false;
    }
    last_camera_time_ = grabbed.camera_time;
    CameraFrame frame;
    frame.arrived = now - session_start_;
    frame.camera_time = grabbed.camera_time;
    // A camera without a clock sends zeros.
    const nanoseconds smooth =
        grabbed.camera_time.count() == 0 ? frame.arrived : clock_.arrived(grabbed.camera_time, frame.arrived);
    frame.frame = Frame{grabbed.gray, smooth - settings_.declared_latency, *number};
    frame.exposure_us = grabbed.exposure_us.value_or(actual.exposure_us);
    frame.gain = grabbed.gain.value_or(actual.gain);
    frame.lost_before = last_number_ == 0 ? 0 : *number - last_number_ - 1;
    // What came incomplete is counted as such; the rest of the gap never came. Frames come in order, so one without a
    // number of its own belongs here; one with a number from elsewhere was never one of this camera's.
    const auto in_gap = std::count_if(
        incomplete_since_good_.begin(), incomplete_since_good_.end(),
        [&](const std::optional<std::uint64_t>& one) { return !one || (*one > last_number_ && *one < *number); });
    const std::uint64_t never_came =
        frame.lost_before - std::min(frame.lost_before, static_cast<std::uint64_t>(in_gap));
    incomplete_since_good_.clear();
    last_number_ = *number;
    // Told before the frame is: whoever has a frame finds the camera streaming, and the frame counted.
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      enter("streaming");
      health_.reason.clear();
      ++health_.received;
      health_.lost += never_came;
      health_.resent = connection.resent();
    }
    report();
    if (mailbox_.put(std::move(frame))) {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++health_.overwritten;
    }
    if (hooks_.frame_ready) hooks_.frame_ready();
    return true;
  }

  const GigeSettings settings_;
  const steady_clock::time_point session_start_;
  const GigeClientHooks hooks_;
  std::optional<LoopbackAddress> address_;
  Mailbox<CameraFrame> mailbox_;
  std::atomic<bool> end_{false};

  mutable std::mutex mutex_;  ///< guards health_ and actual_
  CameraHealth health_;
  CameraSettings actual_;
  std::optional<std::pair<double, double>> wanted_;  ///< exposure and gain
  std::atomic<int> triggers_{0};

  // Of the grab thread (and of the constructor before it).
  std::string known_serial_;  ///< of the camera that was opened first: only that one is opened again
  std::string opened_at_;
  bool opened_before_ = false;
  ClockMap clock_;
  FrameCounter counter_;
  std::uint64_t last_number_ = 0;
  std::optional<nanoseconds> last_camera_time_;
  std::vector<std::optional<std::uint64_t>> incomplete_since_good_;  ///< their numbers, where they are known

  std::thread thread_;
};

}  // namespace

std::unique_ptr<Camera> open_gige_client(const GigeSettings& settings, steady_clock::time_point session_start,
                                         const GigeClientHooks& hooks) {
  return std::make_unique<GigeCamera>(settings, session_start, hooks);
}

}  // namespace tagdock
