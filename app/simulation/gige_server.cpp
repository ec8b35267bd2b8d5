#include "app/simulation/gige_server.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <mutex>
#include <string_view>
#include <sys/mman.h>
#include <unistd.h>
#include <vector>

#include <arv.h>
#include <opencv2/imgproc.hpp>

#include "app/cameras/gvcp_probe.h"
#include "app/failure.h"

namespace tagdock {

namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

// The bootstrap block that every GigE Vision camera has.
constexpr std::uint32_t vendor_register = 0x48;
constexpr std::uint32_t model_register = 0x68;
constexpr std::uint32_t user_name_register = 0xe8;
// Registers of our own, in memory that Aravis' camera leaves alone: IEEE 754 doubles, big-endian.
constexpr std::uint32_t exposure_register = 0x400;
constexpr std::uint32_t gain_register = 0x408;
constexpr std::uint32_t frame_rate_register = 0x410;

// Aravis' camera looks for a frame at multiples of its own frame period. That period is kept short, so that a published
// frame waits 2.5 ms on average; the client's frame rate is a register of ours. A turn without a new frame costs one
// copy of the image in memory (0.1 ms).
constexpr std::uint32_t turn_period_us = 5000;
constexpr milliseconds first_answer_timeout{1000};

// What the camera says about itself (GenICam 1.1). Names and units follow the Standard Features Naming Convention.
constexpr std::string_view description = R"(<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Simulated" VendorName="tagdock" StandardNameSpace="GEV" SchemaMajorVersion="1"
    SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
    ToolTip="A camera in the tagdock simulation" ProductGuid="2f1a4c60-5d0e-4b7b-9a53-7b1f3d0c9e11"
    VersionGuid="2f1a4c60-5d0e-4b7b-9a53-7b1f3d0c9e12" xmlns="http://www.genicam.org/GenApi/Version_1_1"
    xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1 GenApiSchema_Version_1_1.xsd">
  <Category Name="Root">
    <pFeature>DeviceControl</pFeature><pFeature>ImageFormatControl</pFeature><pFeature>AcquisitionControl</pFeature>
    <pFeature>AnalogControl</pFeature><pFeature>TransportLayerControl</pFeature>
  </Category>

  <Category Name="DeviceControl">
    <pFeature>DeviceVendorName</pFeature><pFeature>DeviceModelName</pFeature><pFeature>DeviceSerialNumber</pFeature>
    <pFeature>DeviceUserID</pFeature>
  </Category>
  <StringReg Name="DeviceVendorName"><Address>0x48</Address><Length>32</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceModelName"><Address>0x68</Address><Length>32</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceSerialNumber"><Address>0xd8</Address><Length>16</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceUserID"><Address>0xe8</Address><Length>16</Length><AccessMode>RW</AccessMode><pPort>Device</pPort></StringReg>

