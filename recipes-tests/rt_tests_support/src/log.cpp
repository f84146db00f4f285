#include "rt_tests_support/log.h"

#include <sys/utsname.h>

#include <algorithm>
#include <cstdio>

namespace rt_tests {
namespace {

// Up to this width every bin has its line, as in 2014. In a wider histogram a run of empty bins has only its first and
// last line, which draws the same: with every line, one sample of 60 s would make 60 million of them.
constexpr int64_t dense_us = 100000;

std::string line(int64_t us, int64_t count, bool comment) {
  char text[64];
  const unsigned long long size = static_cast<unsigned long long>(us < 0 ? -us : us);
  std::snprintf(text, sizeof text, "%s%s%06llu \t%06lld\n", comment ? "#" : "", us < 0 ? "-" : "", size,
                static_cast<long long>(count));
  return text;
}

// Lines of the bins first..last, ascending.
std::string histogram(const std::map<int64_t, int64_t>& bins, int64_t first, int64_t last, bool comment) {
  const bool dense = last - first <= dense_us;
  std::string text;
  int64_t at = first;
  const auto skip_to = [&](int64_t end) {  // [at, end)
    if (!dense && end - at > 2) {
      text += line(at, 0, comment) + line(end - 1, 0, comment);
      at = end;
    }
    for (; at < end; ++at) text += line(at, 0, comment);
  };
  for (auto bin = bins.lower_bound(first); bin != bins.end() && bin->first <= last; ++bin) {
    skip_to(bin->first);
    text += line(bin->first, bin->second, comment);
    at = bin->first + 1;
  }
  skip_to(last + 1);
  return text;
}

std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (char c : text) {
    if (c == '"' || c == '\\') result += '\\';
    result += c == '\n' ? ' ' : c;
  }
  return result + "\"";
}

// gnuplot refuses to draw when no point is in the range: the lower end is 1, as in 2014, unless all values are 0.
std::string xrange(Plot plot, int64_t min_us, int64_t max_us) {
  if (plot == Plot::cyclic) {
    const bool small = max_us < 200 && min_us > -200;
    const std::string end = std::to_string(small ? 200 : std::max(max_us, -min_us) + 50);
    return "[-" + end + ":" + end + "]";
  }
  const int64_t end = plot == Plot::oneshot && max_us < 400 ? 400 : std::max<int64_t>(max_us, 0) + 50;
  return (max_us > 0 ? "[1:" : "[0:") + std::to_string(end) + "]";
}

}  // namespace

std::string machine_title() {
  utsname names{};
  uname(&names);
  return std::string(names.nodename) + " " + names.sysname + " " + names.release;
}

std::string gnuplot_log(Plot plot, const std::string& title, const std::string& output, const Series& series,
                        const std::vector<std::string>& comments) {
  const bool any = series.n() > 0;
  const int64_t min_us = any ? series.min_us() : 0;
  const int64_t max_us = any ? series.max_us() : 0;
  const bool cyclic = plot == Plot::cyclic;
  std::string values = "no samples";
  if (any) {
    values = "MIN:  " + std::to_string(min_us) + "us  AVG: " + std::to_string(series.mean_us()) +
             "us MAX: " + std::to_string(max_us) + "us";
  }

  std::string text = "set title " + quoted(title) + "\n";
  text += std::string("set xlabel \"") + (cyclic ? "Jitter" : "Latency") + " in micro seconds - " + values + "\"\n";
  text += std::string("set ylabel \"Number of ") + (cyclic ? "samples" : "latency samples") + "\"\n";
  // With no bins to draw (all are comments, or there are no samples) gnuplot needs an upper end of the axis.
  const bool drawn = any && (cyclic || max_us > 0 || series.bins().count(0) > 0);
  text += std::string("set yrange [0.7:") + (drawn ? "" : "1") + "]\nset logscale y\n";
  text += "set xrange " + xrange(plot, min_us, max_us) + "\nset xtics add(500, 1000)\n";
  text += "set terminal jpeg size 1920,1080\n";
  text += "set output " + quoted(output + ".jpg") + "\n";
  text += "plot \"-\" u 1:2 t 'Latency_Occurrence' w steps\n# Plot data for gnuplot\n";
  for (const auto& comment : comments) text += "# " + comment + "\n";

  const auto& bins = series.bins();
  const std::string others = histogram(bins, 0, std::max<int64_t>(max_us, 0), false);
  const std::string negative = min_us < 0 ? histogram(bins, min_us, -1, !cyclic) : "";
  if (cyclic) {
    text += negative + others;
  } else {
    text += others + (negative.empty() ? "" : "# negative Values following\n" + negative);
  }
  return text + "\nend\n";
}

}  // namespace rt_tests
