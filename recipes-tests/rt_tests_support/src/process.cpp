#include "rt_tests_support/process.h"

#include <dirent.h>
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

#include "rt_tests_support/errors.h"

namespace rt_tests {
namespace {

constexpr std::size_t thread_stack_bytes = 1024 * 1024;  // 8 MiB each, the default, would all be locked
constexpr std::size_t touched_stack_bytes = 256 * 1024;

cpu_set_t cpus_before;  // --cpu; valid once cpus_are_chosen
bool cpus_are_chosen = false;

std::string limit_of(__rlimit_resource resource) {
  rlimit limit{};
  getrlimit(resource, &limit);
  return limit.rlim_cur == RLIM_INFINITY ? "unlimited" : std::to_string(limit.rlim_cur);
}

void set_policy(const Options& options) {
  sched_param parameters{};
  parameters.sched_priority = static_cast<int>(options.number("priority"));
  const std::string& policy = options.text("policy");
  if (sched_setscheduler(0, policy == "FIFO" ? SCHED_FIFO : SCHED_RR, &parameters) == 0) return;
  const int reason = errno;
  throw Failure("cannot run with policy " + policy + " at priority " + options.text("priority") +
                ": it needs the capability CAP_SYS_NICE or RLIMIT_RTPRIO of at least that (now " +
                limit_of(RLIMIT_RTPRIO) + "), and real-time time in its control group: " + std::strerror(reason));
}

void lock_memory() {
  // Memory once locked and touched stays in the process: freeing must not hand it back, to be faulted in again.
  mallopt(M_TRIM_THRESHOLD, -1);
  mallopt(M_MMAP_MAX, 0);
  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, thread_stack_bytes);
  pthread_setattr_default_np(&attributes);
  pthread_attr_destroy(&attributes);

  if (mlockall(MCL_CURRENT | MCL_FUTURE) == 0) return;
  const int reason = errno;
  throw Failure("cannot lock memory: it needs the capability CAP_IPC_LOCK or a larger RLIMIT_MEMLOCK (now " +
                limit_of(RLIMIT_MEMLOCK) + " bytes): " + std::strerror(reason));
}

__attribute__((noinline)) void touch_stack() {
  volatile char page[touched_stack_bytes];
  for (std::size_t i = 0; i < sizeof page; i += 1024) page[i] = 0;
}

void set_affinity(const std::string& list) {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (int cpu : parse_cpus(list, static_cast<int>(sysconf(_SC_NPROCESSORS_CONF)))) CPU_SET(cpu, &set);
  cpus_are_chosen = sched_getaffinity(0, sizeof cpus_before, &cpus_before) == 0;
  if (sched_setaffinity(0, sizeof set, &set) != 0) {
    throw Failure("cannot run on the CPUs '" + list + "': " + std::strerror(errno));
  }
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

void set_up_process(const Options& options) {
  if (!options.text("cpu").empty()) set_affinity(options.text("cpu"));
  if (!is_realtime(options)) return;
  if (options.text("rt_scope") == "process") set_policy(options);
  lock_memory();
  touch_stack();
}

void set_up_measuring_thread(const Options& options) {
  if (is_realtime(options) && options.text("rt_scope") != "process") set_policy(options);
}

cpu_set_t spare_cpus() {
  cpu_set_t chosen;
  CPU_ZERO(&chosen);
  sched_getaffinity(0, sizeof chosen, &chosen);
  if (!cpus_are_chosen) return chosen;
  cpu_set_t spare;
  CPU_XOR(&spare, &cpus_before, &chosen);  // those before and not now, or now and not before
  CPU_AND(&spare, &spare, &cpus_before);
  return CPU_COUNT(&spare) > 0 ? spare : chosen;
}

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
    cpu_set_t cpus;
    const int policy = sched_getscheduler(tid);
    if (policy < 0 || sched_getparam(tid, &parameters) != 0 || sched_getaffinity(tid, sizeof cpus, &cpus) != 0) {
      return;  // it ended meanwhile
    }
    std::getline(std::ifstream("/proc/self/task/" + std::to_string(tid) + "/comm"), state.name);
    state.policy = policy_name(policy);
    state.priority = parameters.sched_priority;
    for (int cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
      if (CPU_ISSET(cpu, &cpus)) state.cpus.push_back(cpu);
    }
    threads.push_back(state);
  });
  return threads;
}

void require_memory(int64_t bytes) {
  std::ifstream meminfo("/proc/meminfo");
  for (std::string line; std::getline(meminfo, line);) {
    if (line.compare(0, 13, "MemAvailable:") != 0) continue;  // not there before Linux 3.14
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
