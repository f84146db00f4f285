// Copies of the kernel's trace around values above a limit: --break-trace and --trace-threshold.
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

// The folders of a trace, tried in this order: the instance that the runner makes, then the kernel's own trace.
extern const std::vector<std::string> trace_folders;

// Copies the kernel's trace to `<output>-trace-<index>.txt` for the first `traced_at_most` values above a limit, and
// counts the others. Values that one copy covers share it: their files name the file that holds it.
//
// The measuring thread only stores the value. Above --break-trace it also writes a marker into the trace and stops the
// recording: the measurement ends there, and later events must not overwrite the marker before it is copied. For
// --trace-threshold a thread of low priority takes a snapshot and copies that while the kernel goes on recording.
// Without snapshots (CONFIG_TRACER_SNAPSHOT) recording pauses while the trace itself is copied.
class OutlierTrace {
 public:
  static constexpr std::size_t traced_at_most = 16;
  static constexpr int period_ms = 50;

  // Opens the trace if one of the options was given. Throws Failure if no folder has a trace that may be written to.
  // `cpus` are those of the thread that copies.
  OutlierTrace(const Options& options, const char* program, const std::string& output,
               const CpuSet& cpus, const std::vector<std::string>& folders = trace_folders);
  ~OutlierTrace();
  OutlierTrace(const OutlierTrace&) = delete;
  OutlierTrace& operator=(const OutlierTrace&) = delete;

  // To be called from one thread only; never allocates. `at_ns` is the time of the value on the clock of the
  // timestamps. Returns true when the measurement must end: from the first value above --break-trace on.
  bool exceeded(int64_t value_ns, int64_t index, int64_t at_ns) noexcept {
    return value_ns > lowest_limit_ns_ && note(value_ns, index, at_ns);
  }

  // After the last measurement: copies the remaining traces, restarts the recording, and warns of failed copies.
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
    char file[256];  // without its folder: programs that share a trace write into the same one
  };

  bool note(int64_t value_ns, int64_t index, int64_t at_ns) noexcept;
  void mark(const Outlier& outlier) noexcept;
  void copy_new(bool measuring) noexcept;
  bool stop_recording() noexcept;
  bool write_at(const char* file, const char* text) noexcept;
  bool write_trace(int source, const Outlier& outlier, const char* shared_file) noexcept;
  void name(char* path, std::size_t size, int64_t index) const noexcept;

  const char* program_;
  const std::string output_;
  const clockid_t clock_;
  int64_t threshold_ns_, break_ns_, lowest_limit_ns_;
  int folder_ = -1;
  int marker_ = -1;
  int last_copy_ = -1;  // a file with the last Copy, next to the outputs; the last program that uses it removes it
  std::string last_copy_path_;

  // Written by the measuring thread. Other threads may read the outliers before `above_`.
  std::array<Outlier, traced_at_most> outliers_{};
  std::atomic<std::size_t> above_{0};
  Outlier broke_{0, -1, 0};           // index -1: no value above --break-trace yet
  bool stopped_recording_ = false;    // by the marker, to be restarted by finish()

  // Used by the copying thread, and by finish() after that thread ended.
  std::size_t copied_ = 0;
  int problem_ = 0;  // errno of the last copy that failed
  std::vector<char> buffer_;
  std::vector<std::string> files_;
  std::optional<Background> copier_;
};

}  // namespace rt_tests
