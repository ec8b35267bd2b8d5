#include "app/explanation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <vector>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "app/html.h"
#include "app/svg.h"

namespace tagdock {
namespace {

using Vector2 = Eigen::Vector2d;

constexpr double picture_px = 330.0;    ///< width of a picture on the page
constexpr double band_px = 5.0;         ///< of the profiles, to each side of an edge
constexpr double bin_px = 0.25;         ///< of the model's curve
constexpr std::size_t most_dots = 250;  ///< pixels drawn in one profile

std::vector<unsigned char> png(const cv::Mat& picture) {
  // Small patches are enlarged, so that a browser shows pixels as squares.
  const int times = std::clamp(static_cast<int>(std::ceil(2.0 * picture_px / std::max(1, picture.cols))), 1, 12);
  cv::Mat large;
  cv::resize(picture, large, {}, times, times, cv::INTER_NEAREST);
  std::vector<unsigned char> bytes;
  cv::imencode(".png", large, bytes);
  return bytes;
}

/// Grey on the print's model, light blue outside.
cv::Mat3b shown(const cv::Mat1f& modelled) {
  cv::Mat3b picture(modelled.size(), cv::Vec3b(245, 235, 225));
  for (int row = 0; row < modelled.rows; ++row)
    for (int column = 0; column < modelled.cols; ++column)
      if (std::isfinite(modelled(row, column))) {
        const auto grey = cv::saturate_cast<unsigned char>(modelled(row, column));
        picture(row, column) = {grey, grey, grey};
      }
  return picture;
}

/// Red where the image is brighter than the model, blue where it is darker.
cv::Mat3b difference(const cv::Mat1b& patch, const cv::Mat1f& modelled, double full) {
  cv::Mat3b picture(modelled.size(), cv::Vec3b(245, 235, 225));
  for (int row = 0; row < modelled.rows; ++row)
    for (int column = 0; column < modelled.cols; ++column) {
      if (!std::isfinite(modelled(row, column))) continue;
      const double share = std::clamp((patch(row, column) - modelled(row, column)) / full, -1.0, 1.0);
      const auto rest = static_cast<unsigned char>(std::lround(255.0 * (1.0 - std::abs(share))));
      picture(row, column) = share > 0.0 ? cv::Vec3b(rest, rest, 255) : cv::Vec3b(255, rest, rest);
    }
  return picture;
}

/// Pixels beside one side: grey over the distance from it, seen and modelled.
void draw_profile(Svg& svg, const Vector2& corner, const std::string& title, const cv::Mat1b& patch,
                  const PhotometricExplanation& explained, const Vector2& from, const Vector2& to) {
  const Vector2 along = (to - from).normalized();
  const Vector2 outward(along.y(), -along.x());
  const double length = (to - from).norm();
  std::vector<Curve> curves;
  std::map<int, std::pair<double, int>> bins;
  std::vector<Vector2> dots;
  for (int row = 0; row < patch.rows; ++row)
    for (int column = 0; column < patch.cols; ++column) {
      if (!std::isfinite(explained.modelled(row, column))) continue;
      const Vector2 place = Vector2(column + explained.region.x, row + explained.region.y) - from;
      const double beside = along.dot(place);
      const double distance = outward.dot(place);
      if (beside < 0.2 * length || beside > 0.8 * length || std::abs(distance) > band_px) continue;
      dots.emplace_back(distance, patch(row, column));
      auto& [sum, count] = bins[static_cast<int>(std::floor(distance / bin_px))];
      sum += explained.modelled(row, column);
      ++count;
    }
  const std::size_t every = 1 + dots.size() / most_dots;
  for (std::size_t i = 0; i < dots.size(); i += every)
    curves.push_back({{dots[i], dots[i]}, "stroke:#4477aa;stroke-width:3;stroke-linecap:round", ""});
  Curve model{{}, "stroke:#cc3311;stroke-width:2", "fitted S-function"};
  for (const auto& [bin, value] : bins) model.points.emplace_back((bin + 0.5) * bin_px, value.first / value.second);
  curves.push_back(model);
  draw_diagram(svg, corner, 480, 260, title, "distance from the edge, outwards [px]", "grey", curves);
}

std::string row(const std::string& name, const std::string& value, const std::string& meaning) {
  return "<tr><th>" + name + "</th><td>" + value + "</td><td>" + meaning + "</td></tr>\n";
}

}  // namespace

std::string explanation_page(const cv::Mat1b& gray, const std::string& image, const std::string& family,
                             const PhotometricExplanation& explained) {
  const RefinedTag& tag = explained.tag;
  const cv::Mat1b patch = gray(explained.region);
  const double full = std::max(5.0, 5.0 * std::max(explained.noise_black, explained.noise_white));

  Svg pictures(3.0 * picture_px + 40.0, picture_px * patch.rows / patch.cols + 30.0);
  const double height = picture_px * patch.rows / patch.cols;
  const std::array<std::pair<std::string, cv::Mat>, 3> shows = {
      std::pair<std::string, cv::Mat>{"patch", patch},
      {"model", shown(explained.modelled)},
      {"residual: red brighter, blue darker than the model; full colour at " + plain(full, 1) + " grey levels",
       difference(patch, explained.modelled, full)}};
  for (std::size_t i = 0; i < shows.size(); ++i) {
    const Vector2 at(10.0 + static_cast<double>(i) * (picture_px + 10.0), 22.0);
    pictures.text(at - Vector2(0.0, 7.0), i == 2 ? "residual" : shows[i].first, 13);
    pictures.image(at, picture_px, height, "image/png", png(shows[i].second));
    const double scale = picture_px / patch.cols;
    std::vector<Vector2> outline;
    for (const Vector2& corner : tag.corners_px)
      outline.push_back(at + scale * (corner - Vector2(explained.region.x - 0.5, explained.region.y - 0.5)));
    if (i == 0) pictures.polygon(outline, "fill:none;stroke:#ee7733;stroke-width:1");
  }

  Svg profiles(980, 540);
  const std::array<std::string, 4> sides = {"top side", "right side", "bottom side", "left side"};
  for (std::size_t k = 0; k < 4; ++k)
    draw_profile(profiles, {k % 2 == 0 ? 0.0 : 490.0, k < 2 ? 0.0 : 270.0}, sides[k], patch, explained,
                 tag.corners_px[k], tag.corners_px[(k + 1) % 4]);

  const Eigen::Matrix2d& blur = explained.blur_px2;
  std::string page =
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>tag " + std::to_string(tag.id) +
      "</title><style>body{font-family:sans-serif;max-width:1040px;margin:1em auto;padding:0 1em}"
      "table{border-collapse:collapse}th,td{text-align:left;padding:.15em .8em;border-bottom:1px solid #ddd}"
      "svg{width:100%;height:auto}</style></head><body>\n<h1>" +
      html_text(family) + ", tag " + std::to_string(tag.id) + "</h1>\n<p>" + html_text(image) + "</p>\n" +
      pictures.text() + "<p>" + shows[2].first +
      ". Pixels outside of the print are not the model's.</p>\n<h2>Across the sides</h2>\n<p>Dots: pixels beside the "
      "middle of a side. Line: what the fitted model gives them (a step through a Gaussian blur, integrated over the "
      "pixel; with the other terms that were on).</p>\n" +
      profiles.text() + "<h2>Parameters</h2>\n<table>\n";
  page += row("terms", html_text(tag.terms), "of the model that were on");
  page += row("chi-square per pixel", plain(tag.chi2_per_pixel, 3), "about 1 if the model explains the image");
  page += row("residual", plain(tag.residual_rms, 2) + " grey levels rms", "");
  page += row("noise", plain(explained.noise_black, 2) + " / " + plain(explained.noise_white, 2) + " grey levels",
              "sigma on black / white, rounding included");
  page += row("black / white", plain(explained.black, 1) + " / " + plain(explained.white, 1),
              "light at the tag's centre [grey levels]");
  page += row("blur", plain(tag.blur_px, 3) + " px",
              "sigma, the pixel's box included; covariance xx " + plain(blur(0, 0), 3) + ", xy " +
                  plain(blur(0, 1), 3) + ", yy " + plain(blur(1, 1), 3) + " px&sup2;");
  page += row("spread of ink", plain(explained.bleed_modules, 4) + " modules", "how far black grows");
  page += row("tone curve", "exponent " + plain(explained.tone_exponent, 3), "1: grey is proportional to light");
  page += row("rejected", plain(100.0 * explained.rejected, 1) + " %", "of the border pixels, as in front of the tag");
  page +=
      row("inflation", plain(explained.inflation, 2), "of the covariance, for what neighbouring pixels err together");
  page += row("code", "hamming " + std::to_string(tag.hamming) + ", margin " + plain(tag.margin, 1), "");
  page +=
      "</table>\n<h2>Corners</h2>\n<table><tr><th></th><th>x [px]</th><th>y [px]</th><th>sigma x</th><th>sigma "
      "y</th></tr>\n";
  const std::array<std::string, 4> names = {"top left", "top right", "bottom right", "bottom left"};
  for (std::size_t k = 0; k < 4; ++k) {
    const auto i = 2 * static_cast<Eigen::Index>(k);
    page += "<tr><th>" + names[k] + "</th><td>" + plain(tag.corners_px[k].x(), 4) + "</td><td>" +
            plain(tag.corners_px[k].y(), 4) + "</td><td>" + plain(std::sqrt(tag.covariance_px2(i, i)), 4) +
            "</td><td>" + plain(std::sqrt(tag.covariance_px2(i + 1, i + 1)), 4) + "</td></tr>\n";
  }
  page += "</table>\n<p>Pixel (0, 0) is the centre of the top-left pixel.</p>\n</body></html>\n";
  return page;
}

}  // namespace tagdock
