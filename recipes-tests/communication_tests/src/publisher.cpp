// Publishes time-stamped messages for communication_tests_subscriber.
#include <communication_tests/timestamp_msg.h>
#include <ros/ros.h>

#include "output.h"
#include "pace.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"
#include "rt_tests_support/json.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/report.h"

namespace {

const rt_tests::Program program =
    rt_tests::described("communication_tests_publisher",
                        "Publishes time-stamped messages for communication_tests_subscriber.");

struct Published {
  int64_t messages = 0;
  rt_tests::Rate rate;
};

Published publish(const rt_tests::Options& options, clockid_t clock, ros::Publisher& publisher) {
  const int64_t count = options.number("repetitions");
  communication_tests::timestamp_msg message;
  message.payload.assign(static_cast<std::size_t>(options.number("payload_bytes")), 0xff);
  communication::Pace pace(options.number("frequency_hz"));
  int64_t sent = 0, first_ns = 0, publication_ns = 0;
  while (true) {
    message.seq = static_cast<uint32_t>(sent);
    message.last_msg = sent == count - 1;
    publication_ns = rt_tests::now_ns(clock);
    if (sent == 0) first_ns = publication_ns;
    message.sec = static_cast<uint32_t>(publication_ns / rt_tests::ns_per_s);
    message.nsec = static_cast<uint32_t>(publication_ns % rt_tests::ns_per_s);
    publisher.publish(message);
    ++sent;
    if (!ros::ok()) rt_tests::request_stop();
    if (sent == count || !pace.wait()) break;
  }
  return {sent, {options.number("frequency_hz"), rt_tests::frequency_hz(static_cast<std::size_t>(sent), first_ns,
                                                                        publication_ns),
                 pace.overruns(), pace.skipped()}};
}

void write_json(const std::string& path, const rt_tests::Options& options, const std::string& incomplete_reason,
                const rt_tests::Surroundings& surroundings, const Published& published) {
  rt_tests::Json json;
  json.open('{');
  rt_tests::write_head(json, program, options, incomplete_reason, surroundings);
  json.key("counts").open('{').field("asked", options.number("repetitions")).field("sent", published.messages).close();
  rt_tests::write_rate(json, published.rate);
  const std::string text = json.close().text();
  rt_tests::write_file(path, {{text.data(), text.size()}});
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
  const rt_tests::Destination destination = rt_tests::destination(options, communication::output(options));
  rt_tests::set_up_process(options);
  const rt_tests::CpuDmaLatency cpu_dma_latency(options);
  rt_tests::Surroundings surroundings(rt_tests::clock_of(options.text("clock")));
  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  ros::NodeHandle node;
  ros::Publisher publisher = node.advertise<communication_tests::timestamp_msg>("communication_tests", 1000);
  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(nullptr);

  delay(options.number("start_delay_s"));
  Published published{0, {options.number("frequency_hz"), std::nullopt, 0, 0}};
  if (!rt_tests::stop_requested()) published = publish(options, surroundings.clock, publisher);
  const bool all = published.messages == options.number("repetitions");
  if (all) wait_for_subscribers_to_leave(publisher);
  surroundings.finish();  // not before: reading the threads takes CPU time that the last message may need
  rt_tests::give_up_realtime();
  ros::shutdown();
  const std::string reason = all ? "" : rt_tests::stop_reason();
  write_json(destination.path("-publisher.json"), options, reason, surroundings, published);
  if (!all) {
    throw rt_tests::Failure(reason + " after " + std::to_string(published.messages) + " of " +
                            std::to_string(options.number("repetitions")) + " messages");
  }
  rt_tests::info("Done publishing...");
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
