// The fields of 2014's message as bytes, for a middleware that carries bytes: sec, nsec, seq, last_msg; the payload follows.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/middleware.h"

namespace communication {

constexpr std::size_t stamp_bytes = 3 * sizeof(uint32_t) + 1;

// In the byte order of the machine, on which publisher and subscriber run: their clock is one.
inline void write_stamp(const rt_tests::Stamp& stamp, uint8_t* bytes) noexcept {
  const uint32_t fields[] = {static_cast<uint32_t>(stamp.publication_ns / rt_tests::ns_per_s),
                             static_cast<uint32_t>(stamp.publication_ns % rt_tests::ns_per_s), stamp.seq};
  std::memcpy(bytes, fields, sizeof fields);
  bytes[sizeof fields] = stamp.last;
}

inline rt_tests::Stamp read_stamp(const uint8_t* bytes) noexcept {
  uint32_t fields[3];
  std::memcpy(fields, bytes, sizeof fields);
  return {int64_t{fields[0]} * rt_tests::ns_per_s + fields[1], fields[2], bytes[sizeof fields] != 0};
}

}  // namespace communication
