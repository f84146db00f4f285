// Preloaded into a program of the suites: counts allocations that the program's own code asks for (not those of the
// libraries it calls, roscpp above all) from when it catches SIGTERM, which is when it begins to measure, until ros::shutdown(), and says the
// number on standard error.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <dlfcn.h>
#include <link.h>

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <new>

extern "C" void* __libc_malloc(size_t);

namespace {

std::atomic<bool> counting{false};
std::atomic<int> from_program{0};
std::atomic<int> from_elsewhere{0};
uintptr_t first = 0, last = 0;  // the program's own code

int find_program(dl_phdr_info* info, size_t, void*) {
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const auto& segment = info->dlpi_phdr[i];
    if (segment.p_type != PT_LOAD || !(segment.p_flags & PF_X)) continue;
    first = info->dlpi_addr + segment.p_vaddr;
    last = first + segment.p_memsz;
  }
  return 1;  // the program comes first: stop there
}

void* allocate(size_t size, void* caller) {
  if (counting.load(std::memory_order_relaxed)) {
    const auto address = reinterpret_cast<uintptr_t>(caller);
    (address >= first && address < last ? from_program : from_elsewhere).fetch_add(1);
  }
  return __libc_malloc(size);
}

template <class Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

}  // namespace

extern "C" void* malloc(size_t size) { return allocate(size, __builtin_return_address(0)); }
void* operator new(size_t size) { return allocate(size, __builtin_return_address(0)); }
void* operator new[](size_t size) { return allocate(size, __builtin_return_address(0)); }

extern "C" int sigaction(int number, const struct sigaction* action, struct sigaction* old) {
  static const auto real = next<int (*)(int, const struct sigaction*, struct sigaction*)>("sigaction");
  if (number == 15) {  // SIGTERM: caught when a measurement begins
    dl_iterate_phdr(find_program, nullptr);
    counting = true;
  }
  return real(number, action, old);
}

extern "C" void _ZN3ros8shutdownEv() {
  counting = false;
  std::fprintf(stderr, "allocations: program %d, libraries %d\n", from_program.load(), from_elsewhere.load());
  static const auto real = next<void (*)()>("_ZN3ros8shutdownEv");
  real();
}
