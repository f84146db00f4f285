// UDP on loopback: a message is a datagram, and one that finds no room is lost.
//
// A subscriber asks at the publisher's port until an empty datagram answers from a socket that the publisher has for this
// subscriber alone. The two are connected then, so that each side learns when the other's socket is closed.
#pragma once

#include <algorithm>
#include <vector>

#include "frame.h"
#include "socket.h"

struct Transport {
  static constexpr char name[] = "udp";
  static constexpr int64_t payload_bytes_max = 65507 - static_cast<int64_t>(sizeof(transport::Head));
  using Context = transport::Context;

  // Whether the other end of a connected socket is still there.
  static bool is_there(const transport::File& file) noexcept {
    // Where nobody listens, the error comes back at once, with the next call.
    send(file.number(), nullptr, 0, 0);
    return send(file.number(), nullptr, 0, 0) == 0 || errno != ECONNREFUSED;
  }

  class Publisher {
   public:
    Publisher(Context&, const rt_tests::Options& options)
        : frame_(options), asked_(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
      const sockaddr_in address = transport::loopback(transport::port());
      transport::require(bind(asked_.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0,
                         "take UDP port " + std::to_string(transport::port()) + " of 127.0.0.1");
    }

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      frame_.set(stamp);
      remove_if([this](const Peer& peer) {
        return send(peer.file.number(), frame_.data(), frame_.size(), 0) < 0 && errno == ECONNREFUSED;
      });
      return true;
    }
    std::string problem() const { return ""; }

    int64_t subscribers() {
      char byte;
      sockaddr_in from{};
      for (socklen_t size = sizeof from;
           recvfrom(asked_.number(), &byte, 1, 0, reinterpret_cast<sockaddr*>(&from), &size) >= 0;) {
        const auto known = [&](const Peer& peer) { return peer.port == from.sin_port; };
        if (std::any_of(peers_.begin(), peers_.end(), known)) continue;
        transport::File file(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
        if (connect(file.number(), reinterpret_cast<const sockaddr*>(&from), size) != 0) continue;
        peers_.push_back({from.sin_port, std::move(file)});
      }
      remove_if([](const Peer& peer) { return !is_there(peer.file); });
      return static_cast<int64_t>(peers_.size());
    }

   private:
    struct Peer {
      in_port_t port;  // on loopback, where all are
      transport::File file;
    };

    template <class Condition>
    void remove_if(Condition condition) noexcept {
      peers_.erase(std::remove_if(peers_.begin(), peers_.end(), condition), peers_.end());
    }

    transport::Frame frame_;
    const transport::File asked_;
    std::vector<Peer> peers_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context&, const rt_tests::Options& options, CallBack& call_back)
        : call_back_(call_back), frame_(options), file_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
      const sockaddr_in address = transport::loopback(0);
      transport::require(bind(file_.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0,
                         "take a UDP port of 127.0.0.1");
    }

    // At most one message. The limit is that of every call, as the socket has it.
    void receive(int64_t limit_ns) {
      if (limit_ns != limit_ns_) {
        transport::set_option(file_, SOL_SOCKET, SO_RCVTIMEO, transport::duration(limit_ns));
        limit_ns_ = limit_ns;
      }
      if (!connected_) return find_publisher();
      // MSG_TRUNC: the datagram's size, however much of it there is room for.
      const ssize_t bytes = recv(file_.number(), frame_.data(), frame_.size(), MSG_TRUNC);
      if (bytes <= 0) return;  // none in time, or an empty one
      frame_.require_size(static_cast<std::size_t>(bytes));
      call_back_(frame_.stamp());
    }

    int64_t publishers() const noexcept { return connected_ && is_there(file_) ? 1 : 0; }

   private:
    void find_publisher() {
      const sockaddr_in publisher = transport::loopback(transport::port());
      sendto(file_.number(), nullptr, 0, 0, reinterpret_cast<const sockaddr*>(&publisher), sizeof publisher);
      sockaddr_in from{};
      socklen_t size = sizeof from;
      char byte;
      if (recvfrom(file_.number(), &byte, 1, 0, reinterpret_cast<sockaddr*>(&from), &size) != 0) return;
      connected_ = connect(file_.number(), reinterpret_cast<const sockaddr*>(&from), size) == 0;
    }

    CallBack& call_back_;
    transport::Frame frame_;
    const transport::File file_;
    bool connected_ = false;
    int64_t limit_ns_ = 0;
  };
};
