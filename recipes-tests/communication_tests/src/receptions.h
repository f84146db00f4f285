// The bookkeeping of a subscriber: what came, once, twice, late, never. No ROS in here.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "rt_tests_support/samples.h"

namespace communication {

class Receptions {
 public:
  using Samples = rt_tests::Samples<3>;  // publication, reception, seq

  explicit Receptions(int64_t asked)
      : asked_(asked), seen_(static_cast<std::size_t>(asked)), samples_(static_cast<std::size_t>(asked)) {}

  // A message; `seq` comes from the network and is believed only after a look at its range.
  void receive(int64_t publication_ns, int64_t reception_ns, uint32_t seq, bool last) noexcept {
    if (last) {
      last_came_ = true;
      sent_ = std::max(sent_, int64_t{seq} + 1);
    }
    if (seq >= asked_) {
      ++beyond_;
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
  const Samples& samples() const noexcept { return samples_; }

  // After the last reception. Messages behind the highest that came were, as far as this subscriber knows, never sent.
  rt_tests::Noted missing() const {
    rt_tests::Noted result;
    for (int64_t seq = 0; seq < std::min(sent_, asked_); ++seq) {
      if (!seen_[static_cast<std::size_t>(seq)]) result.note(seq);
    }
    return result;
  }

  // Why this is not the whole of what was asked; empty if it is. `ended_by` says what ended it before the last message.
  std::string incomplete_reason(const std::string& ended_by) const {
    if (beyond_ > 0) {
      return std::to_string(beyond_) + " messages numbered " + std::to_string(asked_) +
             " or more came: publisher and subscriber need the same -r";
    }
    if (!last_came_) {
      const std::string after = sent_ == 0 ? "no message came" : "last message seen: " + std::to_string(sent_ - 1);
      return ended_by + ", " + after;
    }
    if (sent_ < asked_) return "the publisher sent " + std::to_string(sent_) + " messages: it needs the same -r";
    return "";
  }

  rt_tests::Noted duplicate, out_of_order;

 private:
  const int64_t asked_;
  std::vector<bool> seen_;
  Samples samples_;
  int64_t previous_ = -1;
  int64_t sent_ = 0;  // at least
  int64_t beyond_ = 0;
  bool last_came_ = false;
};

}  // namespace communication
