"""``rtrun observe``: measure programs that run already, unchanged."""

import argparse
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._arguments import add_target
from rtrun.commands._question import argument, time_argument

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rtrun.execution.observation import Watched
    from rtrun.execution.ros_graph import RosGraph
    from rtrun.plan.campaign import Campaign
    from rtrun.plan.run import Run
    from rtrun.targets.config import TargetConfig

HELP = "measure programs that run already, unmodified: messages, timers, callbacks, services, reaction times, loops"
EXAMPLES = (
    "rtrun observe --target robot.yml --list",
    "rtrun observe --target robot.yml --for 60s --deadline /cmd_vel=5ms",
)
DRAWN_MAX = 200_000  #: messages and callbacks in a file for Perfetto: a browser reads it whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser)
    parser.add_argument(
        "--for", type=time_argument, default=60 * 10**9, dest="for_ns", metavar="TIME", help="how long [1min]"
    )
    parser.add_argument("--list", action="store_true", help="say what runs there and can be measured; measure nothing")
    parser.add_argument(
        "--deadline",
        type=_reader("read_stream_deadline"),
        action="append",
        default=[],
        metavar="STREAM=TIME",
        help="of messages /cmd_vel=5ms, of a path /a,/b=9ms; timer:/node=1ms, callback:/node=1ms, interval:/scan=50ms, "
        "service:/grasp=20ms, loop:PROGRAM=200us, loop-response:PROGRAM=700us",
    )
    parser.add_argument(
        "--path",
        type=_reader("read_path"),
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
    parser.add_argument(
        "--until",
        type=argument(_read_until),
        metavar="KEY=VALUE,...",
        help="again and again until each stream with a deadline is decided, in the words of a campaign's until: "
        "probability=1e-4,at_most=2h",
    )
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="[results/<name of the target>]")
    parser.add_argument("--json", action="store_true", help="print a JSON object a second, for programs")
    parser.add_argument(
        "--perfetto", type=Path, metavar="FILE", help="write messages and callbacks for ui.perfetto.dev"
    )


def _reader(name: str) -> "Callable[[str], Any]":
    """A reader of `rtrun.plan.observation`, which is loaded when an option needs it."""
    return argument(lambda text: getattr(import_module("rtrun.plan.observation"), name)(text))


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


def _read_until(text: str) -> "dict[str, object]":
    """Read ``probability=1e-4,at_most=2h``, in the words of a campaign's `until`. Raises ValueError."""
    from rtfiles.config import Place, parse
    from rtfiles.errors import UsageError
    from rtrun.plan.goal import Goal

    pairs = [pair.partition("=")[::2] for pair in text.split(",")]
    words: dict[str, object] = {key.strip(): int(value) if value.isdecimal() else value for key, value in pairs}
    try:
        parse(words, Goal, Place("until"))
    except UsageError as error:
        raise ValueError(str(error)) from error
    return words


def run(args: argparse.Namespace) -> int:
    """Observe, show it meanwhile, keep it. 0: observed, 3: out of reach, or it cannot be observed."""
    from dataclasses import replace

    from rtfiles.errors import UsageError
    from rtrun.plan.campaign import plan
    from rtrun.plan.run import UNTRACED
    from rtrun.results import run_directory
    from rtrun.results.latest import default_results, set_latest
    from rtrun.targets.config import read_target

    config = read_target(args.target)
    if args.until and (args.json or args.perfetto or args.list):
        raise UsageError("--until measures round by round: it takes neither --json nor --perfetto nor --list")
    campaign = _campaign(args, config.name)
    (planned,) = (run for run in plan(campaign, "rtrun observe") if run.trace != UNTRACED)
    if args.list:
        return _list(args, config, planned)
    results: Path = args.results or default_results(config.name)
    # Otherwise a problem would only show at the end, hours later.
    run_directory.make_results(results)
    set_latest(results)
    if campaign.until is not None:
        from rtrun.commands._boards import TargetFile, print_failed
        from rtrun.commands._until import measure_until

        targets = [TargetFile(config=config, folder=args.target.parent)]
        groups = [planned]
        statuses = measure_until(Path("rtrun observe"), campaign, campaign.until, groups, groups, targets, results)
        status = print_failed(statuses)
    else:
        with run_directory.numbered(results) as folder:
            status = _observe_once(args, config, replace(planned, name=folder.name), folder)
    if not args.json:
        _print_what_follows(results, has_traces=bool(args.trace))
    return status


def _campaign(args: argparse.Namespace, name: str) -> "Campaign":
    """The campaign with one run that the arguments ask for."""
    from rtfiles.config import parse
    from rtrun.plan.campaign import Campaign
    from rtrun.plan.conditions import SAMPLER
    from rtrun.plan.observation import ATTACHED

    seconds, rest_ns = divmod(args.for_ns, 10**9)
    asked = {
        "schema": 1,
        "name": name,
        "subject": ATTACHED,
        "for": f"{seconds}.{rest_ns:09}s",
        "deadlines": [deadline.text for deadline in args.deadline],
        "paths": [",".join(path) for path in args.path],
        "runs": [{SAMPLER: "none"} | ({"trace": {"above": args.trace}} if args.trace else {})],
    }
    if args.until:
        asked |= {"until": args.until, "order": "interleaved", "seed": 1}
    return parse(asked, Campaign, "rtrun observe")


