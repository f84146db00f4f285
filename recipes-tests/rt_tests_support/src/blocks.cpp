#include "rt_tests_support/blocks.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"

namespace rt_tests {
namespace {
// Four numbers of int64, their blanks and the end of the line: each write covers the whole of the one before.
constexpr int figures_bytes = 4 * 21;
}  // namespace

Blocks::Blocks(const std::string& output, const int64_t* rows, std::size_t capacity, std::size_t columns,
               std::function<std::size_t()> size, std::function<std::optional<int64_t>(std::size_t)> value,
               const CpuSet& cpus, int period_ms)
    : path_(output + ".npy.part"),
      figures_path_(output + ".live"),
      header_(npy_header(capacity, columns)),
      rows_(rows),
      row_bytes_(columns * sizeof *rows),
      size_(std::move(size)),
      value_(std::move(value)) {
  if (period_ms == 0) return;
  file_ = open(path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (file_ < 0) problem_ = errno;
  sync_folder(folder_of(path_));
  figures_file_ = open(figures_path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  writer_.emplace("rt_blocks", std::max(1, period_ms / figures_per_block), cpus, [this] { write(); });
}

Blocks::~Blocks() {
  end();
  if (file_ < 0) return;
  write_block();
  close(file_);
  if (written_ == 0) unlink(path_.c_str());
}

void Blocks::end() {
  writer_.reset();
  if (figures_file_ < 0) return;
  close(figures_file_);
  figures_file_ = -1;
  unlink(figures_path_.c_str());
}

void Blocks::write() noexcept {
  write_figures();
  if (++calls_ % figures_per_block == 0) write_block();
}

void Blocks::write_figures() noexcept {
  const std::size_t rows = size_();
  if (figures_file_ < 0 || rows == read_) return;
  for (; read_ < rows; ++read_) {
    const std::optional<int64_t> value = value_(read_);
    if (!value) continue;
    min_ns_ = values_ == 0 ? *value : std::min(min_ns_, *value);
    max_ns_ = values_ == 0 ? *value : std::max(max_ns_, *value);
    sum_ns_ += *value;
    ++values_;
  }
  if (values_ == 0) return;
  char line[figures_bytes + 1];
  std::snprintf(line, sizeof line, "%20lld %20lld %20lld %20lld\n", static_cast<long long>(values_),
                static_cast<long long>(min_ns_), static_cast<long long>(sum_ns_ / values_),
                static_cast<long long>(max_ns_));
  // What cannot be written is not shown: no result depends on it.
  write_all(figures_file_, {line, figures_bytes}, 0);
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
  end();
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
