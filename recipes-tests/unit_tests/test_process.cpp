#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <thread>
#include <vector>

#include "rt_tests_support/process.h"

using namespace rt_tests;

// Each growth of the heap costs a system call and, where memory is locked, the time to fill the new pages with zeros.
TEST(Process, AReservedHeapNeitherGrowsNorFaultsOnAnyThread) {
  share_heap();
  reserve_heap();
  constexpr std::size_t size = 4000;
  constexpr std::size_t blocks = heap_reserve_bytes * 9 / 10 / size;
  const void* const end = sbrk(0);
  long faults = -1;
  bool in_heap = true;
  std::thread([&] {
    std::vector<char*> all(blocks);
    rusage before{}, after{};
    getrusage(RUSAGE_THREAD, &before);
    for (auto& block : all) {
      block = static_cast<char*>(malloc(size));
      block[0] = block[size - 1] = 1;
      in_heap = in_heap && block < end;
    }
    getrusage(RUSAGE_THREAD, &after);
    faults = after.ru_minflt - before.ru_minflt;
    for (char* block : all) free(block);
  }).join();
  EXPECT_TRUE(in_heap);  // of the one heap that all threads share
  EXPECT_LE(faults, 2);  // the thread's stack, the code of malloc
  EXPECT_EQ(sbrk(0), end);
}