  <Category Name="ImageFormatControl">
    <pFeature>SensorWidth</pFeature><pFeature>SensorHeight</pFeature><pFeature>WidthMax</pFeature><pFeature>HeightMax</pFeature>
    <pFeature>BinningHorizontal</pFeature><pFeature>BinningVertical</pFeature>
    <pFeature>Width</pFeature><pFeature>Height</pFeature><pFeature>OffsetX</pFeature><pFeature>OffsetY</pFeature>
    <pFeature>PixelFormat</pFeature>
  </Category>
  <Integer Name="SensorWidth"><ImposedAccessMode>RO</ImposedAccessMode><pValue>SensorWidthRegister</pValue></Integer>
  <Integer Name="SensorHeight"><ImposedAccessMode>RO</ImposedAccessMode><pValue>SensorHeightRegister</pValue></Integer>
  <IntSwissKnife Name="WidthMax"><pVariable Name="SENSOR">SensorWidth</pVariable><pVariable Name="BINNING">BinningHorizontal</pVariable><pVariable Name="OFFSET">OffsetX</pVariable><Formula>SENSOR / BINNING - OFFSET</Formula></IntSwissKnife>
  <IntSwissKnife Name="HeightMax"><pVariable Name="SENSOR">SensorHeight</pVariable><pVariable Name="BINNING">BinningVertical</pVariable><pVariable Name="OFFSET">OffsetY</pVariable><Formula>SENSOR / BINNING - OFFSET</Formula></IntSwissKnife>
  <IntSwissKnife Name="OffsetXMax"><pVariable Name="SENSOR">SensorWidth</pVariable><pVariable Name="BINNING">BinningHorizontal</pVariable><pVariable Name="SIZE">Width</pVariable><Formula>SENSOR / BINNING - SIZE</Formula></IntSwissKnife>
  <IntSwissKnife Name="OffsetYMax"><pVariable Name="SENSOR">SensorHeight</pVariable><pVariable Name="BINNING">BinningVertical</pVariable><pVariable Name="SIZE">Height</pVariable><Formula>SENSOR / BINNING - SIZE</Formula></IntSwissKnife>
  <Integer Name="BinningHorizontal"><pValue>BinningHorizontalRegister</pValue><Min>1</Min><Max>4</Max></Integer>
  <Integer Name="BinningVertical"><pValue>BinningVerticalRegister</pValue><Min>1</Min><Max>4</Max></Integer>
  <Integer Name="Width"><pValue>WidthRegister</pValue><Min>16</Min><pMax>WidthMax</pMax><Inc>4</Inc></Integer>
  <Integer Name="Height"><pValue>HeightRegister</pValue><Min>16</Min><pMax>HeightMax</pMax><Inc>2</Inc></Integer>
  <Integer Name="OffsetX"><pValue>OffsetXRegister</pValue><Min>0</Min><pMax>OffsetXMax</pMax><Inc>4</Inc></Integer>
  <Integer Name="OffsetY"><pValue>OffsetYRegister</pValue><Min>0</Min><pMax>OffsetYMax</pMax><Inc>2</Inc></Integer>
  <Enumeration Name="PixelFormat">
    <EnumEntry Name="Mono8"><Value>17301505</Value></EnumEntry>
    <EnumEntry Name="Mono16"><Value>17825799</Value></EnumEntry>
    <pValue>PixelFormatRegister</pValue>
  </Enumeration>
  <IntReg Name="SensorWidthRegister"><Address>0x11c</Address><Length>4</Length><AccessMode>RO</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="SensorHeightRegister"><Address>0x118</Address><Length>4</Length><AccessMode>RO</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="BinningHorizontalRegister"><Address>0x108</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="BinningVerticalRegister"><Address>0x10c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="WidthRegister"><Address>0x100</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="HeightRegister"><Address>0x104</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="OffsetXRegister"><Address>0x130</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="OffsetYRegister"><Address>0x134</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="PixelFormatRegister"><Address>0x128</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>

  <Category Name="AcquisitionControl">
    <pFeature>AcquisitionMode</pFeature><pFeature>AcquisitionStart</pFeature><pFeature>AcquisitionStop</pFeature>
    <pFeature>AcquisitionFrameRate</pFeature><pFeature>ExposureTime</pFeature>
  </Category>
  <Enumeration Name="AcquisitionMode"><EnumEntry Name="Continuous"><Value>1</Value></EnumEntry><pValue>AcquisitionModeRegister</pValue></Enumeration>
  <Command Name="AcquisitionStart"><pValue>AcquisitionRegister</pValue><CommandValue>1</CommandValue></Command>
  <Command Name="AcquisitionStop"><pValue>AcquisitionRegister</pValue><CommandValue>0</CommandValue></Command>
  <Float Name="AcquisitionFrameRate"><pValue>FrameRateRegister</pValue><Min>0.5</Min><Max>200.0</Max><Unit>Hz</Unit></Float>
  <Float Name="ExposureTime"><pValue>ExposureRegister</pValue><Min>10.0</Min><Max>1000000.0</Max><Unit>us</Unit></Float>
  <IntReg Name="AcquisitionModeRegister"><Address>0x12c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="AcquisitionRegister"><Address>0x124</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <FloatReg Name="ExposureRegister"><Address>0x400</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <FloatReg Name="GainRegister"><Address>0x408</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <FloatReg Name="FrameRateRegister"><Address>0x410</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>

