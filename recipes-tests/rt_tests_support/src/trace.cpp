#include "rt_tests_support/trace.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <limits>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"

namespace rt_tests {

const std::vector<std::string> trace_folders = {"/sys/kernel/tracing", "/sys/kernel/debug/tracing"};

BreakTrace::BreakTrace(const Options& options, const char* program, const std::vector<std::string>& folders)
    : program_(program), limit_ns_(std::numeric_limits<int64_t>::max()) {
  if (!options.given("break_trace_us")) return;
  limit_ns_ = options.number("break_trace_us") * ns_per_us;
  std::string problems;
  for (const auto& folder : folders) {
    const std::string path = folder + "/trace_marker";
    marker_ = open(path.c_str(), O_WRONLY | O_CLOEXEC);
    if (marker_ >= 0) return;
    problems += (problems.empty() ? "" : ", ") + path + ": " + std::strerror(errno);
  }
  throw Failure("--break-trace needs tracefs mounted and the right to write to it: " + problems);
}

BreakTrace::~BreakTrace() {
  if (marker_ >= 0) close(marker_);
}

void BreakTrace::mark(int64_t value_ns, int64_t index) noexcept {
  if (index_ >= 0) return;
  char text[160];
  const int length = std::snprintf(text, sizeof text, "%s: %" PRId64 " ns at index %" PRId64 " above %" PRId64 " ns\n",
                                   program_, value_ns, index, limit_ns_);
  // A trace that cannot be written to is no reason to lose the measurement.
  [[maybe_unused]] const ssize_t written = write(marker_, text, static_cast<std::size_t>(length));
  value_ns_ = value_ns;
  index_ = index;
}

std::string BreakTrace::reason() const {
  if (index_ < 0) return "";
  return "ended by --break-trace: " + std::to_string(value_ns_) + " ns at index " + std::to_string(index_);
}

}  // namespace rt_tests
