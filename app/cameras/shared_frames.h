#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include <opencv2/core.hpp>

namespace tagdock {

/// Memory for `count` pictures of one size, shared with another process by a file that exists in memory only.
class SharedFrames {
 public:
  /// Makes it. @throws Failure (internal) when the memory is not to be had
  SharedFrames(int count, int rows, int columns);
  /// Maps what another process has made, for reading. Takes the handle over.
  /// @throws Failure (camera) when its size is not what was announced
  SharedFrames(int handle, int count, int rows, int columns);
  ~SharedFrames();
  SharedFrames(const SharedFrames&) = delete;
  SharedFrames& operator=(const SharedFrames&) = delete;

  [[nodiscard]] int handle() const { return handle_; }
  [[nodiscard]] int count() const { return count_; }
  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] unsigned char* at(int index) const { return memory_ + static_cast<std::size_t>(index) * stride(); }
  /// Which picture begins at an address; -1 if none does.
  [[nodiscard]] int index_of(const unsigned char* address) const;

 private:
  [[nodiscard]] std::size_t stride() const;
  void map(int protection);

  int handle_;
  int count_;
  int rows_;
  int columns_;
  unsigned char* memory_ = nullptr;
};

/// A picture on memory of somebody else, who is told when the last copy of it is gone.
cv::Mat1b lent_picture(unsigned char* memory, int rows, int columns, std::function<void()> returned);

}  // namespace tagdock
