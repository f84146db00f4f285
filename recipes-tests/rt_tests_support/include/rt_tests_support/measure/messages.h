// What publisher and subscriber have in common.
#pragma once

#include <cstdint>
#include <string>

#include "rt_tests_support/options.h"

namespace communication {

std::string output(const rt_tests::Options& options);  // without prefix and ending

// Throws UsageError for a payload that is larger than a message of the middleware can have.
void require_payload(const rt_tests::Options& options, const char* middleware, int64_t payload_bytes_max);

}  // namespace communication
