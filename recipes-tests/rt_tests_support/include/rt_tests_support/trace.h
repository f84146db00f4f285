// --break-trace: leave a mark in the kernel trace at the first value above a limit.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rt_tests_support/options.h"

namespace rt_tests {

extern const std::vector<std::string> trace_folders;

class BreakTrace {
 public:
  // Opens the trace marker if --break-trace was given. Throws Failure if none of the folders has one to write to.
  BreakTrace(const Options& options, const char* program, const std::vector<std::string>& folders = trace_folders);
  ~BreakTrace();
  BreakTrace(const BreakTrace&) = delete;
  BreakTrace& operator=(const BreakTrace&) = delete;

  // True from the first value above the limit on; writes the mark then, without allocating.
  bool exceeded(int64_t value_ns, int64_t index) noexcept {
    return value_ns > limit_ns_ && (mark(value_ns, index), true);
  }

  std::string reason() const;  // empty when nothing exceeded the limit

 private:
  void mark(int64_t value_ns, int64_t index) noexcept;

  const char* program_;
  int64_t limit_ns_;
  int marker_ = -1;
  int64_t value_ns_ = 0;
  int64_t index_ = -1;
};

}  // namespace rt_tests
