#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace tagdock {

/// A CSV file as CONTRACTS.md has them: one header line, commas, no quotes; columns that nobody asks for are passed
/// over. Every refusal is a Failure(usage) that names file, line, column and value.
class CsvTable {
 public:
  static CsvTable load(const std::filesystem::path& file);

  [[nodiscard]] std::size_t rows() const { return lines_.size(); }
  /// The place of a column. Throws when it is missing.
  [[nodiscard]] std::size_t column(const std::string& name) const;
  [[nodiscard]] double number(std::size_t row, std::size_t column) const;
  [[nodiscard]] int integer(std::size_t row, std::size_t column) const;

  // Columns that may be missing.
  [[nodiscard]] bool has(const std::string& column) const;
  /// Empty where the column is not there.
  [[nodiscard]] std::string text(std::size_t row, const std::string& column) const;
  /// None where the column is not there or the cell is empty.
  [[nodiscard]] std::optional<double> number(std::size_t row, const std::string& column) const;

  /// A refusal of a row in the same form; for checks that span several values.
  [[noreturn]] void refuse(std::size_t row, const std::string& sentence) const;

 private:
  struct Line {
    int number = 0;
    std::vector<std::string> cells;
  };
  std::string file_;
  std::vector<std::string> header_;
  std::vector<Line> lines_;
};

}  // namespace tagdock
