// Where measurements go while they are taken.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace rt_tests {

// Rows of int64, room for all of them allocated and touched before the first measurement. One thread appends, and
// never waits or allocates; any thread may read the rows before size(), because a row is complete before it counts.
template <std::size_t Columns>
class Samples {
 public:
  using Row = std::array<int64_t, Columns>;

  explicit Samples(std::size_t capacity) : rows_(capacity) {}

  // Returns false, and keeps nothing, when all rows are in use.
  bool append(const Row& row) noexcept {
    const std::size_t size = size_.load(std::memory_order_relaxed);
    if (size == rows_.size()) return false;
    rows_[size] = row;
    size_.store(size + 1, std::memory_order_release);
    return true;
  }

  std::size_t size() const noexcept { return size_.load(std::memory_order_acquire); }
  std::size_t capacity() const noexcept { return rows_.size(); }
  bool full() const noexcept { return size() == rows_.size(); }
  const Row& operator[](std::size_t index) const noexcept { return rows_[index]; }
  const int64_t* data() const noexcept { return rows_.data()->data(); }

 private:
  std::vector<Row> rows_;
  std::atomic<std::size_t> size_{0};
};

// Events of one kind: all are counted, the indices of the first thousand are listed.
class Events {
 public:
  static constexpr std::size_t listed = 1000;

  Events() { indices_.reserve(listed); }

  void note(int64_t index) noexcept {
    ++count_;
    if (indices_.size() < listed) indices_.push_back(index);  // within the reserved room: no allocation
  }

  int64_t count() const noexcept { return count_; }
  const std::vector<int64_t>& indices() const noexcept { return indices_; }

 private:
  int64_t count_ = 0;
  std::vector<int64_t> indices_;
};

}  // namespace rt_tests
