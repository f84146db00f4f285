// Preloaded into a program of the suites (LD_PRELOAD), it counts the calls by which each thread allocates and frees memory.
// The program asks for the counts when it begins to measure, and when it ends. Without locks: a thread counts in a slot
// of its own; threads beyond the last slot share it. glibc's allocator does the work, by the names that it has beside malloc.
#define _GNU_SOURCE
#include <errno.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

extern void* __libc_malloc(size_t);
extern void* __libc_calloc(size_t, size_t);
extern void* __libc_realloc(void*, size_t);
extern void* __libc_memalign(size_t, size_t);
extern void __libc_free(void*);

enum { SLOTS = 1024 };
// Each in a cache line of its own: one thread must not slow down another.
static struct slot {
  _Alignas(64) atomic_llong allocations;
  atomic_llong frees;
} slots[SLOTS];
static atomic_int used;
static _Thread_local struct slot* own __attribute__((tls_model("initial-exec")));

static struct slot* slot(void) {
  if (!own) {
    const int number = atomic_fetch_add_explicit(&used, 1, memory_order_relaxed);
    own = &slots[number < SLOTS ? number : SLOTS - 1];
  }
  return own;
}

static void count(void) { atomic_fetch_add_explicit(&slot()->allocations, 1, memory_order_relaxed); }

void* malloc(size_t size) {
  count();
  return __libc_malloc(size);
}

void* calloc(size_t number, size_t size) {
  count();
  return __libc_calloc(number, size);
}

void* realloc(void* old, size_t size) {
  count();
  return __libc_realloc(old, size);
}

void* memalign(size_t alignment, size_t size) {
  count();
  return __libc_memalign(alignment, size);
}

void* aligned_alloc(size_t alignment, size_t size) { return memalign(alignment, size); }

int posix_memalign(void** result, size_t alignment, size_t size) {
  if (alignment % sizeof(void*) != 0 || alignment == 0 || (alignment & (alignment - 1)) != 0) return EINVAL;
  void* memory = memalign(alignment, size);
  if (!memory) return ENOMEM;
  *result = memory;
  return 0;
}

void free(void* memory) {
  if (memory) atomic_fetch_add_explicit(&slot()->frees, 1, memory_order_relaxed);
  __libc_free(memory);
}

// The calls so far: all threads' allocations and frees, those that ended included, and the allocations of the caller.
void rt_tests_allocations(int64_t* allocations, int64_t* frees, int64_t* of_caller) {
  *of_caller = atomic_load_explicit(&slot()->allocations, memory_order_relaxed);
  *allocations = *frees = 0;
  for (int number = 0; number < SLOTS; ++number) {
    *allocations += atomic_load_explicit(&slots[number].allocations, memory_order_relaxed);
    *frees += atomic_load_explicit(&slots[number].frees, memory_order_relaxed);
  }
}
