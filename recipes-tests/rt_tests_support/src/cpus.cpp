#include "rt_tests_support/cpus.h"

#include <algorithm>
#include <cerrno>

namespace rt_tests {

CpuSet::CpuSet(const std::vector<int>& cpus)
    : CpuSet(cpus.empty() ? 1 : static_cast<std::size_t>(*std::max_element(cpus.begin(), cpus.end())) / CPU_SETSIZE + 1) {
  for (const int cpu : cpus) add(cpu);
}

std::optional<CpuSet> CpuSet::of_thread(int tid) {
  // The kernel tells nobody how many CPUs it was built for, and refuses a set that is smaller.
  for (std::size_t pieces = 1; pieces <= pieces_max; pieces *= 2) {
    CpuSet set(pieces);
    if (sched_getaffinity(tid, set.bytes(), set.pieces_.data()) == 0) return set;
    if (errno != EINVAL) return std::nullopt;
  }
  return std::nullopt;
}

std::vector<int> CpuSet::cpus() const {
  std::vector<int> cpus;
  for (int cpu = 0; cpu < end(); ++cpu) {
    if (has(cpu)) cpus.push_back(cpu);
  }
  return cpus;
}

CpuSet CpuSet::without(const CpuSet& others) const {
  CpuSet left(pieces_.size());
  for (const int cpu : cpus()) {
    if (cpu >= others.end() || !others.has(cpu)) left.add(cpu);
  }
  return left;
}

}  // namespace rt_tests
