#include "app/csv_table.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>

#include "app/failure.h"

namespace tagdock {
namespace {

std::string without_margins(const std::string& text) {
  const std::size_t first = text.find_first_not_of(" \t");
  return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells(1);
  for (const char letter : line) {
    if (letter == ',')
      cells.emplace_back();
    else
      cells.back() += letter;
  }
  for (std::string& cell : cells) cell = without_margins(cell);
  return cells;
}

}  // namespace

CsvTable CsvTable::load(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream || std::filesystem::is_directory(file))
    throw Failure(ExitCode::usage, file.string() + ": cannot be opened");
  CsvTable table;
  table.file_ = file.string();
  std::string text;
  for (int number = 1; std::getline(stream, text); ++number) {
    if (!text.empty() && text.back() == '\r') text.pop_back();
    if (number == 1 && text.starts_with("\xef\xbb\xbf")) text.erase(0, 3);
    if (text.empty()) continue;
    std::vector<std::string> cells = split(text);
    if (table.header_.empty()) {
      table.header_ = std::move(cells);
      continue;
    }
    table.lines_.push_back({number, std::move(cells)});
    if (table.lines_.back().cells.size() != table.header_.size())
      table.refuse(table.lines_.size() - 1, "has " + std::to_string(table.lines_.back().cells.size()) +
                                                " values; the header names " + std::to_string(table.header_.size()));
  }
  if (table.header_.empty()) throw Failure(ExitCode::usage, table.file_ + ":1: the file is empty");
  return table;
}

std::size_t CsvTable::column(const std::string& name) const {
  for (std::size_t i = 0; i < header_.size(); ++i)
    if (header_[i] == name) return i;
  throw Failure(ExitCode::usage, file_ + ":1: the column " + name + " is missing");
}

double CsvTable::number(std::size_t row, std::size_t column) const {
  const std::string& cell = lines_[row].cells[column];
  double value = 0.0;
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  if (cell.empty() || error != std::errc() || end != cell.data() + cell.size() || !std::isfinite(value))
    refuse(row, header_[column] + " is " + cell + ", which is not a finite number");
  return value;
}

int CsvTable::integer(std::size_t row, std::size_t column) const {
  const double value = number(row, column);
  if (value != std::floor(value) || std::abs(value) > 1e9)
    refuse(row, header_[column] + " is " + lines_[row].cells[column] + "; it must be a whole number");
  return static_cast<int>(value);
}

bool CsvTable::has(const std::string& column) const {
  return std::find(header_.begin(), header_.end(), column) != header_.end();
}

std::string CsvTable::text(std::size_t row, const std::string& column) const {
  const auto found = std::find(header_.begin(), header_.end(), column);
  return found == header_.end() ? "" : lines_[row].cells[static_cast<std::size_t>(found - header_.begin())];
}

std::optional<double> CsvTable::number(std::size_t row, const std::string& column) const {
  if (text(row, column).empty()) return std::nullopt;
  return number(row, this->column(column));
}

void CsvTable::refuse(std::size_t row, const std::string& sentence) const {
  throw Failure(ExitCode::usage, file_ + ":" + std::to_string(lines_[row].number) + ": " + sentence);
}

}  // namespace tagdock
