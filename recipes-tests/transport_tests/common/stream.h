// Messages over a connection for each subscriber, which carries bytes in their order. `Kind` says of which sockets:
//   static constexpr char name[];
//   static constexpr int family;
//   static Address address();          // of the publisher
//   static std::string words();        // the address in words
//   static void set_up(const File&);   // of a connection
#pragma once

#include <poll.h>

#include <algorithm>
#include <vector>

#include "frame.h"
#include "rt_tests_support/measure/publisher.h"
#include "rt_tests_support/stop.h"
#include "socket.h"

namespace transport {

// A subscriber that takes nothing for so long is given up.
constexpr int64_t stuck_ns = 5 * rt_tests::ns_per_s;

template <class Kind>
struct Stream {
  static constexpr const char* name = Kind::name;
  static constexpr int64_t payload_bytes_max = 16 * 1024 * 1024;
  using Context = transport::Context;

  // Sends each message to one subscriber after the other, and waits while what is sent before has not been taken.
  class Publisher {
   public:
    Publisher(Context&, const rt_tests::Options& options)
        : frame_(options), listening_(socket(Kind::family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
      set_option(listening_, SOL_SOCKET, SO_REUSEADDR, 1);
      const auto address = Kind::address();
      require(bind(listening_.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 &&
                  listen(listening_.number(), 64) == 0,
              "listen on " + Kind::words());
    }

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      frame_.set(stamp);
      subscribers_.erase(std::remove_if(subscribers_.begin(), subscribers_.end(),
                                        [this](const File& subscriber) { return !send_to(subscriber); }),
                         subscribers_.end());
      return true;
    }
    std::string problem() const { return ""; }

    int64_t subscribers() {
      while (true) {
        File connected(accept4(listening_.number(), nullptr, nullptr, SOCK_CLOEXEC));
        if (!connected) break;
        set_option(connected, SOL_SOCKET, SO_SNDTIMEO, duration(stuck_ns));
        Kind::set_up(connected);
        subscribers_.push_back(std::move(connected));
      }
      subscribers_.erase(std::remove_if(subscribers_.begin(), subscribers_.end(), has_left), subscribers_.end());
      return static_cast<int64_t>(subscribers_.size());
    }

   private:
    bool send_to(const File& subscriber) const noexcept {
      for (std::size_t sent = 0; sent < frame_.size();) {
        const ssize_t bytes = send(subscriber.number(), frame_.data() + sent, frame_.size() - sent, MSG_NOSIGNAL);
        if (bytes < 0 && errno == EINTR && !rt_tests::stop_requested()) continue;
        if (bytes < 0) return false;
        sent += static_cast<std::size_t>(bytes);
      }
      return true;
    }

    static bool has_left(const File& subscriber) {
      char byte;
      const ssize_t bytes = recv(subscriber.number(), &byte, 1, MSG_DONTWAIT);
      return bytes == 0 || (bytes < 0 && errno != EAGAIN && errno != EINTR);
    }

    Frame frame_;
    const File listening_;
    std::vector<File> subscribers_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context&, const rt_tests::Options& options, CallBack& call_back)
        : call_back_(call_back), frame_(options) {}

    // At most one message. The limit is that of every call, as the connection has it.
    void receive(int64_t limit_ns) {
      if (!connection_ && !connect_to_publisher(limit_ns)) return communication::pause(limit_ns);
      while (received_ < frame_.size()) {
        const ssize_t bytes =
            recv(connection_.number(), frame_.data() + received_, frame_.size() - received_, 0);
        if (bytes < 0 && (errno == EAGAIN || errno == EINTR)) return;
        if (bytes <= 0) {
          connection_ = File();
          received_ = 0;
          return;
        }
        received_ += static_cast<std::size_t>(bytes);
        if (received_ >= sizeof(Head)) frame_.require_size(frame_.head().size);
      }
      received_ = 0;
      call_back_(frame_.stamp());
    }

    int64_t publishers() const noexcept { return connection_ ? 1 : 0; }

   private:
    bool connect_to_publisher(int64_t limit_ns) {
      File connection(socket(Kind::family, SOCK_STREAM | SOCK_CLOEXEC, 0));
      const auto address = Kind::address();
      if (connect(connection.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) return false;
      set_option(connection, SOL_SOCKET, SO_RCVTIMEO, duration(limit_ns));
      Kind::set_up(connection);
      connection_ = std::move(connection);
      return true;
    }

    CallBack& call_back_;
    Frame frame_;
    File connection_;
    std::size_t received_ = 0;  // bytes of the message that is coming
  };
};

}  // namespace transport
