// Measures the latency of the messages of communication_tests_publisher.
#include <communication_tests/timestamp_msg.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include "output.h"
#include "receptions.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"

namespace {

using communication::Receptions;
using Session = rt_tests::MeasurementSession<communication::columns>;

const rt_tests::Program program =
    rt_tests::described("communication_tests_subscriber",
                        "Measures the latency of the messages of communication_tests_publisher.");

// Decides whether to wait longer for a publisher that sends nothing.
class Silence {
 public:
  // Before the first message only an --idle-timeout given on the command line ends the waiting: the publisher may be
  // started much later.
  explicit Silence(const rt_tests::Options& options)
      : limit_ns_(options.number("idle_timeout_s") * rt_tests::ns_per_s),
        limit_is_given_(options.given("idle_timeout_s")),
        delay_ns_(options.number("start_delay_s") * rt_tests::ns_per_s),
        since_ns_(rt_tests::now_ns(CLOCK_MONOTONIC)) {}

  // Why to end the measurement; empty: wait longer. To be called when no message came for a while.
  std::string reason_to_end(std::size_t received, uint32_t publishers) {
    const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
    if (received != received_) {
      received_ = received;
      since_ns_ = now_ns;
    }
    if (publishers > 0) publisher_seen_ = true;
    if (publisher_seen_ && publishers == 0) return "the publisher left";
    const int64_t limit_ns = limit_ns_ + (received == 0 ? delay_ns_ : 0);
    if ((received > 0 || limit_is_given_) && now_ns - since_ns_ > limit_ns) {
      return "nothing came for " + std::to_string(limit_ns / rt_tests::ns_per_s) + " s";
    }
    return "";
  }

 private:
  const int64_t limit_ns_;
  const bool limit_is_given_;
  const int64_t delay_ns_;
  int64_t since_ns_;
  std::size_t received_ = 0;
  bool publisher_seen_ = false;
};

// Receives until the last message. Returns what ended the measurement before that, empty if nothing did.
std::string receive(const rt_tests::Options& options, Session& session, Receptions& receptions) {
  const clockid_t clock = session.clock();
  bool broke = false;  // by --break-trace
  std::size_t received = 0;

  ros::NodeHandle node;
  using Message = communication_tests::timestamp_msg;
  const boost::function<void(const Message::ConstPtr&)> callback = [&](const Message::ConstPtr& message) {
    const int64_t reception_ns = rt_tests::now_ns(clock);
    if (broke || receptions.last_came()) return;
    const int64_t publication_ns = int64_t{message->sec} * rt_tests::ns_per_s + message->nsec;
    ++received;
    receptions.receive(publication_ns, reception_ns, message->seq, message->last_msg);
    broke = session.outliers.exceeded(reception_ns - publication_ns, message->seq, reception_ns);
  };
  ros::Subscriber subscriber = node.subscribe<Message>("communication_tests", 1000, callback);

  session.begin();
  Silence silence(options);
  std::string ended_by;
  std::size_t before = 0;
  while (!receptions.last_came() && !broke && !rt_tests::stop_requested() && ended_by.empty()) {
    if (!ros::ok()) rt_tests::request_stop();
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
    if (received == before) ended_by = silence.reason_to_end(received, subscriber.getNumPublishers());
    before = received;
  }
  session.end();
  return ended_by.empty() ? rt_tests::stop_reason() : ended_by;
}

void list_events(const rt_tests::Events& noted, const std::string& kind, const std::string& heading,
                 std::vector<std::string>& lines) {
  if (noted.count() == 0) return;
  std::string list = heading + " messages: |";
  for (int64_t index : noted.indices()) list += std::to_string(index) + "|";
  if (noted.count() > static_cast<int64_t>(noted.indices().size())) list += "...";
  lines.push_back("Total of " + std::to_string(noted.count()) + " " + kind + " messages.");
  lines.push_back(list);
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  const std::string asked = std::to_string(options.number("repetitions"));
  const std::string payload = std::to_string(options.number("payload_bytes"));
  Session session(program, options, communication::output(options), options.number("repetitions"),
                  rt_tests::ns_per_s / options.number("frequency_hz"));
  Receptions receptions(session.samples);

  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  const std::string ended_by = receive(options, session, receptions);
  session.tear_down();
  ros::shutdown();

  rt_tests::Series latency("latency");
  for (std::size_t i = 0; i < session.samples.size(); ++i) {
    const auto& [publication_ns, reception_ns, seq] = session.samples[i];
    latency.add(reception_ns - publication_ns, seq);
  }
  rt_tests::Report& report = session.report;
  report.measured = latency.n();
  report.rate.asked_hz = options.number("frequency_hz");
  report.rate.achieved_hz = session.frequency_hz(1);
  report.missing = receptions.missing();
  report.duplicate = receptions.duplicate;
  report.out_of_order = receptions.out_of_order;
  report.series = {&latency};
  report.plot = rt_tests::Plot::communication;
  report.logs = {{".log", &latency}};
  report.title = "communication_tests plot " + rt_tests::machine_title() + " -  " + asked +
                 " samples; payload length " + payload;
  if (rt_tests::is_realtime(options)) report.title += "; test node RT " + options.text("policy");
  report.heading = {"Measurement results:"};
  report.lines = {"Amount messages: " + asked +
                      "; Messages out of order: " + std::to_string(report.out_of_order.count()),
                  rt_tests::extremes(latency, "", "\t")};
  for (const auto& line : rt_tests::boundary_lines(latency)) report.lines.push_back(line);
  list_events(report.missing, "missing", "Missing", report.lines);
  list_events(report.duplicate, "duplicate", "Duplicate", report.lines);
  session.write(receptions.incomplete_reason(ended_by));
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
