#include "rt_tests_support/process.h"

#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <link.h>
#include <malloc.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <new>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"

namespace rt_tests {
namespace {

// Each thread's stack is locked as a whole. The threads of roscpp use 12 KiB of it; the default size is 8 MiB.
constexpr std::size_t thread_stack_bytes = 256 * 1024;
constexpr std::size_t touched_stack_bytes = 256 * 1024;
// Half of the largest that a heap of a thread's own may have where addresses have 32 bits.
constexpr std::size_t thread_heap_reserve_bytes = 512 * 1024;
constexpr int heaps_max = 1024;
constexpr char cpu_dma_latency[] = "/dev/cpu_dma_latency";

std::string limit_of(__rlimit_resource resource) {
  rlimit limit{};
  getrlimit(resource, &limit);
  return limit.rlim_cur == RLIM_INFINITY ? "unlimited" : std::to_string(limit.rlim_cur);
}

template <class Visit>
void for_each_thread(Visit visit) {
  DIR* folder = opendir("/proc/self/task");
  if (!folder) throw Failure(std::string("/proc/self/task: ") + std::strerror(errno));
  while (const dirent* item = readdir(folder)) {
    if (item->d_name[0] != '.') visit(std::atoi(item->d_name));
  }
  closedir(folder);
}

std::vector<int> all_threads() {
  std::vector<int> tids;
  for_each_thread([&](int tid) { tids.push_back(tid); });
  return tids;
}

void set_policy(const std::string& policy, int64_t priority, int tid) {
  sched_param parameters{};
  parameters.sched_priority = static_cast<int>(priority);
  if (sched_setscheduler(tid, policy == "FIFO" ? SCHED_FIFO : SCHED_RR, &parameters) == 0) return;
  const int reason = errno;
  if (reason == ESRCH) return;  // the thread ended in the meantime
  throw Failure("cannot run with policy " + policy + " at priority " + std::to_string(priority) +
                ": it needs the capability CAP_SYS_NICE or RLIMIT_RTPRIO of at least that (now " +
                limit_of(RLIMIT_RTPRIO) + "), and real-time time in its control group: " + std::strerror(reason));
}

// Debian's roscpp loads 30 MiB of Unicode tables through Boost.Regex. Nothing reads them while measuring, so they are
// not kept in memory: a callback of dl_iterate_phdr.
int release_unicode_tables(dl_phdr_info* library, std::size_t, void*) {
  if (!std::strstr(library->dlpi_name, "/libicudata.")) return 0;
  const auto page = static_cast<uintptr_t>(sysconf(_SC_PAGESIZE));
  for (int i = 0; i < library->dlpi_phnum; ++i) {
    const auto& segment = library->dlpi_phdr[i];
    if (segment.p_type != PT_LOAD || (segment.p_flags & PF_W)) continue;
    const uintptr_t begin = (library->dlpi_addr + segment.p_vaddr) & ~(page - 1);
    const uintptr_t end = library->dlpi_addr + segment.p_vaddr + segment.p_memsz;
    munlock(reinterpret_cast<void*>(begin), end - begin);
    madvise(reinterpret_cast<void*>(begin), end - begin, MADV_DONTNEED);  // read from the file again if ever needed
  }
  return 1;
}

void lock_memory(Heaps heaps) {
  set_up_heaps(heaps);
  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, thread_stack_bytes);
  pthread_setattr_default_np(&attributes);
  pthread_attr_destroy(&attributes);

  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    const int reason = errno;
    throw Failure("cannot lock memory: it needs the capability CAP_IPC_LOCK or a larger RLIMIT_MEMLOCK (now " +
                  limit_of(RLIMIT_MEMLOCK) + " bytes): " + std::strerror(reason));
  }
  dl_iterate_phdr(release_unicode_tables, nullptr);
}

void fill_heap(std::size_t bytes) {
  void* const reserve = malloc(bytes);
  if (!reserve) throw std::bad_alloc();
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  for (std::size_t i = 0; i < bytes; i += page) static_cast<volatile char*>(reserve)[i] = 0;
  free(reserve);
}

