#include "rt_tests_support/trace.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <climits>
#include <cstdio>
#include <cstring>
#include <limits>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"

namespace rt_tests {
namespace {

constexpr std::size_t buffer_bytes = 64 * 1024;

int64_t limit_of(const Options& options, const char* key) {
  return options.has(key) && options.given(key) ? options.number(key) * ns_per_us : std::numeric_limits<int64_t>::max();
}

// Only one program at a time uses a trace, and what is known of its copies: a lock of its folder.
class TraceLock {
 public:
  explicit TraceLock(int folder) noexcept : folder_(folder) {
    while (flock(folder_, LOCK_EX) != 0 && errno == EINTR) {
    }
  }
  ~TraceLock() { flock(folder_, LOCK_UN); }
  TraceLock(const TraceLock&) = delete;
  TraceLock& operator=(const TraceLock&) = delete;

 private:
  const int folder_;
};

}  // namespace

const std::vector<std::string> trace_folders = {"/sys/kernel/tracing/instances/rtrun", "/sys/kernel/tracing",
                                                "/sys/kernel/debug/tracing"};

OutlierTrace::OutlierTrace(const Options& options, const char* program, const std::string& output,
                           const CpuSet& cpus, const std::vector<std::string>& folders)
    : program_(program),
      output_(output),
      clock_(clock_of(options.text("clock"))),
      threshold_ns_(limit_of(options, "trace_threshold_us")),
      break_ns_(limit_of(options, "break_trace_us")),
      lowest_limit_ns_(std::min(threshold_ns_, break_ns_)) {
  if (lowest_limit_ns_ == std::numeric_limits<int64_t>::max()) return;
  std::string problems;
  for (const auto& folder : folders) {
    const std::string path = folder + "/trace_marker";
    marker_ = open(path.c_str(), O_WRONLY | O_CLOEXEC);
    if (marker_ >= 0) {
      folder_ = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
      break;
    }
    problems += (problems.empty() ? "" : ", ") + path + ": " + std::strerror(errno);
  }
  if (marker_ < 0) {
    throw Failure("--break-trace and --trace-threshold need tracefs mounted and the right to write to it: " + problems);
  }
  {
    const TraceLock lock(folder_);
    last_copy_path_ = folder_of(output) + "/.rt_tests-trace";
    last_copy_ = open(last_copy_path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    flock(last_copy_, LOCK_SH);  // as long as this program may need it
  }
  buffer_.resize(buffer_bytes);
  if (threshold_ns_ != std::numeric_limits<int64_t>::max()) {
    copier_.emplace("rt_traces", period_ms, cpus, [this] { copy_new(true); });
  }
}

OutlierTrace::~OutlierTrace() {
  copier_.reset();
  if (last_copy_ >= 0) {
    const TraceLock lock(folder_);
    const bool is_last_user = flock(last_copy_, LOCK_EX | LOCK_NB) == 0;
    if (is_last_user) unlink(last_copy_path_.c_str());
    close(last_copy_);
  }
  for (const int file : {marker_, folder_}) {
    if (file >= 0) close(file);
  }
}

bool OutlierTrace::note(int64_t value_ns, int64_t index, int64_t at_ns) noexcept {
  if (broke_.index >= 0) return true;
  const Outlier outlier{value_ns, index, at_ns};
  const bool breaks = value_ns > break_ns_;
  if (breaks) {
    mark(outlier);
    stopped_recording_ = stop_recording();
    broke_ = outlier;
  }
  // Last: from here on another thread may copy the trace, which must hold the marker by then.
  const std::size_t above = above_.load(std::memory_order_relaxed);
  if (above < outliers_.size()) outliers_[above] = outlier;
  above_.store(above + 1, std::memory_order_release);
  return breaks;
}

void OutlierTrace::mark(const Outlier& outlier) noexcept {
  char text[160];
  const int length = std::snprintf(text, sizeof text, "%s: %" PRId64 " ns at index %" PRId64 " above %" PRId64 " ns\n",
                                   program_, outlier.value_ns, outlier.index, break_ns_);
  // The measurement is kept even if the marker cannot be written.
  [[maybe_unused]] const ssize_t written = write(marker_, text, static_cast<std::size_t>(length));
}

bool OutlierTrace::write_at(const char* file, const char* text) noexcept {
  const int handle = openat(folder_, file, O_WRONLY | O_CLOEXEC);
  if (handle < 0) return false;
  const bool good = write(handle, text, std::strlen(text)) >= 0;
  const int reason = errno;
  close(handle);
  errno = reason;
  return good;
}

// Returns true if the trace was recording, and is no longer.
bool OutlierTrace::stop_recording() noexcept {
  const int handle = openat(folder_, "tracing_on", O_RDONLY | O_CLOEXEC);
  if (handle < 0) return false;
  char state = '0';
  const bool recording = read(handle, &state, 1) == 1 && state == '1';
  close(handle);
  return recording && write_at("tracing_on", "0");
}

// Programs that share a trace (several subscribers that see the same late message) also share its copies. A file tells
// each of them when the last copy was taken, and its name.
void OutlierTrace::copy_new(bool measuring) noexcept {
  const std::size_t noted = std::min(above_.load(std::memory_order_acquire), outliers_.size());
  if (noted == copied_) return;
  const TraceLock lock(folder_);
  Copy last{};
  const bool known = pread(last_copy_, &last, sizeof last, 0) == static_cast<ssize_t>(sizeof last);
  // A time in the future was written before the machine restarted.
  if (!known || last.at_ns > now_ns(clock_)) last.at_ns = std::numeric_limits<int64_t>::min();
  for (; copied_ < noted; ++copied_) {
    const Outlier& outlier = outliers_[copied_];
    if (outlier.at_ns <= last.at_ns) {
      write_trace(-1, outlier, last.file);
      continue;
    }
    const int64_t at_ns = now_ns(clock_);
    // No snapshot after the measurement: the trace itself then stays as it is, for the person who set it up.
    const bool snapshot = measuring && write_at("snapshot", "1");
    const bool paused = !snapshot && stop_recording();
    const int source = openat(folder_, snapshot ? "snapshot" : "trace", O_RDONLY | O_CLOEXEC);
    if (source < 0) problem_ = errno;
    if (source >= 0 && write_trace(source, outlier, "")) {
      last.at_ns = at_ns;
      char path[PATH_MAX];
      name(path, sizeof path, outlier.index);
      const char* slash = std::strrchr(path, '/');
      const char* file = slash ? slash + 1 : path;
      const std::size_t length = std::min(std::strlen(file), sizeof last.file - 1);
      std::memcpy(last.file, file, length);
      last.file[length] = '\0';
      write_all(last_copy_, {&last, sizeof last}, 0);
    }
    if (source >= 0) close(source);
    // The next snapshot records into this buffer, which must be empty then. Clearing it waits for RCU, and so for a
    // thread that does not give up a CPU: it comes after the copy.
    if (snapshot) write_at("snapshot", "2");
    if (paused) write_at("tracing_on", "1");
  }
}

void OutlierTrace::name(char* path, std::size_t size, int64_t index) const noexcept {
  std::snprintf(path, size, "%s-trace-%" PRId64 ".txt", output_.c_str(), index);
}

// Writes the file of one outlier: the trace read from `source`, or, if that is -1, the name of the file that holds it.
bool OutlierTrace::write_trace(int source, const Outlier& outlier, const char* shared_file) noexcept {
  char path[PATH_MAX];
  name(path, sizeof path, outlier.index);
  const int64_t us = outlier.at_ns / ns_per_us;
  int head = std::snprintf(buffer_.data(), buffer_.size(),
                           "# %s: %" PRId64 " ns at index %" PRId64 " above %" PRId64 " ns, at %" PRId64
                           ".%06d s of %s\n",
                           program_, outlier.value_ns, outlier.index, lowest_limit_ns_, us / 1000000,
                           static_cast<int>(us % 1000000), clock_name(clock_));
  if (source < 0) {
    const std::size_t room = buffer_.size() - static_cast<std::size_t>(head);
    head += std::snprintf(buffer_.data() + head, room, "# in %s\n", shared_file);
  }
  const int file = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  bool good = file >= 0;
  ssize_t length = head;
  for (std::size_t offset = 0; good && length > 0;) {
    good = write_all(file, {buffer_.data(), static_cast<std::size_t>(length)}, offset);
    offset += static_cast<std::size_t>(length);
    if (good) length = source < 0 ? 0 : read(source, buffer_.data(), buffer_.size());
  }
  good = good && length == 0;
  if (!good) problem_ = errno;
  if (file >= 0) close(file);
  if (file >= 0 && !good) unlink(path);
  return good;
}

void OutlierTrace::finish() {
  copier_.reset();
  if (marker_ < 0) return;
  copy_new(false);
  if (stopped_recording_) write_at("tracing_on", "1");
  for (std::size_t i = 0; i < copied_; ++i) {
    char path[PATH_MAX];
    name(path, sizeof path, outliers_[i].index);
    if (access(path, F_OK) == 0) files_.push_back(name_of(path));
  }
  if (problem_ != 0) {
    warning(std::to_string(copied_ - files_.size()) + " of " + std::to_string(copied_) + " traces " + output_ +
            "-trace-*.txt could not be copied: " + std::strerror(problem_));
  }
}

std::string OutlierTrace::reason() const {
  if (broke_.index < 0) return "";
  return "ended by --break-trace: " + std::to_string(broke_.value_ns) + " ns at index " + std::to_string(broke_.index);
}

}  // namespace rt_tests
