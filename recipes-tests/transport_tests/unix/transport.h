// Unix domain sockets.
#pragma once

#include <sys/un.h>

#include "stream.h"

struct UnixSockets {
  static constexpr char name[] = "unix";
  static constexpr int family = AF_UNIX;

  // An abstract one: there is no file that a killed program could leave.
  static sockaddr_un address() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string text = words();
    std::memcpy(address.sun_path + 1, text.data() + 1, text.size() - 1);
    return address;
  }
  static std::string words() { return "@rt_tests-" + std::to_string(transport::domain()); }
  static void set_up(const transport::File&) {}
};

using Transport = transport::Stream<UnixSockets>;