__attribute__((noinline)) void touch_stack() {
  volatile char page[touched_stack_bytes];
  for (std::size_t i = 0; i < sizeof page; i += 1024) page[i] = 0;
}

void set_policy(const Options& options, int tid) {
  set_policy(options.text("policy"), options.number("priority"), tid);
}

void set_affinity(const std::string& list, int tid) {
  const CpuSet cpus(parse_cpus(list, static_cast<int>(sysconf(_SC_NPROCESSORS_CONF))));
  if (cpus.apply_to(tid) || errno == ESRCH) return;
  throw Failure("cannot run on the CPUs '" + list + "': " + std::strerror(errno));
}

std::string policy_name(int policy) {
  switch (policy & ~SCHED_RESET_ON_FORK) {
    case SCHED_OTHER: return "OTHER";
    case SCHED_RR: return "RR";
    case SCHED_FIFO: return "FIFO";
    default: return std::to_string(policy);
  }
}

}  // namespace

bool is_realtime(const Options& options) { return options.text("policy") != "0"; }

Heaps heaps_of(const Options& options) {
  return options.text("rt_scope") == "process" ? Heaps::shared : Heaps::per_thread;
}

ProcessSetUp::ProcessSetUp(const Options& options, Heaps heaps) : options_(options), threads_(all_threads()) {
  const CpuSet all = current_cpus();
  if (!options.text("cpu").empty()) {
    for (const int tid : threads_) set_affinity(options.text("cpu"), tid);
  }
  if (is_realtime(options)) {
    lock_memory(heaps);
    touch_stack();
  }
  const CpuSet chosen = current_cpus();
  spare_cpus_ = all.without(chosen);
  if (spare_cpus_.empty()) spare_cpus_ = chosen;
}

void ProcessSetUp::set_policy() const {
  if (!is_realtime(options_) || options_.text("rt_scope") != "process") return;
  // The middleware takes some of it when it starts; set_up_measuring_thread() adds as much again.
  reserve_heap();
  for (const int tid : threads_) rt_tests::set_policy(options_, tid);
}

void set_up_measuring_thread(const Options& options) {
  if (!is_realtime(options)) return;
  reserve_heap();
  if (options.text("rt_scope") != "process") set_policy(options, 0);
}

void set_up_thread(const std::string& policy, int64_t priority, const std::string& cpus) {
  if (!cpus.empty()) set_affinity(cpus, 0);
  // Inherited from the thread that started it: what follows is done at normal scheduling.
  const sched_param normal{};
  sched_setscheduler(0, SCHED_OTHER, &normal);
  if (policy == "0") return;
  fill_heap(thread_heap_reserve_bytes);
  set_policy(policy, priority, 0);  // its stack is locked with the rest of the process
}

void set_up_heaps(Heaps heaps) {
  // Freed memory stays in the process: memory handed back to the kernel would cause page faults when allocated again.
  mallopt(M_TRIM_THRESHOLD, -1);
  mallopt(M_MMAP_MAX, 0);
  // A heap of a thread's own grows by a few pages at a time, and reserves 64 MiB of address space: only where threads of different
  // scheduling would wait for one another. Then there are as many as threads, not a few for each CPU, as malloc has it by itself.
  mallopt(M_ARENA_MAX, heaps == Heaps::shared ? 1 : heaps_max);
}

void reserve_heap() {
  mallopt(M_TOP_PAD, 0);
  fill_heap(heap_reserve_bytes);
  // Should it be used up, the heap grows as rarely as possible.
  mallopt(M_TOP_PAD, heap_reserve_bytes);
}

CpuDmaLatency::CpuDmaLatency(const Options& options) {
  if (!options.given("cpu_dma_latency_us")) return;
  const auto asked_us = static_cast<int32_t>(options.number("cpu_dma_latency_us"));
  file_ = open(cpu_dma_latency, O_RDWR | O_CLOEXEC);
  if (file_ >= 0 && write(file_, &asked_us, sizeof asked_us) == sizeof asked_us) return;
  const int reason = errno;
  if (file_ >= 0) close(file_);
  throw Failure("cannot hold " + std::string(cpu_dma_latency) + " at " + std::to_string(asked_us) +
                " us: --cpu-dma-latency needs root and a kernel with CONFIG_CPU_IDLE: " + std::strerror(reason));
}

