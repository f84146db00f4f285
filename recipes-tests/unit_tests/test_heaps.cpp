// In a program of its own: malloc fixes the number of heaps at its first use.
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <thread>
#include <vector>

#include "rt_tests_support/process.h"

using namespace rt_tests;

// Malloc's lock knows no priorities.
TEST(Heaps, ThreadsOfDifferentSchedulingShareNone) {
  set_up_heaps(Heaps::per_thread);
  constexpr int count = 40;  // more than malloc has heaps for by itself, 8 for each CPU, on the machines that run tests
  std::vector<std::thread> threads;
  std::atomic<int> elsewhere{0}, arrived{0};
  for (int i = 0; i < count; ++i) {
    threads.emplace_back([&] {
      const char* const block = static_cast<char*>(malloc(5000));
      if (block > static_cast<char*>(sbrk(0))) ++elsewhere;  // beyond the heap of the first thread
      ++arrived;
      while (arrived < count) std::this_thread::yield();  // a heap is used again when its thread has ended
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(elsewhere, count);
}
