// TCP on loopback, without Nagle's delay.
#pragma once

#include "stream.h"

struct TcpSockets {
  static constexpr char name[] = "tcp";
  static constexpr int family = AF_INET;
  static sockaddr_in address() { return transport::loopback(transport::port()); }
  static std::string words() { return "127.0.0.1:" + std::to_string(transport::port()); }
  static void set_up(const transport::File& connection) {
    transport::set_option(connection, IPPROTO_TCP, TCP_NODELAY, 1);
  }
};

using Transport = transport::Stream<TcpSockets>;
