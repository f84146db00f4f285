// The summary of a series of values: extremes, mean, the ten highest and lowest, and a histogram of 1 us bins.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace rt_tests {

struct Indexed {
  int64_t value_ns;
  int64_t index;
};

// How nanoseconds become whole microseconds. The 2014 programs rounded latencies towards zero and jitter down.
enum class Rounding { towards_zero, down };

class Series {
 public:
  explicit Series(std::string name, Rounding rounding = Rounding::towards_zero)
      : name_(std::move(name)), rounding_(rounding) {}

  void add(int64_t value_ns, int64_t index);

  const std::string& name() const { return name_; }
  int64_t n() const { return n_; }
  int64_t min_ns() const { return lowest_.front().value_ns; }  // min, mean and max only if n > 0
  int64_t max_ns() const { return top_.front().value_ns; }
  int64_t mean_ns() const;  // rounded to the nearest nanosecond
  const std::vector<Indexed>& top() const { return top_; }        // at most ten, highest first, then by index
  const std::vector<Indexed>& lowest() const { return lowest_; }  // at most ten, lowest first, then by index

  int64_t bin_us(int64_t value_ns) const;  // the bin of a value
  const std::map<int64_t, int64_t>& bins() const { return bins_; }  // whole microseconds to count
  int64_t min_us() const { return bins_.begin()->first; }           // of the bins; only if n > 0
  int64_t max_us() const { return bins_.rbegin()->first; }
  int64_t mean_us() const { return sum_us_ / n_; }  // of the bins, towards zero, as in 2014

 private:
  std::string name_;
  Rounding rounding_;
  int64_t n_ = 0;
  int64_t sum_ns_ = 0;
  int64_t sum_us_ = 0;
  std::vector<Indexed> top_;
  std::vector<Indexed> lowest_;
  std::map<int64_t, int64_t> bins_;
};

// "MIN: <pad>60us<gap>AVG: <pad>101us<gap>MAX: <pad>138us" of the bins, as in 2014; "no samples" if there are none.
std::string extremes(const Series& series, const std::string& pad, const std::string& gap);

// The lines with the ten highest and the ten lowest values, |us:index|.
std::vector<std::string> boundary_lines(const Series& series);

}  // namespace rt_tests