  <Category Name="AnalogControl"><pFeature>Gain</pFeature></Category>
  <Float Name="Gain"><pValue>GainRegister</pValue><Min>0.0</Min><Max>24.0</Max><Unit>dB</Unit></Float>

  <Category Name="TransportLayerControl"><pFeature>PayloadSize</pFeature><pFeature>TLParamsLocked</pFeature></Category>
  <IntSwissKnife Name="PayloadSize"><pVariable Name="W">Width</pVariable><pVariable Name="H">Height</pVariable><pVariable Name="FORMAT">PixelFormatRegister</pVariable><Formula>W * H * ((FORMAT &gt;&gt; 16) &amp; 0xff) / 8</Formula></IntSwissKnife>
  <Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>

  <Port Name="Device"/>
</RegisterDescription>
)";

/// A file that exists in memory only, for a library that wants a path.
class MemoryFile {
 public:
  explicit MemoryFile(std::string_view content) : handle_(::memfd_create("genicam.xml", MFD_CLOEXEC)) {
    if (handle_ < 0 || ::write(handle_, content.data(), content.size()) != static_cast<ssize_t>(content.size()))
      throw Failure(ExitCode::internal,
                    std::string("the camera description does not fit in memory: ") + std::strerror(errno));
  }
  ~MemoryFile() { ::close(handle_); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  [[nodiscard]] std::string path() const { return "/proc/self/fd/" + std::to_string(handle_); }

 private:
  int handle_;
};

void write_text(ArvFakeCamera* camera, std::uint32_t address, std::size_t size, const std::string& text) {
  std::vector<char> bytes(size, '\0');
  std::copy_n(text.begin(), std::min(text.size(), size - 1), bytes.begin());
  arv_fake_camera_write_memory(camera, address, static_cast<guint32>(size), bytes.data());
}

void write_double(ArvFakeCamera* camera, std::uint32_t address, double value) {
  const std::uint64_t bits = GUINT64_TO_BE(std::bit_cast<std::uint64_t>(value));
  arv_fake_camera_write_memory(camera, address, sizeof bits, &bits);
}

double read_double(ArvFakeCamera* camera, std::uint32_t address) {
  std::uint64_t bits = 0;
  arv_fake_camera_read_memory(camera, address, sizeof bits, &bits);
  return std::bit_cast<double>(GUINT64_FROM_BE(bits));
}

std::uint32_t read_register(ArvFakeCamera* camera, std::uint32_t address) {
  guint32 value = 0;
  arv_fake_camera_read_register(camera, address, &value);
  return value;
}

}  // namespace

class GigeServer::Implementation {
 public:
  explicit Implementation(const GigeServerSettings& settings) : settings_(settings) {
    const LoopbackAddress address(settings.address);
    if (settings.serial.empty() || settings.serial.size() > 15)
      throw Failure(ExitCode::usage,
                    "the serial number of a simulated camera has 1 to 15 characters, not '" + settings.serial + "'");
    const std::string taken = "another camera simulator holds port 3956 on " + settings.address +
                              ": stop it, or wait for it to end; no two can share an address";
    // Aravis' server says that it runs even when it could not have the port, so the port is asked before and after.
    if (gvcp_port_is_taken(address)) throw Failure(ExitCode::camera, taken);
    {
      // Aravis' thread reads all this in turn().
      const std::lock_guard<std::mutex> lock(mutex_);
      const MemoryFile genicam(description);
      server_ = arv_gv_fake_camera_new_full(settings.address.c_str(), settings.serial.c_str(), genicam.path().c_str());
      camera_ = arv_gv_fake_camera_get_fake_camera(server_);
      client_.exposure_us = settings.exposure_us;
      client_.gain = settings.gain;
      client_.frame_rate = settings.frame_rate;
      client_.region = cv::Rect(0, 0, settings.width, settings.height);
      write_registers();
    }
    arv_fake_camera_set_fill_pattern(camera_, &Implementation::fill, this);
    if (!arv_gv_fake_camera_is_running(server_)) {
      stop();
      throw Failure(ExitCode::camera, "the loopback device has no address " + settings.address +
                                          ": use 127.0.0.1, or give it one with: ip addr add " + settings.address +
                                          "/8 dev lo");
    }
    const auto seen = probe_camera(address, first_answer_timeout);
    if (!seen || seen->serial != settings.serial) {
      stop();
      throw Failure(ExitCode::camera, taken);
    }
  }

