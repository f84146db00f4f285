// Files written whole or not at all.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace rt_tests {

using Bytes = std::pair<const void*, std::size_t>;

// Writes a piece at an offset of an open file. Returns false, with errno set, unless all of it was written. Allocates
// nothing.
bool write_all(int file, const Bytes& piece, std::size_t offset) noexcept;

void sync_folder(const std::string& folder);  // after a rename: the new name then survives a power cut

// Writes the pieces one after the other under a temporary name, flushes them to disk and renames the file. Throws
// Failure, and then leaves no file.
void write_file(const std::string& path, const std::vector<Bytes>& pieces);

// The header of a NumPy file: format 1.0, int64, C order.
std::string npy_header(std::size_t rows, std::size_t columns);
void write_npy(const std::string& path, const int64_t* data, std::size_t rows, std::size_t columns);

std::string folder_of(const std::string& path);  // "." for a bare name
std::string name_of(const std::string& path);

// Throws UsageError if the folder does not exist or cannot be written to. To be called before anything is measured.
void require_writable_folder(const std::string& folder);

}  // namespace rt_tests
