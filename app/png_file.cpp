#include "app/png_file.h"

#include <libdeflate.h>
#include <memory>

#include "app/failure.h"

namespace tagdock {
namespace {

void put32(std::vector<std::uint8_t>& bytes, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) bytes.push_back(static_cast<std::uint8_t>(value >> shift));
}

/// A chunk: length, name, content, checksum of the last two.
void chunk(std::vector<std::uint8_t>& file, const char* name, const std::uint8_t* content, std::size_t size) {
  put32(file, static_cast<std::uint32_t>(size));
  const std::size_t begin = file.size();
  file.insert(file.end(), name, name + 4);
  file.insert(file.end(), content, content + size);
  put32(file, libdeflate_crc32(0, &file[begin], size + 4));
}

}  // namespace

std::vector<std::uint8_t> png_of(const cv::Mat1b& gray, const std::string& comment) {
  std::vector<std::uint8_t> file{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  std::vector<std::uint8_t> head;
  put32(head, static_cast<std::uint32_t>(gray.cols));
  put32(head, static_cast<std::uint32_t>(gray.rows));
  head.insert(head.end(), {8, 0, 0, 0, 0});  // 8 bits of grey, the only compression and filters there are, whole rows
  chunk(file, "IHDR", head.data(), head.size());
  if (!comment.empty()) {
    std::vector<std::uint8_t> text{'C', 'o', 'm', 'm', 'e', 'n', 't', 0};
    text.insert(text.end(), comment.begin(), comment.end());
    chunk(file, "tEXt", text.data(), text.size());
  }
  const auto columns = static_cast<std::size_t>(gray.cols);
  std::vector<std::uint8_t> rows((columns + 1) * static_cast<std::size_t>(gray.rows));
  for (int y = 0; y < gray.rows; ++y) {
    std::uint8_t* row = &rows[static_cast<std::size_t>(y) * (columns + 1)];
    const unsigned char* pixels = gray.ptr(y);
    *row++ = 1;  // Sub: each pixel less the one before
    std::uint8_t before = 0;
    for (std::size_t x = 0; x < columns; ++x) {
      row[x] = static_cast<std::uint8_t>(pixels[x] - before);
      before = pixels[x];
    }
  }
  const std::unique_ptr<libdeflate_compressor, void (*)(libdeflate_compressor*)> compressor(
      libdeflate_alloc_compressor(1), libdeflate_free_compressor);
  if (!compressor) throw Failure(ExitCode::internal, "no memory to compress a picture");
  std::vector<std::uint8_t> small(libdeflate_zlib_compress_bound(compressor.get(), rows.size()));
  small.resize(libdeflate_zlib_compress(compressor.get(), rows.data(), rows.size(), small.data(), small.size()));
  chunk(file, "IDAT", small.data(), small.size());
  chunk(file, "IEND", small.data(), 0);
  return file;
}

}  // namespace tagdock
