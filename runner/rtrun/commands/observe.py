"""``rtrun observe``: programs that run already, measured as they are."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._arguments import add_target
from rtrun.commands._question import argument, time_argument
from rtrun.plan.observation import read_path, read_stream_deadline

if TYPE_CHECKING:
    from rtrun.execution.observation import Watched
    from rtrun.execution.ros_graph import RosGraph

NAME = "observe"
HELP = "measure nodes that run already, unmodified: messages, timers, callbacks, reaction times"
EXAMPLES = (
    "rtrun observe --target robot.yml --list",
    "rtrun observe --target robot.yml --for 60s --deadline /cmd_vel=5ms",
)
# Messages and callbacks that a file for Perfetto holds: it is read whole by a browser.
DRAWN_MAX = 200_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `observe` takes."""
    add_target(parser)
    parser.add_argument(
        "--for", type=time_argument, default=60 * 10**9, dest="for_ns", metavar="TIME", help="how long [1min]"
    )
    parser.add_argument("--list", action="store_true", help="say what runs there and can be measured; measure nothing")
    parser.add_argument(
        "--deadline",
        type=argument(read_stream_deadline),
        action="append",
        default=[],
        metavar="STREAM=TIME",
        help="of messages /cmd_vel=5ms, of a path /a,/b=9ms; timer:/node=1ms, callback:/node=1ms, interval:/scan=50ms",
    )
    parser.add_argument(
        "--path",
        type=argument(read_path),
        action="append",
        default=[],
        metavar="/A,/B",
        help="topics whose reaction time is measured, from the first to the last",
    )
    parser.add_argument(
        "--trace",
        type=argument(_read_trace),
        metavar="above=LIMIT",
        help="keep the kernel's trace around late values, for rtrun why: above=p99.9, or above=300us",
    )
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="[results/<name of the target>]")
    parser.add_argument("--json", action="store_true", help="print a JSON object a second, for programs")
    parser.add_argument(
        "--perfetto", type=Path, metavar="FILE", help="write messages and callbacks for ui.perfetto.dev"
    )


def _read_trace(text: str) -> str:
    """Read ``above=p99.9`` or ``above=300us``. Raises ValueError."""
    from rtfiles.config import Place
    from rtfiles.errors import UsageError
    from rtrun.plan.trace import read_trace

    key, _, limit = text.partition("=")
    try:
        return read_trace({key: limit}, Place("--trace"))
    except UsageError as error:
        raise ValueError(str(error)) from error


def run(args: argparse.Namespace) -> int:
    """Observe, show it while it lasts, keep it. 0: it was observed, 3: out of reach, or it cannot be observed."""
    import shlex

    from rtfiles import atomic
    from rtfiles.invocation import as_called
    from rtfiles.output import print_line, print_status
    from rtrun.commands._link import linked
    from rtrun.execution import observation
    from rtrun.execution.ros_graph import read_graph
    from rtrun.flows.hazards import hazards
    from rtrun.flows.recorder import FlowRecorder
    from rtrun.plan.observation import ObservationPlan
    from rtrun.report.flow_trace import flow_trace
    from rtrun.report.live import LiveView
    from rtrun.results import run_directory
    from rtrun.targets.config import read_target

    config = read_target(args.target)
    plan = ObservationPlan(for_s=args.for_ns / 1e9, deadlines=args.deadline, paths=args.path, trace=args.trace or "")
    print_status(f"asking {config.name} what runs there")
    with linked(config, args.target.parent) as link:
        watched = observation.watch(link, plan)
        print_status("")
        if args.list:
            _print_list(watched, read_graph(link, watched.scripts, watched.found))
            return 0
        results = args.results or Path("results") / config.name
        # What would be known at the end only, hours later.
        run_directory.make_results(results)
        if args.perfetto is not None:
            atomic.write_text(args.perfetto, "")
        recorder = FlowRecorder(DRAWN_MAX) if args.perfetto else None
        with LiveView(as_json=args.json) as view:
            observed = observation.observe(watched, plan, on_second=view.show, recorder=recorder)
        left_out = observation.write(results, watched, plan, observed)
    if recorder is not None:
        atomic.write_text(args.perfetto, flow_trace(recorder, observed.programs))
    if not args.json:
        for text in (*observed.remarks, *left_out, *hazards(observed.programs)):
            print_line(text)
        folder, call = shlex.quote(str(results)), as_called("rtrun")
        why = f"; {call} why {folder}" if args.trace else ""
        print_line(f"next: {call} report {folder}; {call} verdict {folder}{why}")
    return 0


def _print_list(watched: "Watched", graph: "RosGraph") -> None:
    """Each program, its nodes, who publishes to whom, what can be measured, and what threatens real time."""
    from rtfiles.output import counted, print_line
    from rtrun.flows.hazards import hazards
    from rtrun.flows.programs import label_of
    from rtrun.probes.placement import refusals

    events: dict[str, set[str]] = {}
    for probe in watched.placement.probes:
        events.setdefault(probe.path, set()).add(probe.event)
    if not watched.found:
        print_line("no program runs there that uses ROS")
    for each in watched.found:
        program = each.program
        print_line(f"{label_of(program)} (pid {program.pid}), {counted(len(program.threads), 'thread')}")
    for node in graph.nodes:
        of = f" of pid {node.pid}" if node.pid is not None else ""
        print_line(f"node {node.name}{of}{': serves ' if node.serves else ''}{', '.join(node.serves)}")
    for topic, (publishers, subscribers) in sorted(graph.topics.items()):
        ends = (", ".join(nodes) or "nobody" for nodes in (publishers, subscribers))
        print_line(f"topic {topic}: {' to '.join(ends)}")
    for path, measured in events.items():
        print_line(f"{path}: {', '.join(sorted(measured))}")
    for text in hazards([each.program for each in watched.found]):
        print_line(text)
    for text in (*refusals(watched.placement.refused), *graph.remarks):
        print_line(text)
