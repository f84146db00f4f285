// A message as bytes. Both ends are on one machine, and so are of one byte order.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/options.h"

namespace transport {

// What stands before the payload.
struct Head {
  int64_t publication_ns;
  uint32_t seq;
  uint32_t last;
  uint64_t size;  // of all of the message, in bytes
};

// A head and the payload of -l bytes, in one piece, allocated and touched before the first message.
class Frame {
 public:
  explicit Frame(const rt_tests::Options& options)
      : bytes_(sizeof(Head) + static_cast<std::size_t>(options.number("payload_bytes")), 0xff) {}

  void set(const rt_tests::Stamp& stamp) noexcept {
    const Head head{stamp.publication_ns, stamp.seq, stamp.last, bytes_.size()};
    std::memcpy(bytes_.data(), &head, sizeof head);
  }
  rt_tests::Stamp stamp() const noexcept {
    const Head came = head();
    return {came.publication_ns, came.seq, came.last != 0};
  }
  Head head() const noexcept {
    Head head;
    std::memcpy(&head, bytes_.data(), sizeof head);
    return head;
  }

  unsigned char* data() noexcept { return bytes_.data(); }
  const unsigned char* data() const noexcept { return bytes_.data(); }
  std::size_t size() const noexcept { return bytes_.size(); }

  // Throws Failure if a message of this size has another payload.
  void require_size(uint64_t came) const {
    if (came == size()) return;
    throw rt_tests::Failure("a message of " + std::to_string(came) + " bytes came, not of " + std::to_string(size()) +
                            ": publisher and subscriber need the same -l");
  }

 private:
  std::vector<unsigned char> bytes_;
};

}  // namespace transport
