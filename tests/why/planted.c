// Preloaded into a suite. PLANT=lock: the thread planted_lock keeps a mutex without priority inheritance for 3 ms, again
// and again, and the measuring thread needs it before it takes a time. PLANT=faults: the measuring thread touches 8 MiB
// that the kernel has taken away, again and again.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { every_ms = 900, faulted_bytes = 8 << 20 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int (*real_gettime)(clockid_t, struct timespec*);
static int plants_lock, plants_faults;
static char* memory;
static _Thread_local time_t last_ms;

static void* keep(void* unused) {
  const struct timespec pause = {0, every_ms * 1000000}, kept = {0, 3000000};
  pthread_setname_np(pthread_self(), "planted_lock");
  for (;;) {
    nanosleep(&pause, NULL);
    pthread_mutex_lock(&lock);
    nanosleep(&kept, NULL);
    pthread_mutex_unlock(&lock);
  }
  return unused;
}

__attribute__((constructor)) static void plant(void) {
  const char* what = getenv("PLANT");
  pthread_t thread;
  *(void**)&real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
  plants_lock = what && !strcmp(what, "lock");
  plants_faults = what && !strcmp(what, "faults");
  if (plants_lock) pthread_create(&thread, NULL, keep, NULL);
  if (plants_faults) memory = mmap(NULL, faulted_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
}

int clock_gettime(clockid_t clock, struct timespec* now) {
  if (clock == CLOCK_MONOTONIC_RAW && plants_lock) {
    pthread_mutex_lock(&lock);
    pthread_mutex_unlock(&lock);
  }
  // Other libraries ask for the time before our constructor runs.
  if (!real_gettime) return (int)syscall(SYS_clock_gettime, clock, now);
  const int result = real_gettime(clock, now);
  if (clock == CLOCK_MONOTONIC_RAW && plants_faults && getpid() == gettid()) {
    const time_t ms = now->tv_sec * 1000 + now->tv_nsec / 1000000;
    if (last_ms == 0) last_ms = ms;
    if (ms - last_ms > every_ms) {
      last_ms = ms;
      munlock(memory, faulted_bytes);
      madvise(memory, faulted_bytes, MADV_NOHUGEPAGE);
      madvise(memory, faulted_bytes, MADV_DONTNEED);
      for (size_t at = 0; at < faulted_bytes; at += 4096) memory[at] = 1;
      return real_gettime(clock, now);
    }
  }
  return result;
}
