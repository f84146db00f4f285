#include "rt_tests_support/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "rt_tests_support/errors.h"

namespace rt_tests {

bool write_all(int file, const Bytes& piece, std::size_t offset) noexcept {
  auto next = static_cast<const char*>(piece.first);
  std::size_t remaining = piece.second;
  while (remaining > 0) {
    const ssize_t written = pwrite(file, next, std::min<std::size_t>(remaining, 1 << 24), static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    next += written;
    remaining -= static_cast<std::size_t>(written);
    offset += static_cast<std::size_t>(written);
  }
  return true;
}

void sync_folder(const std::string& folder) {
  const int handle = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (handle < 0) return;
  fsync(handle);
  close(handle);
}

std::string folder_of(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

std::string name_of(const std::string& path) { return path.substr(path.rfind('/') + 1); }

void require_writable_folder(const std::string& folder) {
  struct stat state {};
  const bool there = stat(folder.c_str(), &state) == 0;
  if (there && !S_ISDIR(state.st_mode)) throw UsageError("output folder '" + folder + "' (--out-dir, -p) is no folder");
  if (!there || access(folder.c_str(), W_OK | X_OK) != 0) {
    throw UsageError("output folder '" + folder + "' (--out-dir, -p) must exist and be writable: " +
                     std::strerror(errno));
  }
}

void write_file(const std::string& path, const std::vector<Bytes>& pieces) {
  const std::string temporary = folder_of(path) + "/." + std::to_string(getpid()) + "-" + name_of(path);
  const int file = open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  bool good = file >= 0;
  std::size_t offset = 0;
  for (const auto& piece : pieces) {
    good = good && write_all(file, piece, offset);
    offset += piece.second;
  }
  good = good && fsync(file) == 0;
  int reason = errno;
  if (file >= 0 && close(file) != 0 && good) {
    good = false;
    reason = errno;
  }
  if (good && rename(temporary.c_str(), path.c_str()) != 0) {
    good = false;
    reason = errno;
  }
  if (!good) {
    if (file >= 0) unlink(temporary.c_str());
    throw Failure("cannot write " + path + ": " + std::strerror(reason));
  }
  sync_folder(folder_of(path));
}

std::string npy_header(std::size_t rows, std::size_t columns) {
#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
  const std::string type = "<i8";
#else
  const std::string type = ">i8";
#endif
  std::string dictionary = "{'descr': '" + type + "', 'fortran_order': False, 'shape': (" + std::to_string(rows) +
                           ", " + std::to_string(columns) + "), }";
  // Magic, version and length take 10 bytes; data begins at a multiple of 64.
  const std::size_t total = (10 + dictionary.size() + 1 + 63) / 64 * 64;
  dictionary.resize(total - 10 - 1, ' ');
  dictionary += '\n';
  std::string header("\x93NUMPY\x01\x00", 8);
  header += static_cast<char>(dictionary.size() & 0xff);
  header += static_cast<char>(dictionary.size() >> 8);
  return header + dictionary;
}

void write_npy(const std::string& path, const int64_t* data, std::size_t rows, std::size_t columns) {
  const std::string header = npy_header(rows, columns);
  write_file(path, {{header.data(), header.size()}, {data, rows * columns * sizeof *data}});
}

}  // namespace rt_tests
