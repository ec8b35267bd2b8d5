#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

namespace tagdock {

/// A small SVG picture; coordinates are its own pixels, x right, y down. The same calls give the same bytes.
class Svg {
 public:
  Svg(double width, double height);

  void line(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const std::string& style);
  void polyline(const std::vector<Eigen::Vector2d>& points, const std::string& style);
  void polygon(const std::vector<Eigen::Vector2d>& points, const std::string& style);
  void circle(const Eigen::Vector2d& centre, double radius, const std::string& style);
  void rectangle(const Eigen::Vector2d& corner, double width, double height, const std::string& style);
  /// @param anchor  start, middle or end
  void text(const Eigen::Vector2d& place, const std::string& words, double size, const std::string& anchor = "start",
            const std::string& style = "");
  /// A picture file (its bytes, for example of a PNG) drawn into a rectangle.
  void image(const Eigen::Vector2d& corner, double width, double height, const std::string& media_type,
             const std::vector<unsigned char>& bytes);

  [[nodiscard]] std::string text() const;

 private:
  std::string body_;
  double width_;
  double height_;
};

/// Places of the ticks of an axis: multiples of 1, 2 or 5 times a power of ten, about `count` of them.
std::vector<double> axis_ticks(double least, double most, int count);

/// A number for people: at most `decimals` places, without needless zeros.
std::string plain(double value, int decimals);

/// A diagram: curves over two axes with ticks and labels.
struct Curve {
  std::vector<Eigen::Vector2d> points;
  std::string style;
  std::string name;
};
void draw_diagram(Svg& svg, const Eigen::Vector2d& corner, double width, double height, const std::string& title,
                  const std::string& x_label, const std::string& y_label, const std::vector<Curve>& curves);

}  // namespace tagdock
