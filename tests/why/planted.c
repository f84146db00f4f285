// Preloaded into a suite; what PLANT says happens again and again.
// lock: the thread planted_lock keeps a mutex without priority inheritance for LENGTH_MS, and the measuring thread needs
// it before it takes a time. faults: the measuring thread touches memory that the kernel has taken away. fsync: it writes
// lines to a file, and waits for the disk. own: another thread of the program has a higher priority, and the CPU for LENGTH_MS.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { faulted_bytes = 32 << 20, logged_lines = 32 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static sem_t wanted;
static int (*real_gettime)(clockid_t, struct timespec*);
static int plants_lock, plants_faults, log_file = -1;
static int64_t length_ms, last_number;
static char* memory;

static void* keep(void* unused) {
  const struct timespec kept = {length_ms / 1000, length_ms % 1000 * 1000000};
  pthread_setname_np(pthread_self(), "planted_lock");
  for (;;) {
    sem_wait(&wanted);
    pthread_mutex_lock(&lock);
    nanosleep(&kept, NULL);
    pthread_mutex_unlock(&lock);
  }
  return unused;
}

static int64_t now_ms(void) {
  struct timespec now;
  real_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int64_t period_ms(void) { return 700 + 30 * length_ms; }

static void* have_the_cpu(void* unused) {
  const struct sched_param higher = {97};
  cpu_set_t cpus;
  CPU_ZERO(&cpus);
  CPU_SET(atoi(getenv("PLANT_CPU")), &cpus);
  pthread_setname_np(pthread_self(), "planted_own");
  for (;;) {
    const int64_t pause_ms = period_ms() - now_ms() % period_ms();
    const struct timespec pause = {pause_ms / 1000, pause_ms % 1000 * 1000000};
    nanosleep(&pause, NULL);
    sched_setaffinity(0, sizeof cpus, &cpus);
    pthread_setschedparam(pthread_self(), SCHED_FIFO, &higher);
    for (const int64_t end_ms = now_ms() + length_ms; now_ms() < end_ms;) continue;
  }
  return unused;
}

__attribute__((constructor)) static void plant(void) {
  const char *what = getenv("PLANT"), *length = getenv("LENGTH_MS");
  pthread_t thread;
  *(void**)&real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
  length_ms = length ? atoi(length) : 0;
  plants_lock = what && !strcmp(what, "lock");
  plants_faults = what && !strcmp(what, "faults");
  sem_init(&wanted, 0, 0);
  if (plants_lock) pthread_create(&thread, NULL, keep, NULL);
  if (what && !strcmp(what, "own")) pthread_create(&thread, NULL, have_the_cpu, NULL);
  if (what && !strcmp(what, "fsync")) log_file = open("/var/tmp", O_TMPFILE | O_WRONLY, 0600);
  if (plants_faults) memory = mmap(NULL, faulted_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
}

// Events of the measuring thread itself begin when those of the programs of plants.py do.
static int is_time(void) {
  const int64_t number = now_ms() / period_ms(), last = last_number;
  last_number = number;
  return last != 0 && number != last;
}

int clock_gettime(clockid_t clock, struct timespec* now) {
  const int measures = clock == CLOCK_MONOTONIC_RAW && getpid() == gettid();
  if (measures && plants_lock) {
    pthread_mutex_lock(&lock);
    pthread_mutex_unlock(&lock);
  }
  // Other libraries ask for the time before our constructor runs.
  if (!real_gettime) return (int)syscall(SYS_clock_gettime, clock, now);
  const int result = real_gettime(clock, now);
  if (!measures || !(plants_lock || plants_faults || log_file >= 0) || !is_time()) return result;
  if (plants_lock) {
    // It gets the lock now, and has it when this thread asks again after its timer.
    sem_post(&wanted);
    return result;
  }
  if (log_file >= 0) {
    for (int line = 0; line < logged_lines; ++line)
      if (write(log_file, "late\n", 5) > 0) fsync(log_file);
    return real_gettime(clock, now);
  }
  munlock(memory, faulted_bytes);
  madvise(memory, faulted_bytes, MADV_NOHUGEPAGE);
  madvise(memory, faulted_bytes, MADV_DONTNEED);
  for (size_t at = 0; at < faulted_bytes; at += 4096) memory[at] = 1;
  return real_gettime(clock, now);
}
