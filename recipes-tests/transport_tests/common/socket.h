// What the sockets have in common.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <cstdint>

#include "domain.h"
#include "file.h"
#include "rt_tests_support/clock.h"

namespace transport {

inline timeval duration(int64_t ns) {
  timeval value{};
  value.tv_sec = static_cast<time_t>(ns / rt_tests::ns_per_s);
  value.tv_usec = static_cast<suseconds_t>(ns % rt_tests::ns_per_s / rt_tests::ns_per_us);
  return value;
}

template <class Value>
void set_option(const File& file, int level, int option, const Value& value) {
  setsockopt(file.number(), level, option, &value, sizeof value);
}

inline sockaddr_in loopback(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

}  // namespace transport
