#include "rt_tests_support/blocks.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"

namespace rt_tests {

Blocks::Blocks(const std::string& npy, const int64_t* rows, std::size_t capacity, std::size_t columns,
               std::function<std::size_t()> size, const CpuSet& cpus, int period_ms)
    : path_(npy + ".part"),
      header_(npy_header(capacity, columns)),
      rows_(rows),
      row_bytes_(columns * sizeof *rows),
      size_(std::move(size)) {
  if (period_ms == 0) return;
  file_ = open(path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (file_ < 0) problem_ = errno;
  sync_folder(folder_of(path_));
  writer_.emplace("rt_blocks", period_ms, cpus, [this] { write_block(); });
}

Blocks::~Blocks() {
  writer_.reset();
  if (file_ < 0) return;
  write_block();
  close(file_);
  if (written_ == 0) unlink(path_.c_str());
}

void Blocks::write_block() noexcept {
  const std::size_t rows = size_();
  if (file_ < 0 || rows == written_) return;
  // Rows that could not be written are written again with the next block, at the same offset.
  const Bytes block{reinterpret_cast<const char*>(rows_) + written_ * row_bytes_, (rows - written_) * row_bytes_};
  const bool good = (written_ > 0 || write_all(file_, {header_.data(), header_.size()}, 0)) &&
                    write_all(file_, block, header_.size() + written_ * row_bytes_) && fdatasync(file_) == 0;
  problem_ = good ? 0 : errno;
  if (good) written_ = rows;
}

void Blocks::discard() {
  writer_.reset();
  if (problem_ != 0) {
    warning("cannot write " + path_ + ": " + std::strerror(problem_) +
            "; a power cut would have lost all but the first " + std::to_string(written_) + " rows");
  }
  if (file_ < 0) return;
  close(file_);
  file_ = -1;
  unlink(path_.c_str());
}

}  // namespace rt_tests
