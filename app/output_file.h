#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace tagdock {

/// Looks at a file that is to be written, before the work whose result it gets. All throw Failure(usage) with the
/// option, the file and what would be right; an empty name is no file and passes.
/// @param option  as the person gave it, for example --output

/// Refuses a file that is one of those that are read, under whatever name.
void check_not_an_input(const std::string& option, const std::filesystem::path& file,
                        const std::vector<std::string>& inputs);

/// All files that a verb writes: none of them may be one that is read or another one that is written, and each must be
/// writable.
/// @param outputs  option and file
void check_outputs(const std::vector<std::pair<std::string, std::filesystem::path>>& outputs,
                   const std::vector<std::string>& inputs);

/// The files right in a folder, to be told as inputs; none if it cannot be read.
std::vector<std::string> files_in(const std::filesystem::path& folder);

/// Refuses a file that is there.
void check_new(const std::string& option, const std::filesystem::path& file);

/// Tries whether it can be written; a file that is there keeps what is in it.
void check_writable(const std::string& option, const std::filesystem::path& file);

/// Makes a folder for results, or takes one that is there.
/// @param results  files that a folder for new results does not have yet
void make_result_folder(const std::string& option, const std::filesystem::path& folder,
                        const std::vector<std::string>& results);

}  // namespace tagdock
