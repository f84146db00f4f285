#include "rt_tests_support/measure/messages.h"

#include <time.h>

#include "rt_tests_support/files.h"
#include "rt_tests_support/json.h"
#include "rt_tests_support/measure/publisher.h"
#include "rt_tests_support/measure/subscriber.h"

namespace communication {
namespace {

void list_events(const rt_tests::Events& noted, const std::string& kind, const std::string& heading,
                 std::vector<std::string>& lines) {
  if (noted.count() == 0) return;
  std::string list = heading + " messages: |";
  for (int64_t index : noted.indices()) list += std::to_string(index) + "|";
  if (noted.count() > static_cast<int64_t>(noted.indices().size())) list += "...";
  lines.push_back("Total of " + std::to_string(noted.count()) + " " + kind + " messages.");
  lines.push_back(list);
}

}  // namespace

std::string output(const rt_tests::Options& options) {
  const auto number = [&](const char* key) { return std::to_string(options.number(key)); };
  return "ct_gnuplot_l" + number("repetitions") + "_fq" + number("frequency_hz") + "_pl" + number("payload_bytes") +
         rt_tests::policy_suffix(options);
}

void require_payload(const rt_tests::Options& options, const char* middleware, int64_t payload_bytes_max) {
  const int64_t asked = options.number("payload_bytes");
  if (asked <= payload_bytes_max) return;
  throw rt_tests::UsageError("-l takes at most " + std::to_string(payload_bytes_max) + " bytes through " + middleware +
                             ", got '" + std::to_string(asked) + "'");
}

void pause(int64_t ns) {
  timespec remaining;
  remaining.tv_sec = static_cast<time_t>(ns / rt_tests::ns_per_s);
  remaining.tv_nsec = static_cast<long>(ns % rt_tests::ns_per_s);
  while (!rt_tests::stop_requested() && nanosleep(&remaining, &remaining) != 0) {
  }
}

void report(const rt_tests::Program& program, const rt_tests::Options& options, const rt_tests::Destination& destination,
            const rt_tests::Surroundings& surroundings, const Published& published, const std::string& problem) {
  const int64_t asked = options.number("repetitions");
  const bool all = published.messages == asked;
  const std::string reason = all ? "" : problem.empty() ? rt_tests::stop_reason() : problem;
  rt_tests::Json json;
  json.open('{');
  rt_tests::write_head(json, program, options, reason, surroundings);
  json.key("counts").open('{').field("asked", asked).field("sent", published.messages).close();
  rt_tests::write_rate(json, published.rate);
  const std::string text = json.close().text();
  rt_tests::write_file(destination.path("-publisher.json"), {{text.data(), text.size()}});
  if (!all) {
    throw rt_tests::Failure(reason + " after " + std::to_string(published.messages) + " of " + std::to_string(asked) +
                            " messages");
  }
}

void report(Session& session, const rt_tests::Options& options, const Receptions& receptions,
            const std::string& ended_by) {
  const std::string asked = std::to_string(options.number("repetitions"));
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
                 " samples; payload length " + std::to_string(options.number("payload_bytes"));
  if (rt_tests::is_realtime(options)) report.title += "; test node RT " + options.text("policy");
  report.heading = {"Measurement results:"};
  report.lines = {"Amount messages: " + asked +
                      "; Messages out of order: " + std::to_string(report.out_of_order.count()),
                  rt_tests::extremes(latency, "", "\t")};
  for (const auto& line : rt_tests::boundary_lines(latency)) report.lines.push_back(line);
  list_events(report.missing, "missing", "Missing", report.lines);
  list_events(report.duplicate, "duplicate", "Duplicate", report.lines);
  session.write(receptions.incomplete_reason(ended_by));
}

}  // namespace communication
