#include <filesystem>
#include <fstream>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <opencv2/imgcodecs.hpp>

#include "app/cameras/image_sequence.h"
#include "app/failure.h"
#include "app/image_file.h"

namespace tagdock {
namespace {

using namespace std::chrono_literals;

/// A folder that is gone when the test is over.
class Folder {
 public:
  Folder() {
    std::string name = (std::filesystem::temp_directory_path() / "tagdock_images_XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  [[nodiscard]] std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  [[nodiscard]] std::string text() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

cv::Mat1b flat(int grey) { return cv::Mat1b(6, 8, static_cast<unsigned char>(grey)); }

std::string failure_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::usage);
    return failure.what();
  }
  return "no failure";
}

TEST_CASE("a folder's pictures come in the order people count, whatever their format") {
  const Folder folder;
  cv::imwrite(folder / "I10.png", flat(30));
  cv::imwrite(folder / "I2.pgm", flat(20));
  cv::imwrite(folder / "I1.PNG", flat(10));
  cv::imwrite(folder / "I100.jpg", flat(40));
  std::ofstream(folder / "notes.txt") << "not a picture";
  ImageSequence camera({folder.text(), 10.0});
  REQUIRE(camera.files().size() == 4);
  for (int i = 0; i < 4; ++i) {
    const auto frame = camera.next();
    REQUIRE(frame);
    CHECK(frame->frame.gray(3, 3) == 10 * (i + 1));
    CHECK(frame->frame.number == static_cast<std::uint64_t>(i));
    CHECK(frame->frame.time == i * 100ms);
  }
  CHECK_FALSE(camera.next());
  CHECK(camera.health().state == "ended");
}

TEST_CASE("a picture comes when its time has come, and those that were missed are counted") {
  const Folder folder;
  for (int i = 0; i < 5; ++i) cv::imwrite(folder / ("f" + std::to_string(i) + ".pgm"), flat(i));
  ImageSequence camera({folder.text(), 20.0});
  CHECK(camera.newest(0ms)->frame.gray(0, 0) == 0);
  CHECK_FALSE(camera.newest(49ms));
  CHECK(camera.newest(50ms)->frame.gray(0, 0) == 1);
  const auto late = camera.newest(170ms);
  REQUIRE(late);
  CHECK(late->frame.gray(0, 0) == 3);
  CHECK(late->frame.time == 150ms);
  CHECK(camera.health().overwritten == 1);
  CHECK(camera.health().state == "streaming");
  CHECK(camera.newest(10s)->frame.gray(0, 0) == 4);
  CHECK_FALSE(camera.newest(20s));
  CHECK(camera.health().state == "ended");
  CHECK(camera.health().received == 5);
  CHECK(camera.actual().width == 8);
}

TEST_CASE("a numbered pattern begins at its smallest number and ends at the first gap") {
  const Folder folder;
  for (const char* name : {"I0007.pgm", "I0008.pgm", "I0009.pgm", "I0010.pgm", "I0012.pgm", "I011.pgm", "J0011.pgm"})
    cv::imwrite(folder / name, flat(1));
  const auto files = list_images(folder / "I%04d.pgm");
  REQUIRE(files.size() == 4);
  CHECK(files.front().filename() == "I0007.pgm");
  CHECK(files.back().filename() == "I0010.pgm");
  CHECK_THAT(failure_of([&] { list_images(folder / "K%04d.pgm"); }), Catch::Contains("K%04d.pgm"));
  CHECK_THAT(failure_of([&] { list_images(folder / "I%s.pgm"); }), Catch::Contains("no number"));
}

TEST_CASE("16 bits and colours become 8-bit grey") {
  const Folder folder;
  cv::Mat1w deep(2, 3, static_cast<std::uint16_t>(0));
  deep(0, 1) = 65535;
  deep(1, 2) = 100 * 257;
  for (const char* name : {"deep.png", "deep.pgm"}) {
    cv::imwrite(folder / name, deep);
    const cv::Mat1b gray = std::get<cv::Mat1b>(read_grey(folder / name));
    CHECK(gray(0, 0) == 0);
    CHECK(gray(0, 1) == 255);
    CHECK(gray(1, 2) == 100);
  }
  cv::Mat3b colour(1, 3);
  colour(0, 0) = {255, 0, 0};  // blue, green, red
  colour(0, 1) = {0, 255, 0};
  colour(0, 2) = {0, 0, 255};
  cv::imwrite(folder / "colour.png", colour);
  const cv::Mat1b luma = std::get<cv::Mat1b>(read_grey(folder / "colour.png"));
  // Rec. 601 luma of full blue, green and red: 0.114, 0.587 and 0.299 of 255; decoders round differently by one level.
  CHECK(std::abs(luma(0, 0) - 29) <= 1);
  CHECK(std::abs(luma(0, 1) - 150) <= 1);
  CHECK(std::abs(luma(0, 2) - 76) <= 1);
}

TEST_CASE("an unreadable picture is told by its file's name") {
  const Folder folder;
  cv::imwrite(folder / "a.pgm", flat(1));
  std::ofstream(folder / "b.pgm") << "P5\n8 6\n255\nshort";
  std::ofstream(folder / "c.png") << "no picture at all";
  ImageSequence camera({folder.text(), 10.0});
  CHECK(camera.next());
  CHECK_THAT(failure_of([&] { camera.next(); }), Catch::Contains("b.pgm"));
  CHECK_THAT(std::get<std::string>(read_grey(folder / "c.png")), Catch::Contains("c.png"));
  CHECK_THAT(std::get<std::string>(read_grey(folder / "d.png")),
             Catch::Contains("d.png") && Catch::Contains("no such file"));
}

TEST_CASE("a folder without pictures, no folder, and a rate of zero are refused") {
  const Folder folder;
  CHECK_THAT(failure_of([&] { ImageSequence({folder.text(), 10.0}); }), Catch::Contains("no picture in"));
  CHECK_THAT(failure_of([&] { ImageSequence({folder / "absent", 10.0}); }), Catch::Contains("neither a folder"));
  cv::imwrite(folder / "a.pgm", flat(1));
  CHECK_THAT(failure_of([&] { ImageSequence({folder.text(), 0.0}); }), Catch::Contains("rate"));
}

}  // namespace
}  // namespace tagdock
