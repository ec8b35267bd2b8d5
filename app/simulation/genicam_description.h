#pragma once

#include <cstdint>
#include <string_view>

namespace tagdock {

/// Registers of the simulated camera beyond the bootstrap block, in the manufacturer's space (from 0xa000).
/// Integers have 32 bits, real numbers are IEEE 754 doubles; all are big-endian.
namespace camera_register {
constexpr std::uint32_t sensor_width = 0xa000;
constexpr std::uint32_t sensor_height = 0xa004;
constexpr std::uint32_t first_writable = 0xa010;
constexpr std::uint32_t width = 0xa010;
constexpr std::uint32_t height = 0xa014;
constexpr std::uint32_t offset_x = 0xa018;
constexpr std::uint32_t offset_y = 0xa01c;
constexpr std::uint32_t binning_horizontal = 0xa020;
constexpr std::uint32_t binning_vertical = 0xa024;
constexpr std::uint32_t pixel_format = 0xa028;
constexpr std::uint32_t acquisition_mode = 0xa02c;
constexpr std::uint32_t acquisition = 0xa030;
constexpr std::uint32_t trigger_mode = 0xa034;
constexpr std::uint32_t trigger_source = 0xa038;
constexpr std::uint32_t trigger_software = 0xa03c;
constexpr std::uint32_t exposure = 0xa040;
constexpr std::uint32_t gain = 0xa048;
constexpr std::uint32_t frame_rate = 0xa050;
constexpr std::uint32_t ptp_enable = 0xa058;
constexpr std::uint32_t chunk_mode = 0xa05c;
constexpr std::uint32_t chunk_selector = 0xa060;
constexpr std::uint32_t chunk_enable = 0xa064;  ///< one a chunk
constexpr std::uint32_t end = 0xa06c;
constexpr std::uint32_t description = 0x10000;  ///< the text below
}  // namespace camera_register

/// What a frame can carry of itself, behind its pixels.
namespace camera_chunk {
constexpr std::uint32_t image_id = 0x1000;
constexpr std::uint32_t exposure_id = 0x1001;  ///< a number of 8 bytes [us]
constexpr std::uint32_t gain_id = 0x1002;      ///< a number of 8 bytes [dB]
constexpr std::uint32_t tag_size = 8;          ///< behind each chunk: its id and its length
}  // namespace camera_chunk

/// What the simulated camera says about itself (GenICam 1.1). Names and units follow the Standard Features Naming
/// Convention.
extern const std::string_view camera_description;

}  // namespace tagdock
