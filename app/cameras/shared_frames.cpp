#include "app/cameras/shared_frames.h"

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <string>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <utility>

#include "app/failure.h"

namespace tagdock {
namespace {

/// Gives memory back to its owner instead of freeing it.
class Lender final : public cv::MatAllocator {
 public:
  cv::UMatData* allocate(int, const int*, int, void*, std::size_t*, cv::AccessFlag, cv::UMatUsageFlags) const override {
    CV_Error(cv::Error::StsNotImplemented, "lent pictures are not made by OpenCV");
  }
  bool allocate(cv::UMatData*, cv::AccessFlag, cv::UMatUsageFlags) const override { return false; }
  void deallocate(cv::UMatData* data) const override {
    if (data == nullptr) return;
    const std::unique_ptr<std::function<void()>> returned(static_cast<std::function<void()>*>(data->userdata));
    delete data;
    if (*returned) (*returned)();
  }
};

}  // namespace

SharedFrames::SharedFrames(int count, int rows, int columns)
    : handle_(::memfd_create("frames", MFD_CLOEXEC)), count_(count), rows_(rows), columns_(columns) {
  if (handle_ < 0 || ::ftruncate(handle_, static_cast<off_t>(stride() * static_cast<std::size_t>(count_))) != 0)
    throw Failure(ExitCode::internal, std::string("no shared memory for frames: ") + std::strerror(errno));
  map(PROT_READ | PROT_WRITE);
}

SharedFrames::SharedFrames(int handle, int count, int rows, int columns)
    : handle_(handle), count_(count), rows_(rows), columns_(columns) {
  constexpr int most = 1 << 16;
  struct stat info {};
  const bool sane = count > 0 && count <= 1024 && rows > 0 && rows <= most && columns > 0 && columns <= most;
  if (!sane || ::fstat(handle_, &info) != 0 ||
      static_cast<std::size_t>(info.st_size) < stride() * static_cast<std::size_t>(count_)) {
    ::close(handle_);
    throw Failure(ExitCode::camera, "the camera client announced frames that its memory does not hold");
  }
  map(PROT_READ);
}

void SharedFrames::map(int protection) {
  void* memory = ::mmap(nullptr, stride() * static_cast<std::size_t>(count_), protection, MAP_SHARED, handle_, 0);
  if (memory == MAP_FAILED) {
    const int error = errno;
    ::close(handle_);
    throw Failure(ExitCode::internal, std::string("shared frames cannot be mapped: ") + std::strerror(error));
  }
  memory_ = static_cast<unsigned char*>(memory);
}

SharedFrames::~SharedFrames() {
  ::munmap(memory_, stride() * static_cast<std::size_t>(count_));
  ::close(handle_);
}

std::size_t SharedFrames::stride() const {
  constexpr std::size_t page = 4096;
  return (static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_) + page - 1) / page * page;
}

int SharedFrames::index_of(const unsigned char* address) const {
  const auto offset = reinterpret_cast<std::uintptr_t>(address) - reinterpret_cast<std::uintptr_t>(memory_);
  if (offset % stride() != 0 || offset / stride() >= static_cast<std::size_t>(count_)) return -1;
  return static_cast<int>(offset / stride());
}

cv::Mat1b lent_picture(unsigned char* memory, int rows, int columns, std::function<void()> returned) {
  static Lender lender;
  cv::Mat1b picture(rows, columns, memory);
  auto* data = new cv::UMatData(&lender);
  data->data = data->origdata = memory;
  data->size = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
  data->userdata = new std::function<void()>(std::move(returned));
  data->refcount = 1;
  picture.u = data;
  return picture;
}

}  // namespace tagdock
