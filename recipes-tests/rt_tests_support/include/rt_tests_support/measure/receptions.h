// Which messages a subscriber received: in order, out of order, twice, or not at all.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rt_tests_support/samples.h"

namespace communication {

constexpr std::size_t columns = 3;  // publication, reception, seq
using Samples = rt_tests::Samples<columns>;

// The latency of the message of a row.
inline std::optional<int64_t> latency_of(const Samples& samples, std::size_t row) {
  return samples[row][1] - samples[row][0];
}

class Receptions {
 public:
  // The messages asked for are as many as the samples have room for.
  explicit Receptions(Samples& samples)
      : samples_(samples), asked_(static_cast<int64_t>(samples.capacity())), seen_(samples.capacity()) {}

  // Notes one message. `seq` comes from the network and may be out of range.
  void receive(int64_t publication_ns, int64_t reception_ns, uint32_t seq, bool last) noexcept {
    if (last) {
      last_came_ = true;
      sent_ = std::max(sent_, int64_t{seq} + 1);
    }
    if (seq >= asked_) {
      ++out_of_range_;
    } else if (seen_[seq]) {
      duplicate.note(seq);
    } else {
      seen_[seq] = true;
      samples_.append({publication_ns, reception_ns, seq});
      if (seq < previous_) out_of_order.note(seq);
      previous_ = seq;
      sent_ = std::max(sent_, int64_t{seq} + 1);
    }
  }

  bool last_came() const noexcept { return last_came_; }

  // To be called after the last reception. Messages above the highest number that came count as never sent.
  rt_tests::Events missing() const {
    rt_tests::Events result;
    for (int64_t seq = 0; seq < std::min(sent_, asked_); ++seq) {
      if (!seen_[static_cast<std::size_t>(seq)]) result.note(seq);
    }
    return result;
  }

  // Why not all messages asked for were received; empty if they were. `ended_by` is what ended the measurement before
  // the last message.
  std::string incomplete_reason(const std::string& ended_by) const {
    if (out_of_range_ > 0) {
      return std::to_string(out_of_range_) + " messages numbered " + std::to_string(asked_) +
             " or more came: publisher and subscriber need the same -r";
    }
    if (!last_came_) {
      const std::string after = sent_ == 0 ? "no message came" : "last message seen: " + std::to_string(sent_ - 1);
      return ended_by + ", " + after;
    }
    if (sent_ < asked_) return "the publisher sent " + std::to_string(sent_) + " messages: it needs the same -r";
    return "";
  }

  rt_tests::Events duplicate, out_of_order;

 private:
  Samples& samples_;
  const int64_t asked_;
  std::vector<bool> seen_;
  int64_t previous_ = -1;
  int64_t sent_ = 0;         // lower bound of the number of messages sent
  int64_t out_of_range_ = 0;
  bool last_came_ = false;
};

}  // namespace communication
