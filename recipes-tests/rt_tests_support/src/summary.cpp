#include "rt_tests_support/summary.h"

#include "rt_tests_support/clock.h"

namespace rt_tests {
namespace {

constexpr std::size_t kept = 10;

template <class Before>
void keep(std::vector<Indexed>& best, const Indexed& item, Before before) {
  if (best.size() == kept && !before(item.value_ns, best.back().value_ns)) return;
  std::size_t at = best.size();
  while (at > 0 && before(item.value_ns, best[at - 1].value_ns)) --at;
  if (best.size() == kept) best.pop_back();
  best.insert(best.begin() + static_cast<std::ptrdiff_t>(at), item);
}

}  // namespace

void Series::add(int64_t value_ns, int64_t index) {
  ++n_;
  sum_ns_ += value_ns;
  keep(top_, {value_ns, index}, [](int64_t a, int64_t b) { return a > b; });
  keep(lowest_, {value_ns, index}, [](int64_t a, int64_t b) { return a < b; });
  const int64_t us = bin_us(value_ns);
  sum_us_ += us;
  ++bins_[us];
}

int64_t Series::bin_us(int64_t value_ns) const {
  const int64_t us = value_ns / ns_per_us;
  return rounding_ == Rounding::down && value_ns < us * ns_per_us ? us - 1 : us;
}

int64_t Series::mean_ns() const {
  const int64_t half = sum_ns_ < 0 ? -(n_ / 2) : n_ / 2;
  return (sum_ns_ + half) / n_;
}

std::string extremes(const Series& series, const std::string& pad, const std::string& gap) {
  if (series.n() == 0) return "no samples";
  const auto text = [&](int64_t us) { return pad + std::to_string(us) + "us"; };
  return "MIN: " + text(series.min_us()) + gap + "AVG: " + text(series.mean_us()) + gap + "MAX: " +
         text(series.max_us());
}

std::vector<std::string> boundary_lines(const Series& series) {
  const auto list = [&](const std::vector<Indexed>& items) {
    std::string text = "|";
    for (const auto& item : items) {
      text += std::to_string(series.bin_us(item.value_ns)) + ":" + std::to_string(item.index) + "|";
    }
    return text;
  };
  return {"Indices of top values(|latency:index|): " + list(series.top()),
          "Indices of lowest values(|latency:index|): " + list(series.lowest())};
}

}  // namespace rt_tests
