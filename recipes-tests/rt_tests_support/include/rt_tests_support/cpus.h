// A set of CPUs, of however many the kernel knows: the C library's cpu_set_t ends at 1024.
#pragma once

#include <sched.h>

#include <cstddef>
#include <optional>
#include <vector>

namespace rt_tests {

class CpuSet {
 public:
  CpuSet() : CpuSet(1) {}
  explicit CpuSet(const std::vector<int>& cpus);

  // Where a thread may run, 0: the calling one. None where there is no such thread any more.
  static std::optional<CpuSet> of_thread(int tid);
  // Has a thread run there. False, with the reason in errno, if the kernel refuses that.
  bool apply_to(int tid) const { return sched_setaffinity(tid, bytes(), get()) == 0; }

  bool has(int cpu) const { return CPU_ISSET_S(static_cast<std::size_t>(cpu), bytes(), get()); }
  bool empty() const { return CPU_COUNT_S(bytes(), get()) == 0; }
  std::vector<int> cpus() const;  // ascending
  CpuSet without(const CpuSet& others) const;

  // For the C library's functions that take the size of a set in bytes.
  const cpu_set_t* get() const { return pieces_.data(); }
  std::size_t bytes() const { return pieces_.size() * sizeof(cpu_set_t); }

 private:
  // More than Linux was ever built for: what lies above is an error of the kernel.
  static constexpr std::size_t pieces_max = 64;

  explicit CpuSet(std::size_t pieces) : pieces_(pieces) {}
  int end() const { return static_cast<int>(8 * bytes()); }
  void add(int cpu) { CPU_SET_S(static_cast<std::size_t>(cpu), bytes(), pieces_.data()); }

  std::vector<cpu_set_t> pieces_;  // 1024 CPUs each, one behind the other as CPU_ALLOC(3) has them
};

}  // namespace rt_tests
