// A loop that is no timer of ROS. It prints when each cycle was due and when it ran, by its own look at the clock.
//
//   loop WAY CYCLES [PRIORITY]    a millisecond each, at FIFO with a priority
//   WAY: absolute; until (as std::this_thread::sleep_until: a relative sleep until a point of its grid); realtime; timerfd;
//        long (absolute, every 50th cycle takes 2.5 periods); lock (absolute, with a lock that another thread holds for
//        300 us in each cycle); busy (no sleep at all)

#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { PERIOD_NS = 1000000 };
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_barrier_t barrier;

static int64_t now(clockid_t clock) {
  struct timespec at;
  clock_gettime(clock, &at);
  return (int64_t)at.tv_sec * 1000000000 + at.tv_nsec;
}

static struct timespec as_timespec(int64_t ns) { return (struct timespec){ns / 1000000000, ns % 1000000000}; }

static void spend(int64_t ns) {
  for (const int64_t end = now(CLOCK_MONOTONIC) + ns; now(CLOCK_MONOTONIC) < end;) {
  }
}

static void* hold(void* unused) {
  for (;;) {
    pthread_mutex_lock(&lock);
    pthread_barrier_wait(&barrier);
    const struct timespec time = as_timespec(300000);
    nanosleep(&time, NULL);
    pthread_mutex_unlock(&lock);
    pthread_barrier_wait(&barrier);
  }
  return unused;
}

int main(int argc, char** argv) {
  const char* way = argv[1];
  const long cycles = atol(argv[2]);
  if (!strcmp(way, "lock")) {
    pthread_barrier_init(&barrier, NULL, 2);
    pthread_t holder;
    pthread_create(&holder, NULL, hold, NULL);
  }
  if (argc > 3) {
    const struct sched_param priority = {atoi(argv[3])};
    if (sched_setscheduler(0, SCHED_FIFO, &priority)) return 1;
  }
  const clockid_t clock = strcmp(way, "realtime") ? CLOCK_MONOTONIC : CLOCK_REALTIME;
  int64_t due = now(clock) + PERIOD_NS;
  int timer = -1;
  if (!strcmp(way, "timerfd")) {
    timer = timerfd_create(CLOCK_MONOTONIC, 0);
    const struct itimerspec periodic = {as_timespec(PERIOD_NS), as_timespec(due)};
    timerfd_settime(timer, TFD_TIMER_ABSTIME, &periodic, NULL);
  }
  for (long cycle = 0; cycle < cycles; ++cycle) {
    const struct timespec time = as_timespec(due);
    if (timer >= 0) {
      uint64_t expired;
      if (read(timer, &expired, sizeof expired) != sizeof expired) return 1;
      due += (int64_t)(expired - 1) * PERIOD_NS;
    } else if (!strcmp(way, "until")) {
      const int64_t left = due - now(clock);
      const struct timespec rest = as_timespec(left);
      if (left > 0) nanosleep(&rest, NULL);
    } else if (!strcmp(way, "busy")) {
      spend(PERIOD_NS / 10);
    } else {
      clock_nanosleep(clock, TIMER_ABSTIME, &time, NULL);
    }
    const int64_t ran = now(CLOCK_MONOTONIC);
    if (!strcmp(way, "lock")) {
      pthread_barrier_wait(&barrier);
      pthread_mutex_lock(&lock);
      pthread_mutex_unlock(&lock);
      pthread_barrier_wait(&barrier);
    }
    if (!strcmp(way, "long") && cycle % 50 == 0) spend(PERIOD_NS * 5 / 2);
    printf("%lld %lld %lld\n", (long long)due, (long long)ran, (long long)now(CLOCK_MONOTONIC));
    fflush(stdout);
    due += PERIOD_NS;
  }
}
