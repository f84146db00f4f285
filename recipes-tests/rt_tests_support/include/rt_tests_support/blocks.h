// Writes the samples of a long run to the disk while it measures: a power cut loses only the newest block.
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

// Appends the new rows to `<npy>.part` every block_ms, from a thread of low priority. It reads the number of rows that
// the measuring thread publishes with each row; nothing else passes between the two. The part has the header of an npy
// with all rows asked for, followed by fewer rows.
class Blocks {
 public:
  // To be made before the measurement. Writes nothing for a run that is expected to end within one block. `cpus` are
  // those of the writing thread.
  template <std::size_t Columns>
  Blocks(const std::string& npy, const Samples<Columns>& samples, int64_t expected_ns, const CpuSet& cpus,
         int period_ms = block_ms)
      : Blocks(npy, samples.data(), samples.capacity(), Columns, [&samples] { return samples.size(); }, cpus,
               expected_ns > period_ms * int64_t{1000000} ? period_ms : 0) {}

  // Without an earlier discard(), for instance when the results could not be written, the part stays, with all rows.
  ~Blocks();
  Blocks(const Blocks&) = delete;
  Blocks& operator=(const Blocks&) = delete;

  // To be called when the results are on the disk: removes the part, and warns if it could not be written.
  void discard();

 private:
  Blocks(const std::string& npy, const int64_t* rows, std::size_t capacity, std::size_t columns,
         std::function<std::size_t()> size, const CpuSet& cpus, int period_ms);
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
