// Writes the samples of a long run to the disk while it measures, and figures of them: a power cut loses only the newest
// block, and who waits sees what came so far.
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
constexpr int figures_per_block = 5;

// Appends the new rows to `<output>.npy.part` every block_ms, from a thread of low priority. It reads the number of rows
// that the measuring thread publishes with each row; nothing else passes between the two. The part has the header of an
// npy with all rows asked for, followed by fewer rows. Five times as often it overwrites `<output>.live`: how many values
// there are, the lowest, the mean and the highest, in ns. That file is for the eye, and lost with a power cut.
class Blocks {
 public:
  // To be made before the measurement. Writes nothing for a run that is expected to end within one block. `cpus` are
  // those of the writing thread. `value_of(samples, row)` is the value of a row, if it has one.
  template <std::size_t Columns, class ValueOf>
  Blocks(const std::string& output, const Samples<Columns>& samples, int64_t expected_ns, const CpuSet& cpus,
         ValueOf value_of, int period_ms = block_ms)
      : Blocks(output, samples.data(), samples.capacity(), Columns, [&samples] { return samples.size(); },
               [&samples, value_of](std::size_t row) { return value_of(samples, row); }, cpus,
               expected_ns > period_ms * int64_t{1000000} ? period_ms : 0) {}

  // Without an earlier discard(), for instance when the results could not be written, the part stays, with all rows.
  ~Blocks();
  Blocks(const Blocks&) = delete;
  Blocks& operator=(const Blocks&) = delete;

  // To be called when the results are on the disk: removes the part, and warns if it could not be written.
  void discard();

 private:
  Blocks(const std::string& output, const int64_t* rows, std::size_t capacity, std::size_t columns,
         std::function<std::size_t()> size, std::function<std::optional<int64_t>(std::size_t)> value,
         const CpuSet& cpus, int period_ms);
  void write() noexcept;
  void write_block() noexcept;
  void write_figures() noexcept;
  void end();

  const std::string path_, figures_path_;
  const std::string header_;
  const int64_t* const rows_;
  const std::size_t row_bytes_;
  const std::function<std::size_t()> size_;
  const std::function<std::optional<int64_t>(std::size_t)> value_;
  int file_ = -1;
  std::size_t written_ = 0;  // rows
  int problem_ = 0;          // errno of the last block
  int figures_file_ = -1;
  std::size_t read_ = 0;  // rows whose values are in these
  int64_t values_ = 0, min_ns_ = 0, max_ns_ = 0, sum_ns_ = 0;
  int calls_ = 0;
  std::optional<Background> writer_;
};

}  // namespace rt_tests
