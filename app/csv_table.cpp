#include "app/csv_table.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>

#include "app/failure.h"

namespace tagdock {
namespace {

[[noreturn]] void refuse(const std::string& sentence) { throw Failure(ExitCode::usage, sentence); }

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells(1);
  for (const char c : line)
    if (c == ',')
      cells.emplace_back();
    else
      cells.back() += c;
  return cells;
}

}  // namespace

CsvTable::CsvTable(const std::string& file) : file_(file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) refuse(file + ": cannot be opened");
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (number == 1 && line.starts_with("\xef\xbb\xbf")) line.erase(0, 3);
    if (line.empty()) continue;
    std::vector<std::string> cells = split(line);
    if (header_.empty()) {
      header_ = cells;
      continue;
    }
    if (cells.size() != header_.size())
      refuse(file + ":" + std::to_string(number) + ": " + std::to_string(cells.size()) +
             " values, but the header has " + std::to_string(header_.size()));
    rows_.push_back({number, cells});
  }
  if (header_.empty()) refuse(file + ":1: no header line");
}

bool CsvTable::has(const std::string& column) const {
  return std::find(header_.begin(), header_.end(), column) != header_.end();
}

std::string CsvTable::text(std::size_t row, const std::string& column) const {
  const auto found = std::find(header_.begin(), header_.end(), column);
  return found == header_.end() ? "" : rows_[row].cells[static_cast<std::size_t>(found - header_.begin())];
}

std::optional<double> CsvTable::number(std::size_t row, const std::string& column) const {
  const std::string cell = text(row, column);
  if (cell.empty()) return std::nullopt;
  double value = 0.0;
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  if (error != std::errc() || end != cell.data() + cell.size() || !std::isfinite(value))
    complain(row, column + " is " + cell + ", which is not a finite number");
  return value;
}

void CsvTable::complain(std::size_t row, const std::string& sentence) const {
  refuse(file_ + ":" + std::to_string(rows_[row].line) + ": " + sentence);
}

void CsvTable::need(const std::string& column) const {
  if (!has(column)) refuse(file_ + ":1: the column " + column + " is missing");
}

}  // namespace tagdock
