// Files written whole or not at all.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace rt_tests {

using Bytes = std::pair<const void*, std::size_t>;

// At an offset of an open file; false, and errno, if not all of it could be. Allocates nothing.
bool write_all(int file, const Bytes& piece, std::size_t offset) noexcept;

void sync_folder(const std::string& folder);  // so that a new name in it survives a power cut

// Writes the pieces under a temporary name, flushes them to disk, renames. Throws Failure; leaves nothing then.
void write_file(const std::string& path, const std::vector<Bytes>& pieces);

// NumPy format 1.0, int64, C order.
std::string npy_header(std::size_t rows, std::size_t columns);
void write_npy(const std::string& path, const int64_t* data, std::size_t rows, std::size_t columns);

std::string folder_of(const std::string& path);  // "." for a bare name
std::string name_of(const std::string& path);

// Before anything is measured: throws UsageError if the folder is not there or not writable.
void require_writable_folder(const std::string& folder);

}  // namespace rt_tests