  ~Implementation() { stop(); }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  void publish(const ServedFrame& frame) {
    if (frame.gray.cols != settings_.width || frame.gray.rows != settings_.height)
      throw Failure(ExitCode::internal, "a frame of the wrong size was given to the simulated camera");
    const std::lock_guard<std::mutex> lock(mutex_);
    newest_ = frame;
    fresh_ = true;
  }

  ServedSettings client() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    ServedSettings client = client_;
    // Aravis' server does not tell when a stream ends; one that takes no turn for this long has ended.
    client.streaming = last_turn_ && steady_clock::now() - *last_turn_ < milliseconds(500);
    return client;
  }

  std::uint64_t sent() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return sent_;
  }

  void lose_packets(double ratio) {
    const std::lock_guard<std::mutex> lock(mutex_);
    lost_ratio_ = std::clamp(ratio, 0.0, 1.0);
  }

  void silence(bool on) {
    const std::lock_guard<std::mutex> lock(mutex_);
    silent_ = on;
  }

  void stop() {
    const std::lock_guard<std::mutex> lock(stop_mutex_);
    if (server_ == nullptr) return;
    // The last turn must be over before the server goes: it sets a property of the server, which a dying object does
    // not allow. Exchanging the pattern waits for a turn under way.
    arv_fake_camera_set_fill_pattern(
        camera_, [](ArvBuffer*, void*, guint32, guint32, ArvPixelFormat) {}, nullptr);
    g_object_set(server_, "gvsp-lost-ratio", 1.0, nullptr);
    g_object_unref(server_);
    const std::lock_guard<std::mutex> ended(mutex_);
    server_ = nullptr;
  }

 private:
  void write_registers() {
    write_text(camera_, vendor_register, 32, "tagdock");
    write_text(camera_, model_register, 32, settings_.model);
    write_text(camera_, user_name_register, 16, settings_.user_name);
    const auto width = static_cast<guint32>(settings_.width);
    const auto height = static_cast<guint32>(settings_.height);
    arv_fake_camera_write_register(camera_, ARV_FAKE_CAMERA_REGISTER_SENSOR_WIDTH, width);
    arv_fake_camera_write_register(camera_, ARV_FAKE_CAMERA_REGISTER_SENSOR_HEIGHT, height);
    arv_fake_camera_write_register(camera_, ARV_FAKE_CAMERA_REGISTER_WIDTH, width);
    arv_fake_camera_write_register(camera_, ARV_FAKE_CAMERA_REGISTER_HEIGHT, height);
    arv_fake_camera_write_register(camera_, ARV_FAKE_CAMERA_REGISTER_ACQUISITION_FRAME_PERIOD_US, turn_period_us);
    write_double(camera_, exposure_register, settings_.exposure_us);
    write_double(camera_, gain_register, settings_.gain);
    write_double(camera_, frame_rate_register, settings_.frame_rate);
  }

  /// Called by Aravis' control thread at every turn of the stream: while it runs, no register can be read. It takes
  /// what the client has set and copies the newest frame; without one, or in silence, all packets of this turn are
  /// lost.
  static void fill(ArvBuffer* buffer, void* self, guint32, guint32, ArvPixelFormat format) {
    static_cast<Implementation*>(self)->turn(buffer, format);
  }

  void turn(ArvBuffer* buffer, ArvPixelFormat format) {
    const auto now = steady_clock::now();
    ServedFrame frame;
    cv::Rect region;
    cv::Size binning;
    double lost_ratio = 1.0;
    ArvGvFakeCamera* server = nullptr;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      server = server_;
      last_turn_ = now;
      client_.exposure_us = read_double(camera_, exposure_register);
      client_.gain = read_double(camera_, gain_register);
      client_.frame_rate = read_double(camera_, frame_rate_register);
      gint width = 0, height = 0, ignored = 0;
      arv_buffer_get_image_region(buffer, &ignored, &ignored, &width, &height);
      const auto x = static_cast<int>(read_register(camera_, ARV_FAKE_CAMERA_REGISTER_X_OFFSET));
      const auto y = static_cast<int>(read_register(camera_, ARV_FAKE_CAMERA_REGISTER_Y_OFFSET));
      binning.width = static_cast<int>(read_register(camera_, ARV_FAKE_CAMERA_REGISTER_BINNING_HORIZONTAL));
      binning.height = static_cast<int>(read_register(camera_, ARV_FAKE_CAMERA_REGISTER_BINNING_VERTICAL));
      // What the client asks for in binned pixels, and what that is of the sensor.
      region = cv::Rect(x * binning.width, y * binning.height, width * binning.width, height * binning.height) &
               cv::Rect(0, 0, settings_.width, settings_.height);
      client_.region = region;
      const bool whole = region.width == width * binning.width && region.height == height * binning.height;
      if (fresh_ && whole && now >= due_) {
        fresh_ = false;
        frame = newest_;
        // Frames that come a little late do not slow the rhythm, but a pause is not made up for.
        const nanoseconds period(static_cast<std::int64_t>(1e9 / std::max(client_.frame_rate, 0.5)));
        due_ = std::max(due_, now - period) + period;
        if (!silent_) {
          lost_ratio = lost_ratio_;
          ++sent_;
        }
      }
    }
    g_object_set(server, "gvsp-lost-ratio", lost_ratio, nullptr);
    if (frame.gray.empty()) return;
    constexpr std::uint64_t largest_id = 65535;  // 0 is no frame id, so they run from 1 to this
    arv_buffer_set_frame_id(buffer, frame.number % largest_id + 1);
    arv_buffer_set_timestamp(buffer, static_cast<guint64>(frame.camera_time.count()));
    size_t size = 0;
    auto* pixels = static_cast<unsigned char*>(const_cast<void*>(arv_buffer_get_data(buffer, &size)));
    cv::Mat1b shown = frame.gray(region);
    const cv::Size sent_size(region.width / binning.width, region.height / binning.height);
    if (sent_size != region.size()) {
      cv::Mat1b averaged;
      cv::resize(shown, averaged, sent_size, 0.0, 0.0, cv::INTER_AREA);  // whole factors: the mean of each block
      shown = averaged;
    }
    if (format == ARV_PIXEL_FORMAT_MONO_16) {
      cv::Mat1w wide(sent_size.height, sent_size.width, reinterpret_cast<std::uint16_t*>(pixels));
      shown.convertTo(wide, CV_16U, 257.0);
    } else {
      cv::Mat1b sent(sent_size.height, sent_size.width, pixels);
      shown.copyTo(sent);
    }
  }

  const GigeServerSettings settings_;
  ArvGvFakeCamera* server_ = nullptr;
  ArvFakeCamera* camera_ = nullptr;  ///< owned by server_
  std::mutex stop_mutex_;

  mutable std::mutex mutex_;  ///< guards what follows
  ServedFrame newest_;
  bool fresh_ = false;  ///< newest_ was not sent yet
  steady_clock::time_point due_{};
  ServedSettings client_;
  std::optional<steady_clock::time_point> last_turn_;
  std::uint64_t sent_ = 0;
  double lost_ratio_ = 0.0;
  bool silent_ = false;
};

GigeServer::GigeServer(const GigeServerSettings& settings)
    : implementation_(std::make_unique<Implementation>(settings)) {}
GigeServer::~GigeServer() = default;
void GigeServer::publish(const ServedFrame& frame) { implementation_->publish(frame); }
ServedSettings GigeServer::client() const { return implementation_->client(); }
std::uint64_t GigeServer::sent() const { return implementation_->sent(); }
void GigeServer::lose_packets(double ratio) { implementation_->lose_packets(ratio); }
void GigeServer::silence(bool on) { implementation_->silence(on); }
void GigeServer::stop() { implementation_->stop(); }

}  // namespace tagdock
