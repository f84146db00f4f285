// What the outputs of publisher and subscriber are called.
#pragma once

#include <string>

#include "rt_tests_support/report.h"

namespace communication {

// Without prefix and ending.
inline std::string output(const rt_tests::Options& options) {
  const auto number = [&](const char* key) { return std::to_string(options.number(key)); };
  return "ct_gnuplot_l" + number("repetitions") + "_fq" + number("frequency_hz") + "_pl" + number("payload_bytes") +
         rt_tests::policy_suffix(options);
}

}  // namespace communication