CpuDmaLatency::~CpuDmaLatency() {
  if (file_ >= 0) close(file_);
}

std::optional<int32_t> cpu_dma_latency_us() {
  int32_t lowest_us = 0;
  const int file = open(cpu_dma_latency, O_RDONLY | O_CLOEXEC);
  if (file < 0) return std::nullopt;
  const bool good = read(file, &lowest_us, sizeof lowest_us) == sizeof lowest_us;
  close(file);
  return good ? std::optional(lowest_us) : std::nullopt;
}

CpuSet current_cpus() { return CpuSet::of_thread(0).value_or(CpuSet()); }

void give_up_realtime() {
  for_each_thread([](int tid) {
    const sched_param parameters{};
    sched_setscheduler(tid, SCHED_OTHER, &parameters);
  });
}

std::vector<ThreadState> read_threads() {
  std::vector<ThreadState> threads;
  for_each_thread([&](int tid) {
    ThreadState state{tid, "", "", 0, {}};
    sched_param parameters{};
    const int policy = sched_getscheduler(tid);
    const auto cpus = CpuSet::of_thread(tid);
    if (policy < 0 || sched_getparam(tid, &parameters) != 0 || !cpus) return;  // the thread ended in the meantime
    std::getline(std::ifstream("/proc/self/task/" + std::to_string(tid) + "/comm"), state.name);
    state.policy = policy_name(policy);
    state.priority = parameters.sched_priority;
    state.cpus = cpus->cpus();
    threads.push_back(state);
  });
  return threads;
}

Costs costs_so_far() {
  std::optional<Allocations> allocations;
  static const auto count =
      reinterpret_cast<void (*)(int64_t*, int64_t*, int64_t*)>(dlsym(RTLD_DEFAULT, "rt_tests_allocations"));
  if (count) {
    allocations.emplace();
    count(&allocations->allocations, &allocations->frees, &allocations->of_measuring_thread);
  }
  rusage used{};
  getrusage(RUSAGE_SELF, &used);
  const auto ns = [](const timeval& time) { return int64_t{time.tv_sec} * ns_per_s + time.tv_usec * ns_per_us; };
  return {used.ru_minflt, used.ru_majflt, used.ru_nvcsw, used.ru_nivcsw, ns(used.ru_utime) + ns(used.ru_stime),
          allocations};
}

Costs operator-(const Costs& later, const Costs& earlier) {
  auto allocations = later.allocations;
  if (allocations && earlier.allocations) {
    allocations->allocations -= earlier.allocations->allocations;
    allocations->frees -= earlier.allocations->frees;
    allocations->of_measuring_thread -= earlier.allocations->of_measuring_thread;
  }
  return {later.minor_faults - earlier.minor_faults, later.major_faults - earlier.major_faults,
          later.voluntary_switches - earlier.voluntary_switches,
          later.involuntary_switches - earlier.involuntary_switches, later.cpu_time_ns - earlier.cpu_time_ns, allocations};
}

void require_memory(int64_t bytes) {
  std::ifstream meminfo("/proc/meminfo");
  for (std::string line; std::getline(meminfo, line);) {
    if (line.compare(0, 13, "MemAvailable:") != 0) continue;  // absent before Linux 3.14
    const int64_t available = std::atoll(line.c_str() + 13) * 1024;
    if (available >= bytes) return;
    throw Failure("the samples need " + std::to_string(bytes / 1000000) + " MB of memory, " +
                  std::to_string(available / 1000000) + " MB are available; ask for fewer with -r");
  }
}

bool memory_is_locked() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.compare(0, 6, "VmLck:") == 0) return std::atoll(line.c_str() + 6) > 0;
  }
  return false;
}

}  // namespace rt_tests
