// ZeroMQ, over ipc or, with RT_TESTS_ZEROMQ=tcp in the environment, over TCP on loopback.
#pragma once

#include <sched.h>
#include <zmq.h>

#include <cerrno>
#include <memory>

#include "domain.h"
#include "frame.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/stop.h"

struct Transport {
  static constexpr char name[] = "zeromq";
  static constexpr int64_t payload_bytes_max = 16 * 1024 * 1024;
  static constexpr int queue = 1000;  // messages, as the programs on roscpp have

  static void require(bool holds, const std::string& what) {
    if (!holds) throw rt_tests::Failure("ZeroMQ cannot " + what + ": " + zmq_strerror(zmq_errno()));
  }

  static std::string endpoint() {
    const char* const text = std::getenv("RT_TESTS_ZEROMQ");
    const std::string over = text ? text : "ipc";
    if (over == "tcp") return "tcp://127.0.0.1:" + std::to_string(transport::port());
    // An abstract socket: there is no file that a killed program could leave.
    if (over == "ipc") return "ipc://@rt_tests-zeromq-" + std::to_string(transport::domain());
    throw rt_tests::UsageError("RT_TESTS_ZEROMQ takes ipc|tcp, got '" + over + "'");
  }

  // Its threads inherit policy, priority and CPUs. They are told besides, as ZeroMQ has options for it.
  class Context {
   public:
    Context(int, char*[], const rt_tests::Program&, const rt_tests::Options& options) : context_(zmq_ctx_new()) {
      require(context_ != nullptr, "make a context");
      if (!rt_tests::is_realtime(options) || options.text("rt_scope") != "process") return;
      const int policy = options.text("policy") == "FIFO" ? SCHED_FIFO : SCHED_RR;
      require(zmq_ctx_set(context_.get(), ZMQ_THREAD_SCHED_POLICY, policy) == 0 &&
                  zmq_ctx_set(context_.get(), ZMQ_THREAD_PRIORITY, static_cast<int>(options.number("priority"))) == 0,
              "set policy and priority of its threads");
    }
    void* get() const noexcept { return context_.get(); }
    rt_tests::Facts facts() const { return transport::facts(); }
    bool ok() const noexcept { return true; }
    void shutdown() {}

   private:
    struct End {
      void operator()(void* context) const { zmq_ctx_term(context); }
    };
    const std::unique_ptr<void, End> context_;
  };

  class Socket {
   public:
    Socket(Context& context, int type) : socket_(zmq_socket(context.get(), type)) {
      require(socket_ != nullptr, "make a socket");
      set(ZMQ_LINGER, 0);
      set(ZMQ_SNDHWM, queue);
      set(ZMQ_RCVHWM, queue);
    }
    void set(int option, int value) {
      require(zmq_setsockopt(socket_.get(), option, &value, sizeof value) == 0, "set option " + std::to_string(option));
    }
    void* get() const noexcept { return socket_.get(); }

   private:
    struct End {
      void operator()(void* socket) const { zmq_close(socket); }
    };
    const std::unique_ptr<void, End> socket_;
  };

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options) : frame_(options), socket_(context, ZMQ_XPUB) {
      socket_.set(ZMQ_XPUB_VERBOSER, 1);  // tells each subscriber that comes and goes
      const std::string at = endpoint();
      require(zmq_bind(socket_.get(), at.c_str()) == 0, "publish at " + at);
    }

    // What finds its subscriber's queue full is dropped.
    bool publish(const rt_tests::Stamp& stamp) noexcept {
      frame_.set(stamp);
      while (zmq_send(socket_.get(), frame_.data(), frame_.size(), ZMQ_DONTWAIT) < 0 && errno == EINTR &&
             !rt_tests::stop_requested()) {
      }
      return true;
    }
    std::string problem() const { return ""; }

    int64_t subscribers() {
      unsigned char begins;  // 1: a subscriber came, 0: one left
      while (zmq_recv(socket_.get(), &begins, 1, ZMQ_DONTWAIT) > 0) subscribers_ += begins == 1 ? 1 : -1;
      return subscribers_;
    }

   private:
    transport::Frame frame_;
    Socket socket_;
    int64_t subscribers_ = 0;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options& options, CallBack& call_back)
        : call_back_(call_back), frame_(options), socket_(context, ZMQ_SUB), events_(context, ZMQ_PAIR) {
      constexpr char events[] = "inproc://events";
      require(zmq_socket_monitor(socket_.get(), events, ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_DISCONNECTED) == 0 &&
                  zmq_connect(events_.get(), events) == 0,
              "watch a socket");
      require(zmq_setsockopt(socket_.get(), ZMQ_SUBSCRIBE, "", 0) == 0, "subscribe");
      const std::string at = endpoint();
      require(zmq_connect(socket_.get(), at.c_str()) == 0, "subscribe at " + at);
    }

    // At most one message.
    void receive(int64_t limit_ns) {
      if (limit_ns != limit_ns_) {
        socket_.set(ZMQ_RCVTIMEO, static_cast<int>(limit_ns / 1000000));
        limit_ns_ = limit_ns;
      }
      const int bytes = zmq_recv(socket_.get(), frame_.data(), frame_.size(), 0);
      if (bytes < 0) return;
      frame_.require_size(static_cast<std::size_t>(bytes));
      call_back_(frame_.stamp());
    }

    int64_t publishers() {
      unsigned char event[6];  // 16 bits say what happened
      while (zmq_recv(events_.get(), event, sizeof event, ZMQ_DONTWAIT) > 0) {
        uint16_t what;
        std::memcpy(&what, event, sizeof what);
        publishers_ = what == ZMQ_EVENT_HANDSHAKE_SUCCEEDED ? 1 : 0;
        zmq_recv(events_.get(), event, sizeof event, ZMQ_DONTWAIT);  // where
      }
      return publishers_;
    }

   private:
    CallBack& call_back_;
    transport::Frame frame_;
    Socket socket_;
    Socket events_;
    int64_t limit_ns_ = 0;
    int64_t publishers_ = 0;
  };
};
