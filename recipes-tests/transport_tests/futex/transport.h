// A ring in shared memory, and a futex that wakes its readers: the floor under all that crosses processes.
//
// The publisher never waits. A subscriber that is a whole ring behind goes on with what is still there, and misses the
// rest. Each program holds a lock on a byte of the memory's file, which ends with it, however it ends: so publisher and
// subscribers know of one another.
#pragma once

#include <fcntl.h>
#include <linux/futex.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <climits>
#include <new>

#include "domain.h"
#include "file.h"
#include "frame.h"
#include "rt_tests_support/clock.h"
#include "rt_tests_support/measure/publisher.h"

struct Transport {
  static constexpr char name[] = "futex";
  static constexpr int64_t payload_bytes_max = 16 * 1024 * 1024;
  using Context = transport::Context;

  static constexpr std::size_t ring_bytes = 16 * 1024 * 1024;
  static constexpr std::size_t slots_min = 8, slots_max = 1000;
  static constexpr off_t publishers_byte = 0, first_subscriber_byte = 1, subscribers_max = 64;

  static_assert(std::atomic<uint32_t>::is_always_lock_free, "the processes share no lock");

  // What the memory begins with. The slots follow, each `slot_bytes` long.
  struct Ring {
    std::atomic<uint32_t> published;  // messages so far, and the futex
    uint32_t slots;
    uint64_t frame_bytes;
    uint64_t slot_bytes;
  };
  struct alignas(64) Slot {
    std::atomic<uint32_t> written;  // the number of its message from 1 on, 0 while it is written
  };

  static std::string memory() { return "/rt_tests-" + std::to_string(transport::domain()); }

  // The memory, if it is there and this user's own: everybody may put one of this name there, and write into it what
  // others would take for sizes.
  static transport::File own(const std::string& memory) {
    transport::File file(shm_open(memory.c_str(), O_RDWR | O_CLOEXEC, 0600));
    struct stat state {};
    if (!file || fstat(file.number(), &state) != 0 || state.st_uid != geteuid()) return transport::File();
    return file;
  }

  // Locks a byte for as long as the file is open. False if another program has it. Throws Failure.
  static bool lock(const transport::File& file, off_t byte) {
    struct flock range = range_of(byte);
    const bool is_ours = fcntl(file.number(), F_OFD_SETLK, &range) == 0;
    require_locks(is_ours || errno == EAGAIN);
    return is_ours;
  }
  static bool is_locked(const transport::File& file, off_t byte) {
    struct flock range = range_of(byte);
    require_locks(fcntl(file.number(), F_OFD_GETLK, &range) == 0);
    return range.l_type != F_UNLCK;
  }
  // A kernel without CONFIG_FILE_LOCKING answers EACCES or EINVAL, one before 3.15 EINVAL.
  static void require_locks(bool hold) {
    if (hold) return;
    const bool may_lack_them = errno == EACCES || errno == EINVAL;
    const char* const needs = may_lack_them ? ", which needs Linux 3.15 or later with CONFIG_FILE_LOCKING" : "";
    transport::require(false, "lock the shared memory " + memory() + needs);
  }
  static struct flock range_of(off_t byte) {
    struct flock range {};
    range.l_type = F_WRLCK;
    range.l_whence = SEEK_SET;
    range.l_start = byte;
    range.l_len = 1;
    return range;
  }

  class Mapping {
   public:
    Mapping() = default;
    Mapping(const transport::File& file, std::size_t size)
        : start_(mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, file.number(), 0)), size_(size) {
      transport::require(start_ != MAP_FAILED, "map " + std::to_string(size) + " bytes of shared memory");
    }
    Mapping(const Mapping&) = delete;
    Mapping& operator=(Mapping&& other) noexcept {
      std::swap(start_, other.start_);
      std::swap(size_, other.size_);
      return *this;
    }
    ~Mapping() {
      if (size_ > 0) munmap(start_, size_);
    }
    Ring& ring() const noexcept { return *static_cast<Ring*>(start_); }
    // The slot of a message, of which the first has number 0.
    Slot& slot(uint32_t message) const noexcept {
      char* const first = static_cast<char*>(start_) + sizeof(Slot);
      return *reinterpret_cast<Slot*>(first + message % ring().slots * ring().slot_bytes);
    }
    static void* content(Slot& slot) noexcept { return &slot + 1; }

