#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <Eigen/Core>

namespace tagdock {

/// How something is drawn: colours as 0xRRGGBB, none below zero.
struct Ink {
  int fill = -1;
  int stroke = -1;
  double width = 1.0;
  double opacity = 1.0;
};

/// A drawing that can become SVG (in a web page) or PDF (on paper). Coordinates are its own pixels, x right, y down.
class Figure {
 public:
  Figure(std::string title, double width, double height);

  void shape(std::vector<Eigen::Vector2d> points, bool closed, const Ink& ink);
  void line(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const Ink& ink);
  void circle(const Eigen::Vector2d& centre, double radius, const Ink& ink);
  void rectangle(const Eigen::Vector2d& corner, double width, double height, const Ink& ink);
  /// @param anchor  0 starts there, 0.5 is centred there, 1 ends there
  void text(const Eigen::Vector2d& place, const std::string& words, double size = 11.0, double anchor = 0.0);

  [[nodiscard]] const std::string& title() const { return title_; }
  [[nodiscard]] double width() const { return width_; }
  [[nodiscard]] double height() const { return height_; }
  [[nodiscard]] std::string svg() const;

  struct Shape {
    std::vector<Eigen::Vector2d> points;
    bool closed;
    Ink ink;
  };
  struct Circle {
    Eigen::Vector2d centre;
    double radius;
    Ink ink;
  };
  struct Text {
    Eigen::Vector2d place;
    std::string words;
    double size;
    double anchor;
  };
  using Part = std::variant<Shape, Circle, Text>;
  [[nodiscard]] const std::vector<Part>& parts() const { return parts_; }

 private:
  std::string title_;
  double width_;
  double height_;
  std::vector<Part> parts_;
};

/// Two axes with ticks and labels; maps values to the figure.
struct Axes {
  Eigen::Vector2d least = Eigen::Vector2d::Zero();
  Eigen::Vector2d most = Eigen::Vector2d::Ones();
  Eigen::Vector2d corner{60.0, 30.0};  ///< of the plot's area in the figure
  double width = 400.0;
  double height = 300.0;
  bool y_down = false;  ///< as pictures have it
  /// What stands below the x axis in place of numbers, at its values, evenly spread; where they would touch, only every
  /// second, fifth, tenth.. is written.
  std::vector<std::pair<double, std::string>> names;

  [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& value) const;
  void draw(Figure& figure, const std::string& x_label, const std::string& y_label) const;
};

/// A report: a verdict, sentences, tables and figures; one self-contained HTML file or a PDF.
struct Report {
  std::string title;
  bool good = false;
  std::vector<std::string> verdict;
  std::vector<std::string> sentences;
  struct Table {
    std::string title;
    std::vector<std::vector<std::string>> rows;  ///< the first is the header
  };
  std::vector<Table> tables;
  std::vector<Figure> figures;
};

std::string to_html(const Report& report);
/// Throws Failure(usage) if the file cannot be written.
void to_pdf(const Report& report, const std::filesystem::path& file);

}  // namespace tagdock
