#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

namespace tagdock {

/// A CSV file of ours: a header line, then as many values a line. Quotes are not needed and not read.
/// What is wrong with it is thrown as Failure(usage) with file and line.
class CsvTable {
 public:
  explicit CsvTable(const std::string& file);

  [[nodiscard]] std::size_t rows() const { return rows_.size(); }
  [[nodiscard]] bool has(const std::string& column) const;

  /// Empty where the column is not there.
  [[nodiscard]] std::string text(std::size_t row, const std::string& column) const;
  [[nodiscard]] std::optional<double> number(std::size_t row, const std::string& column) const;

  [[noreturn]] void complain(std::size_t row, const std::string& sentence) const;
  void need(const std::string& column) const;

 private:
  struct Row {
    int line;
    std::vector<std::string> cells;
  };

  std::string file_;
  std::vector<std::string> header_;
  std::vector<Row> rows_;
};

}  // namespace tagdock