def _observe_once(args: argparse.Namespace, config: "TargetConfig", planned: "Run", folder: Path) -> int:
    """Observe as one run into a folder that has the run's name."""
    import secrets

    from rtfiles import atomic
    from rtfiles.errors import InfrastructureError
    from rtfiles.output import beside_the_answer, print_line, print_status
    from rtrun.commands._link import linked
    from rtrun.execution import preparation, run_execution
    from rtrun.execution.board import utc_now
    from rtrun.execution.observation import ObservationResult, Onlooker
    from rtrun.flows.recorder import FlowRecorder
    from rtrun.report.flow_trace import flow_trace
    from rtrun.report.live import LiveView
    from rtrun.results import run_directory
    from rtrun.results.observed import remarks_of
    from rtrun.results.record import RunStatus
    from rtrun.results.run_state import RunLife, RunState

    if args.perfetto is not None:
        atomic.write_named(args.perfetto, b"{}\n")  # better to fail now than after the observation
    recorder = FlowRecorder(DRAWN_MAX) if args.perfetto else None

    seen: list[ObservationResult] = []
    uid = f"observe-{secrets.token_hex(4)}"
    print_status(f"asking {config.name} what runs there")
    with (
        linked(config, args.target.parent) as link,
        preparation.prepared(link, uid, [planned], lambda: False) as ready,
        LiveView(as_json=args.json) as view,
    ):
        print_status("")
        onlooker = Onlooker(on_second=view.show, on_end=seen.append, recorder=recorder, is_attended=True)
        life = RunLife(lambda state, _: run_directory.mark_begun(folder) if state is RunState.OBSERVING else None)
        record = run_execution.measure(
            ready, uid, planned.name, planned, folder, life, utc_now, may_be_begun=False, onlooker=onlooker
        )
    if not args.json:
        for text in remarks_of([folder]):
            print_line(text)
    is_ok = record.status is RunStatus.OK
    if not is_ok:
        with beside_the_answer(args.json):
            print_line(f"{record.status}: {record.reason}")
    if recorder is not None and seen:
        # Only after the run is kept: there may be no room for this file.
        atomic.write_named(args.perfetto, flow_trace(recorder, seen[0].programs).encode())
    return 0 if is_ok else InfrastructureError.exit_status


def _print_what_follows(results: Path, *, has_traces: bool) -> None:
    import shlex

    from rtfiles.invocation import as_called
    from rtfiles.output import print_line

    folder, call = shlex.quote(str(results)), as_called("rtrun")
    why = f"; {call} why {folder}" if has_traces else ""
    print_line(f"next: {call} report {folder}; {call} verdict {folder}{why}")


def _list(args: argparse.Namespace, config: "TargetConfig", planned: "Run") -> int:
    from rtfiles.output import print_status
    from rtrun.commands._link import linked
    from rtrun.execution import observation
    from rtrun.execution.loop_list import list_loops
    from rtrun.execution.ros_graph import read_graph
    from rtrun.plan.observation import ObservationPlan
    from rtrun.targets import deploy
    from rtrun.targets.inspection import facts as inspection

    assert isinstance(planned.subject, ObservationPlan)
    print_status(f"asking {config.name} what runs there")
    with linked(config, args.target.parent) as link:
        # It makes the work folder if there is none.
        inspection.inspect(link)
        scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
        watched = observation.watch(link, scripts, planned.subject)
        graph = read_graph(link, scripts, watched.ros_programs)
        loops = list_loops(link, scripts, watched)
    print_status("")
    _print_list(watched, graph, loops)
    return 0


def _print_list(watched: "Watched", graph: "RosGraph", loops: "Sequence[str]") -> None:
    """Each program, its nodes, who publishes to whom, what can be measured, loops, and what threatens real time."""
    from rtfiles.output import counted, print_line
    from rtrun.execution import observation
    from rtrun.flows.hazards import hazards
    from rtrun.flows.programs import label_of
    from rtrun.probes.placement import refusals
    from rtrun.probes.programs import left_out_in_words

    events: dict[str, set[str]] = {}
    for probe in watched.placement.probes:
        events.setdefault(probe.path, set()).add(probe.event)
    if not watched.found:
        print_line(observation.NOTHING)
    for found in watched.found:
        program = found.program
        print_line(f"{label_of(program)} (pid {program.pid}), {counted(len(program.threads), 'thread')}")
    for node in graph.nodes:
        process = f" of pid {node.pid}" if node.pid is not None else ""
        print_line(f"node {node.name}{process}{': serves ' if node.serves else ''}{', '.join(node.serves)}")
    for topic, (publishers, subscribers) in sorted(graph.topics.items()):
        ends = (", ".join(nodes) or "nobody" for nodes in (publishers, subscribers))
        print_line(f"topic {topic}: {' to '.join(ends)}")
    for path, measured in events.items():
        print_line(f"{path}: {', '.join(sorted(measured))}")
    for text in loops:
        print_line(text)
    for text in hazards([found.program for found in watched.found]):
        print_line(text)
    left_out = [left_out_in_words(watched.left_out)] if watched.left_out else []
    for text in (*left_out, *refusals(watched.placement.refused), *graph.remarks):
        print_line(text)
