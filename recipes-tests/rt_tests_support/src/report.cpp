#include "rt_tests_support/report.h"

#include <sys/utsname.h>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"
#include "rt_tests_support/json.h"

namespace rt_tests {
namespace {

void write_requested(Json& json, const Options& options) {
  json.key("requested").open('{');
  for (const auto& value : options.values()) {
    json.key(value.option.key);
    if (!value.set) {
      json.null();
    } else if (value.option.kind == Kind::integer) {
      json.value(value.number);
    } else {
      json.value(value.text);
    }
  }
  json.close();
}

void write_in_effect(Json& json, const Surroundings& surroundings) {
  json.key("in_effect").open('{').key("threads").open('[');
  for (const auto& thread : surroundings.threads) {
    json.open('{').field("tid", thread.tid).field("name", thread.name).field("policy", thread.policy);
    json.field("priority", thread.priority).field("cpus", thread.cpus).close();
  }
  json.close();
  json.field("clock", clock_name(surroundings.clock));
  json.field("clock_resolution_ns", clock_resolution_ns(surroundings.clock));
  json.field("clock_step_ns", surroundings.clock_step_ns);
  json.field("mlockall", surroundings.memory_locked);
  json.field("cpu_dma_latency_us", surroundings.cpu_dma_latency_us);
  json.key("facts").open('{');
  for (const auto& [name, value] : surroundings.facts) json.field(name, value);
  json.close().close();
}

void write_costs(Json& json, const std::optional<Costs>& costs) {
  json.key("costs");
  if (!costs) {
    json.null();
    return;
  }
  json.open('{').field("minor_faults", costs->minor_faults).field("major_faults", costs->major_faults);
  json.field("voluntary_switches", costs->voluntary_switches);
  json.field("involuntary_switches", costs->involuntary_switches).field("cpu_time_ns", costs->cpu_time_ns);
  if (const auto& counted = costs->allocations) {
    json.field("allocations", counted->allocations).field("frees", counted->frees);
    json.field("allocations_of_measuring_thread", counted->of_measuring_thread);
  }
  json.close();
}

void write_series(Json& json, const Series& series) {
  const auto list = [&](const char* name, const std::vector<Indexed>& items) {
    json.key(name).open('[');
    for (const auto& item : items) {
      json.open('{').field("value_ns", item.value_ns).field("index", item.index).close();
    }
    json.close();
  };
  json.key(series.name()).open('{').field("n", series.n());
  if (series.n() > 0) {
    json.field("min_ns", series.min_ns()).field("mean_ns", series.mean_ns()).field("max_ns", series.max_ns());
  } else {
    json.key("min_ns").null().key("mean_ns").null().key("max_ns").null();
  }
  list("top", series.top());
  list("lowest", series.lowest());
  json.close();
}

}  // namespace

std::string policy_suffix(const Options& options) {
  return is_realtime(options) ? "-tnRT" + options.text("policy") : "";
}

Destination destination(const Options& options, const std::string& base) {
  Destination place{options.text("out_dir"), options.text("prefix") + base};
  if (!place.folder.empty() && place.folder.back() != '/') place.folder += '/';
  require_writable_folder(folder_of(place.path("")));
  return place;
}

Surroundings::Surroundings(clockid_t chosen)
    : clock(chosen), clock_step_ns(rt_tests::clock_step_ns(chosen)), start_time(utc_now()) {}

void Surroundings::end() {
  if (begin_) costs = costs_so_far() - *begin_;
}

void Surroundings::finish() {
  end_time = utc_now();
  threads = read_threads();
  memory_locked = memory_is_locked();
  cpu_dma_latency_us = rt_tests::cpu_dma_latency_us();
}

std::optional<double> frequency_hz(std::size_t count, int64_t first_ns, int64_t last_ns) {
  if (count < 2 || last_ns <= first_ns) return std::nullopt;
  return static_cast<double>(count - 1) * ns_per_s / static_cast<double>(last_ns - first_ns);
}

void write_head(Json& json, const Program& program, const Options& options, const std::string& incomplete_reason,
                const Surroundings& surroundings) {
  utsname names{};
  uname(&names);
  json.field("schema", 1).field("suite", program.suite).field("program", program.name);
  json.field("middleware", program.middleware);
  json.field("version", version()).field("complete", incomplete_reason.empty()).key("incomplete_reason");
  if (incomplete_reason.empty()) {
    json.null();
  } else {
    json.value(incomplete_reason);
  }
  write_requested(json, options);
  write_in_effect(json, surroundings);
  json.field("host", std::string(names.nodename)).key("kernel").open('{');
  json.field("release", std::string(names.release)).field("version", std::string(names.version));
  json.field("machine", std::string(names.machine)).close();
  json.field("start_time", surroundings.start_time).field("end_time", surroundings.end_time);
  write_costs(json, surroundings.costs);
}

void write_rate(Json& json, const Rate& rate) {
  json.key("rate").open('{').field("asked_hz", rate.asked_hz).field("achieved_hz", rate.achieved_hz);
  json.field("overruns", rate.overruns).field("skipped", rate.skipped).close();
}

std::string json_of(const Report& report, const Surroundings& surroundings, const Destination& destination) {
  Json json;
  json.open('{');
  write_head(json, *report.program, *report.options, report.incomplete_reason, surroundings);

  const std::vector<std::pair<const char*, const Events*>> events = {{"not_fired", &report.not_fired},
                                                                    {"missing", &report.missing},
                                                                    {"duplicate", &report.duplicate},
                                                                    {"out_of_order", &report.out_of_order}};
  json.key("counts").open('{').field("asked", report.asked).field("measured", report.measured);
  for (const auto& [name, noted] : events) json.field(name, noted->count());
  json.close().key("indices").open('{');
  for (const auto& [name, noted] : events) json.field(name, noted->indices());
  json.close();
  write_rate(json, report.rate);
  json.key("summary").open('{');
  for (const Series* series : report.series) write_series(json, *series);
  json.close().key("files").open('{').key("logs").open('[');
  for (const auto& log : report.logs) json.value(name_of(destination.path(log.ending)));
  json.close().field("npy", name_of(destination.path(".npy"))).close();
  json.field("columns", report.program->columns);
  json.key("traces").open('{').field("above_limit", report.traces ? report.traces->above() : 0);
  json.field("files", report.traces ? report.traces->files() : std::vector<std::string>{}).close();
  return json.close().text();
}

void write_report(Report& report, const Surroundings& surroundings, const Destination& destination,
                  const int64_t* rows, std::size_t row_count, std::size_t columns) {
  if (!report.incomplete_reason.empty()) {
    report.lines.push_back("Incomplete: " + std::to_string(report.measured) + " of " + std::to_string(report.asked) +
                           " measured, " + report.incomplete_reason);
  }
  if (report.traces && report.traces->above() > 0) {
    info("Kernel traces: " + std::to_string(report.traces->files().size()) + " of " +
         std::to_string(report.traces->above()) + " values above the limit");
  }
  for (const auto& line : report.heading) info(line);
  for (const auto& line : report.lines) info(line);

  write_npy(destination.path(".npy"), rows, row_count, columns);
  for (const auto& log : report.logs) {
    const std::string output = destination.name + log.ending.substr(0, log.ending.rfind('.'));
    const std::string text = gnuplot_log(report.plot, report.title, output, *log.series, report.lines);
    write_file(destination.path(log.ending), {{text.data(), text.size()}});
  }
  const std::string json = json_of(report, surroundings, destination);
  write_file(destination.path(".json"), {{json.data(), json.size()}});
}

}  // namespace rt_tests
