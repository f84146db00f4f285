// What the kernel was doing around a value above a limit: --break-trace and --trace-threshold.
#pragma once

#include <time.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rt_tests_support/background.h"
#include "rt_tests_support/options.h"

namespace rt_tests {

// Looked into in this order: an instance made for us first, then the kernel's own trace.
extern const std::vector<std::string> trace_folders;

// For the first traced_at_most values above a limit the kernel's trace is copied to `<output>-trace-<index>.txt`, or that
// file tells which one holds it; the rest is counted. The thread that measures writes down the value, and no more (--break-trace: and marks the trace,
// its last deed); a thread of low priority takes a snapshot of the trace and copies that, while the kernel goes on
// recording. A kernel without snapshots (CONFIG_TRACER_SNAPSHOT) does not record while the trace itself is copied.
class OutlierTrace {
 public:
  static constexpr std::size_t traced_at_most = 16;
  static constexpr int period_ms = 50;

  // Opens the trace if one of the options was given. Throws Failure if none of the folders has one to write to.
  OutlierTrace(const Options& options, const char* program, const std::string& output,
               const std::vector<std::string>& folders = trace_folders);
  ~OutlierTrace();
  OutlierTrace(const OutlierTrace&) = delete;
  OutlierTrace& operator=(const OutlierTrace&) = delete;

  // On one thread. `at_ns` is when the value was there, on the clock of the timestamps. True when the measurement is
  // to end: from the first value above --break-trace on. Never allocates.
  bool exceeded(int64_t value_ns, int64_t index, int64_t at_ns) noexcept {
    return value_ns > lowest_limit_ns_ && note(value_ns, index, at_ns);
  }

  // After the last measurement: copies what is left, and warns of what could not be.
  void finish();

  std::string reason() const;  // empty when nothing exceeded --break-trace
  int64_t above() const noexcept { return static_cast<int64_t>(above_.load(std::memory_order_acquire)); }
  const std::vector<std::string>& files() const noexcept { return files_; }  // after finish(), without folder

 private:
  struct Outlier {
    int64_t value_ns, index, at_ns;
  };
  struct Copy {
    int64_t at_ns;
    char file[256];  // without folder: programs that share a trace share one
  };

  bool note(int64_t value_ns, int64_t index, int64_t at_ns) noexcept;
  void mark(const Outlier& outlier) noexcept;
  void take(bool going_on) noexcept;
  bool is_recording() const noexcept;
  bool write_at(const char* file, const char* text) noexcept;
  bool write_trace(int source, const Outlier& outlier, const char* elsewhere) noexcept;
  void name(char* path, std::size_t size, int64_t index) const noexcept;

  const char* program_;
  const std::string output_;
  const clockid_t clock_;
  int64_t threshold_ns_, break_ns_, lowest_limit_ns_;
  int folder_ = -1;
  int marker_ = -1;
  int lock_ = -1;
  std::string lock_path_;

  // Written by the thread that measures; what stands before above_ may be read.
  std::array<Outlier, traced_at_most> outliers_{};
  std::atomic<std::size_t> above_{0};
  Outlier broke_{0, -1, 0};

  // Of the thread that copies.
  std::size_t taken_ = 0;
  int problem_ = 0;  // errno of the last that went wrong
  std::vector<char> buffer_;
  std::vector<std::string> files_;
  std::optional<Background> copier_;
};

}  // namespace rt_tests
