// The samples of a long run on disk while it still measures: a power cut costs what is newer than the last block.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "rt_tests_support/background.h"
#include "rt_tests_support/samples.h"

namespace rt_tests {

constexpr int block_ms = 5000;

// Appends the rows that came since to `<npy>.part` every block_ms, from a thread of low priority. The measuring thread
// has no part in it: the number of rows that it publishes with each is all there is between them. The part is an npy
// whose header announces every row asked for, and which ends sooner.
class Blocks {
 public:
  // Before the measurement. Nothing happens for one expected to be over within one block.
  template <std::size_t Columns>
  Blocks(const std::string& npy, const Samples<Columns>& samples, int64_t expected_ns, int period_ms = block_ms)
      : Blocks(npy, samples.data(), samples.capacity(), Columns, [&samples] { return samples.size(); },
               expected_ns > period_ms * int64_t{1000000} ? period_ms : 0) {}

  // Without discard(), as when the results could not be written, the part stays, with all rows.
  ~Blocks();
  Blocks(const Blocks&) = delete;
  Blocks& operator=(const Blocks&) = delete;

  // Once the results stand on disk: removes the part, and warns if it would not have been whole.
  void discard();

 private:
  Blocks(const std::string& npy, const int64_t* rows, std::size_t capacity, std::size_t columns,
         std::function<std::size_t()> size, int period_ms);
  void write_block() noexcept;

  const std::string path_;
  const std::string header_;
  const int64_t* const rows_;
  const std::size_t row_bytes_;
  const std::function<std::size_t()> size_;
  int file_ = -1;
  std::size_t written_ = 0;  // rows
  int problem_ = 0;          // errno of the last block
  std::optional<Background> writer_;
};

}  // namespace rt_tests
