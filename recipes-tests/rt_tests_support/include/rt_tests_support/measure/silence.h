// Decides whether to wait longer for a publisher that sends nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/options.h"

namespace communication {

class Silence {
 public:
  // Before the first message only an --idle-timeout given on the command line ends the waiting: the publisher may be
  // started much later.
  explicit Silence(const rt_tests::Options& options)
      : limit_ns_(options.number("idle_timeout_s") * rt_tests::ns_per_s),
        limit_is_given_(options.given("idle_timeout_s")),
        delay_ns_(options.number("start_delay_s") * rt_tests::ns_per_s),
        since_ns_(rt_tests::now_ns(CLOCK_MONOTONIC)) {}

  // Why to end the measurement; empty: wait longer. To be called when no message came for a while.
  std::string reason_to_end(std::size_t received, int64_t publishers) {
    const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
    if (received != received_) {
      received_ = received;
      since_ns_ = now_ns;
    }
    if (publishers > 0 || received > 0) publisher_seen_ = true;
    if (publisher_seen_ && publishers == 0) return "the publisher left";
    const int64_t limit_ns = limit_ns_ + (received == 0 ? delay_ns_ : 0);
    if ((received > 0 || limit_is_given_) && now_ns - since_ns_ > limit_ns) {
      return "nothing came for " + std::to_string(limit_ns / rt_tests::ns_per_s) + " s";
    }
    return "";
  }

 private:
  const int64_t limit_ns_;
  const bool limit_is_given_;
  const int64_t delay_ns_;
  int64_t since_ns_;
  std::size_t received_ = 0;
  bool publisher_seen_ = false;
};

}  // namespace communication
