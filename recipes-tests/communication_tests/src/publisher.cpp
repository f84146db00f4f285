// Publishes time-stamped messages for communication_tests_subscriber.
#include <communication_tests/timestamp_msg.h>
#include <ros/ros.h>

#include "pace.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/process.h"

namespace {

const rt_tests::Program program = {"communication_tests",
                                   "communication_tests_publisher",
                                   "Publishes time-stamped messages for communication_tests_subscriber.",
                                   {"policy", "repetitions", "prefix", "frequency_hz", "payload_bytes",
                                    "start_delay_s", "priority", "cpu", "clock", "rt_scope"}};

// Returns the number of messages published.
int64_t publish(const rt_tests::Options& options, ros::Publisher& publisher) {
  const clockid_t clock = rt_tests::clock_of(options.text("clock"));
  const int64_t count = options.number("repetitions");
  communication_tests::timestamp_msg message;
  message.payload.assign(static_cast<std::size_t>(options.number("payload_bytes")), 0xff);
  communication::Pace pace(options.number("frequency_hz"));
  for (int64_t i = 0; i < count; ++i) {
    message.seq = static_cast<uint32_t>(i);
    message.last_msg = i == count - 1;
    const int64_t publication_ns = rt_tests::now_ns(clock);
    message.sec = static_cast<uint32_t>(publication_ns / rt_tests::ns_per_s);
    message.nsec = static_cast<uint32_t>(publication_ns % rt_tests::ns_per_s);
    publisher.publish(message);
    if (!pace.wait() || !ros::ok()) return i + 1;
  }
  return count;
}

// ros::shutdown drops messages that are still queued. Our subscribers leave after the last message; other subscribers
// may stay, hence the limit.
void wait_for_subscribers_to_leave(const ros::Publisher& publisher) {
  const ros::WallTime limit = ros::WallTime::now() + ros::WallDuration(5.0);
  while (publisher.getNumSubscribers() > 0 && ros::ok() && ros::WallTime::now() < limit) {
    ros::WallDuration(0.01).sleep();
  }
}

void delay(int64_t seconds) {
  timespec remaining;
  remaining.tv_sec = static_cast<time_t>(seconds);
  remaining.tv_nsec = 0;
  while (!rt_tests::stop_requested() && nanosleep(&remaining, &remaining) != 0) {
  }
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  rt_tests::set_up_process(options);
  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  ros::NodeHandle node;
  ros::Publisher publisher = node.advertise<communication_tests::timestamp_msg>("communication_tests", 1000);
  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(nullptr);

  delay(options.number("start_delay_s"));
  const int64_t published = rt_tests::stop_requested() ? 0 : publish(options, publisher);
  const bool all = published == options.number("repetitions");
  if (all) wait_for_subscribers_to_leave(publisher);
  rt_tests::give_up_realtime();
  ros::shutdown();
  rt_tests::info(all ? "Done publishing..."
                     : "Stopped publishing after " + std::to_string(published) + " of " +
                           std::to_string(options.number("repetitions")) + " messages");
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