   private:
    void* start_ = nullptr;
    std::size_t size_ = 0;
  };
  static_assert(sizeof(Ring) <= sizeof(Slot));

  static uint64_t slot_bytes(std::size_t frame_bytes) {
    return sizeof(Slot) + (frame_bytes + sizeof(Slot) - 1) / sizeof(Slot) * sizeof(Slot);
  }

  class Publisher {
   public:
    Publisher(Context&, const rt_tests::Options& options) : frame_(options), memory_(memory()) {
      // What a killed publisher left is replaced: its subscribers keep what they have.
      const transport::File left = own(memory_);
      if (left && is_locked(left, publishers_byte)) {
        throw rt_tests::Failure("another publisher has the shared memory " + memory_);
      }
      shm_unlink(memory_.c_str());
      const uint64_t each_bytes = slot_bytes(frame_.size());
      const auto slots = static_cast<uint32_t>(std::clamp<uint64_t>(ring_bytes / each_bytes, slots_min, slots_max));
      const std::size_t size = sizeof(Slot) + slots * each_bytes;
      file_ = transport::File(shm_open(memory_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
      transport::require(static_cast<bool>(file_), "make the shared memory " + memory_);
      made_.name = memory_;
      // Else a full file system would be told by a signal when it is written to.
      errno = posix_fallocate(file_.number(), 0, static_cast<off_t>(size));
      transport::require(errno == 0, "reserve " + std::to_string(size) + " bytes of shared memory " + memory_);
      mapping_ = Mapping(file_, size);
      Ring& ring = *new (&mapping_.ring()) Ring{};
      ring.slots = slots;
      ring.frame_bytes = frame_.size();
      ring.slot_bytes = each_bytes;
      if (!lock(file_, publishers_byte)) {  // from now on subscribers come
        throw rt_tests::Failure("another program has the lock of the new shared memory " + memory_);
      }
    }

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      frame_.set(stamp);
      Ring& ring = mapping_.ring();
      const uint32_t message = ring.published.load(std::memory_order_relaxed);
      Slot& slot = mapping_.slot(message);
      slot.written.store(0, std::memory_order_relaxed);
      std::atomic_thread_fence(std::memory_order_release);  // no content before that
      std::memcpy(Mapping::content(slot), frame_.data(), frame_.size());
      slot.written.store(message + 1, std::memory_order_release);
      ring.published.store(message + 1, std::memory_order_release);
      syscall(SYS_futex, &ring.published, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
      return true;
    }
    std::string problem() const { return ""; }

    int64_t subscribers() {
      int64_t count = 0;
      for (off_t i = 0; i < subscribers_max; ++i) count += is_locked(file_, first_subscriber_byte + i) ? 1 : 0;
      return count;
    }

   private:
    // Removes the name also where the constructor throws, and before the lock goes.
    struct Made {
      ~Made() {
        if (!name.empty()) shm_unlink(name.c_str());
      }
      std::string name;
    };

    transport::Frame frame_;
    const std::string memory_;
    transport::File file_;
    Mapping mapping_;
    Made made_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context&, const rt_tests::Options& options, CallBack& call_back)
        : call_back_(call_back), frame_(options), memory_(memory()) {}

    void receive(int64_t limit_ns) {
      if (!file_ && !find_publisher()) return communication::pause(limit_ns);
      Ring& ring = mapping_.ring();
      uint32_t published = ring.published.load(std::memory_order_acquire);
      if (published == next_) {
        wait(ring.published, published, limit_ns);
        published = ring.published.load(std::memory_order_acquire);
      }
      while (next_ != published) {
        if (published - next_ > ring.slots) next_ = published - ring.slots;
        if (take(next_++)) call_back_(frame_.stamp());
      }
    }

    int64_t publishers() const { return file_ && is_locked(file_, publishers_byte) ? 1 : 0; }

   private:
    bool find_publisher() {
      transport::File file = own(memory_);
      if (!file || !is_locked(file, publishers_byte)) return false;
      struct stat state {};
      transport::require(fstat(file.number(), &state) == 0, "read the size of the shared memory " + memory_);
      mapping_ = Mapping(file, static_cast<std::size_t>(state.st_size));
      frame_.require_size(mapping_.ring().frame_bytes);
      // Those who come before the first message get all of them, and others those that follow.
      next_ = mapping_.ring().published.load(std::memory_order_acquire);
      off_t byte = first_subscriber_byte;
      while (byte < first_subscriber_byte + subscribers_max && !lock(file, byte)) ++byte;
      if (byte == first_subscriber_byte + subscribers_max) {
        throw rt_tests::Failure("the shared memory " + memory_ + " has " + std::to_string(subscribers_max) +
                                " subscribers already");
      }
      file_ = std::move(file);
      return true;
    }

    static void wait(std::atomic<uint32_t>& futex, uint32_t value, int64_t limit_ns) noexcept {
      // As this system call has it, whatever the C library takes for a timespec.
      const struct {
        long s, ns;
      } limit = {static_cast<long>(limit_ns / rt_tests::ns_per_s), static_cast<long>(limit_ns % rt_tests::ns_per_s)};
      syscall(SYS_futex, &futex, FUTEX_WAIT, value, &limit, nullptr, 0);
    }

    // Copies a message. False if it was overwritten meanwhile.
    bool take(uint32_t message) noexcept {
      Slot& slot = mapping_.slot(message);
      if (slot.written.load(std::memory_order_acquire) != message + 1) return false;
      std::memcpy(frame_.data(), Mapping::content(slot), frame_.size());
      std::atomic_thread_fence(std::memory_order_acquire);  // the content before that
      return slot.written.load(std::memory_order_relaxed) == message + 1;
    }

    CallBack& call_back_;
    transport::Frame frame_;
    const std::string memory_;
    transport::File file_;
    Mapping mapping_;
    uint32_t next_ = 0;
  };
};
