"""``rtrun quick``: a first answer without any file, with the tools that a target has, or of a loop that runs there."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._arguments import add_json
from rtrun.commands._question import time_argument

if TYPE_CHECKING:
    from rtrun.judgement.groups import Group
    from rtrun.judgement.study import Study
    from rtrun.report.contents import Contents
    from rtrun.targets.inspection.rt_readiness import CheckResult
    from rtrun.targets.link import Link

HELP = "a first answer in a minute, without a file: which P(miss) is proven, what was worst, and why"
EXAMPLES = (
    "rtrun quick --deadline 500us --target root@robot.local --for 10m",
    "rtrun quick --thread ros2_control_node --deadline 200us --target root@robot.local",
)
POLICY = "FIFO"
NO_REAL_TIME = "0"
# What a minute can prove, and what the thesis asks for.
ASKED = (1e-2, 1e-6)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--deadline", type=time_argument, metavar="TIME", help="with its unit, as 1ms [none: figures alone]"
    )
    parser.add_argument(
        "--target",
        default="",
        metavar="TARGET",
        help="what to measure on: [USER@]HOST[:PORT], or a target file [this machine]",
    )
    parser.add_argument(
        "--for",
        type=time_argument,
        default=60 * 10**9,
        dest="for_ns",
        metavar="TIME",
        help="how long to measure [1min]",
    )
    parser.add_argument(
        "--thread",
        metavar="PROGRAM[/THREAD]",
        help="measure the loop of a program that runs, unmodified: nothing else is started",
    )
    parser.add_argument("--suite", action="append", default=[], metavar="SUITE", help="measure it alone, or these")
    parser.add_argument(
        "--middleware", metavar="NAME", help="of the suites [roscpp, else rcl, else shared memory and sockets]"
    )
    parser.add_argument(
        "--policy", choices=["0", "RR", "FIFO"], help=f"scheduling policy, 0: none [{POLICY}, if you may]"
    )
    parser.add_argument("--suites", type=Path, metavar="FOLDER", help="of rtgen suites build [build/suites/host]")
    parser.add_argument("--results", type=Path, default=Path("results/quick"), metavar="FOLDER", help="[results/quick]")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print what was proven, and write the report. 0: measured, 3: out of reach, or something is missing."""
    import yaml

    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.output import beside_the_answer, print_json, print_line, print_status
    from rtrun.commands._boards import TargetFile, measure_made, print_failed
    from rtrun.commands._link import linked
    from rtrun.judgement.study import study
    from rtrun.plan.question import Question
    from rtrun.report import page
    from rtrun.report.contents import contents
    from rtrun.results import run_directory
    from rtrun.results.latest import set_latest
    from rtrun.targets.config import parse_target, read_target
    from rtrun.targets.inspection import rt_readiness

    if args.thread and (args.suite or args.middleware or args.policy or args.suites):
        raise UsageError(
            "--thread measures a program that runs: leave out --suite, --suites, --middleware and --policy"
        )
    data = _target(args)
    file = run_directory.unused_results(args.results) / "target.yml" if data else Path(args.target)
    config = parse_target(data, args.target or "quick") if data else read_target(file)
    print_status(f"asking {config.name} what it is")
    with linked(config, file.parent) as link:
        findings = rt_readiness.judge(rt_readiness.read_checks(), rt_readiness.read_facts(link))
        campaign = _observing(link, args) if args.thread else _campaign(link, args)
    print_status("")
    results = run_directory.make_new_results(args.results)
    set_latest(results)
    file = results / "target.yml" if data else file
    if data:
        atomic.write_text(file, yaml.safe_dump(data, sort_keys=False))
    with beside_the_answer(args.json):
        statuses = measure_made(campaign, TargetFile(config=config, folder=file.parent), results)
    print_status("writing the report")
    # A loop's deadline is of that stream alone, in the campaign.
    asked = Question(deadline_ns=None if args.thread else args.deadline, probability=ASKED[0])
    examined = study(results, asked)
    report, written = results / "report.html", contents(examined)
    atomic.write_named(report, page.html(examined, written).encode("utf-8", "replace"))
    print_status("")
    if args.json:
        print_json(_as_data(examined, written, findings, results, args) | {"runs": statuses})
    else:
        _print(examined, written, findings, results, file, args.thread)
    with beside_the_answer(args.json):
        status = print_failed(statuses)
        if config.kind == "local" and campaign.get("common") == {"policy": NO_REAL_TIME} and args.policy is None:
            print_line(f"to measure with real-time priorities, and trace late values: {_as_root()}")
        print_line(f"report: {report}")
    return status


def _target(args: argparse.Namespace) -> dict[str, Any] | None:
    """The target data that `--target` stands for; None where it names a file."""
    from rtfiles.errors import UsageError
    from rtrun.targets.config import data_of_login, names_file

    suites = args.suites or (Path("build/suites/host") if not args.target else None)
    if args.target and names_file(Path(args.target)):
        if args.suites:
            raise UsageError("--suites: a target file names them itself, as suites")
        return None
    here = {"schema": 1, "name": "this-machine", "kind": "local"}
    data = data_of_login(args.target) if args.target else here
    return data | ({"suites": str(suites.absolute())} if suites and suites.is_dir() else {})


def _campaign(link: "Link", args: argparse.Namespace) -> dict[str, Any]:
    """What to measure on the target. Raises TargetError where the target has nothing to measure with."""
    from rtfiles.errors import UsageError
    from rtfiles.invocation import as_called
    from rtfiles.output import print_note
    from rtrun.plan import quick
    from rtrun.targets.errors import TargetError
    from rtrun.targets.inspection import facts as inspection

    equipment = inspection.inspect(link)
    programs = dict(equipment.programs)
    if folder := link.target.suites:
        inspection.check_suites(folder, link.target, equipment)
        programs |= {path.name: str(path) for path in (folder / "lib").glob("*/*") if path.is_file()}
    lacks = inspection.missing(link, [quick.BASELINE, f"rt_priority={quick.PRIORITY}"])
    rights = [line for line in lacks if line != quick.BASELINE]
    # It ends at once if it may not become a real-time program, whatever policy is asked for.
    baselines = [] if lacks else [quick.BASELINE]
    middlewares = (args.middleware,) if args.middleware else quick.middlewares(programs)
    found = [*baselines, *quick.measurable(programs, middlewares[0])]
    if not found:
        make = f"the suites ({as_called('rtgen')} suites build, then --suites FOLDER)"
        remedy = f"make {make}" if rights else f"install rt-tests (cyclictest), or {make}"
        lacking = f", and {quick.BASELINE} needs {rights[0]}" if rights and quick.BASELINE not in lacks else ""
        raise TargetError(f"{link.target.address}: nothing to measure with: {remedy}{lacking}")
    if found == baselines:
        print_note(f"rtrun: measures {quick.BASELINE} alone: `{as_called('rtgen')} suites build` makes the suites")
    if unknown := [name for name in args.suite if name not in found]:
        raise UsageError(f"--suite {unknown[0]}: not there through {', '.join(middlewares)}, found: {', '.join(found)}")
    if rights and args.policy is None:
        left_out = "" if quick.BASELINE in lacks else f" and without {quick.BASELINE}"
        print_note(f"rtrun: measures without a real-time policy{left_out}: this user has not {rights[0]}")
    return quick.campaign(
        [name for name in found if not args.suite or name in args.suite],
        middlewares=middlewares,
        policy=args.policy or (NO_REAL_TIME if rights else POLICY),
        duration_s=args.for_ns / 1e9,
        traced_above_ns=args.deadline if _can_trace(link) else None,
    )


def _observing(link: "Link", args: argparse.Namespace) -> dict[str, Any]:
    """What to observe on the target."""
    from rtrun.plan import quick

    return quick.observing(args.thread, deadline_ns=args.deadline, for_ns=args.for_ns, is_traced=_can_trace(link))


def _as_root() -> str:
    """The call of this program once more, by sudo, which has a PATH of its own."""
    import shlex
    import shutil
    import sys

    from rtfiles.invocation import as_called

    call = as_called("rtrun")
    return shlex.join(["sudo", shutil.which(call) or call, *sys.argv[1:]])


def _can_trace(link: "Link") -> bool:
    """Whether this user may trace, and no other run does; a trace that was left behind is removed, as trace.sh does."""
    from rtfiles.output import print_note

    if link.run(["sh", "-c", "[ -w /sys/kernel/tracing/instances ]"]).status:
        return False
    is_free = '[ ! -d "$1" ] || { [ -n "$(find "$1" -maxdepth 0 -mmin +1)" ] && rmdir "$1"; } 2>/dev/null'
    if link.run(["sh", "-c", is_free, "sh", "/sys/kernel/tracing/instances/rtrun"]).status == 0:
        return True
    print_note("rtrun: measures without the kernel's trace of late values: another run uses it")
    return False


def _why_no_p(group: "Group") -> str | None:
    """Why no P is proven of a group; None: there is one."""
    verdict = group.verdict
    if verdict is None:
        return group.undecidable
    return verdict.refused or (f"{verdict.change.what}: {verdict.change.text}" if verdict.change else None)


def _as_data(
    study: "Study", written: "Contents", findings: "list[CheckResult]", results: Path, args: argparse.Namespace
) -> dict[str, Any]:
    """What `_print` prints, as docs/formats.md describes it."""
    from rtrun.judgement.digest import pool_figures
    from rtrun.targets.inspection import rt_readiness

    groups = [
        {
            "group": group.label,
            "n": verdict.n if (verdict := group.verdict) else group.n,
            "misses": verdict.misses if verdict else None,
            "p_below": None if verdict is None or _why_no_p(group) else verdict.upper,
            "no_p": _why_no_p(group),
            "worst_ns": verdict.worst_ns if verdict else pool_figures(group.digests).max_ns,
        }
        for group in study.groups
        if _is_asked_for(group, args.thread)
    ]
    return {
        "schema": 1,
        "platform": study.platform,
        "results": str(results),
        "deadline_ns": args.deadline,
        "confidence": study.question.confidence,
        "groups": groups,
        "left_out": study.left_out,
        "why_late": written.why_late,
        "in_the_way": [fault.check.name for fault in rt_readiness.grave_faults(findings)],
    }


def _is_asked_for(group: "Group", loop: str | None) -> bool:
    """Whether figures of a group are shown: of all, or of the named loop."""
    from rtrun.kinds.known import STREAMS

    kinds = [kind for kind in STREAMS.values() if kind.suite == group.suite and kind.named_by == "program"]
    return loop is None or any(kind.is_named(loop, group.parameters) for kind in kinds)


def _print(
    study: "Study",
    written: "Contents",
    findings: "list[CheckResult]",
    results: Path,
    target: Path,
    loop: str | None,
) -> None:
    """What was late and how often, how often it may be late, what prevents real time, and how to go on."""
    import shlex

    from rtfiles.invocation import as_called
    from rtfiles.output import console, print_line
    from rtfiles.quantities import one_in
    from rtrun.judgement.verdicts import answer_to
    from rtrun.report import sentences
    from rtrun.report.screen import print_figures
    from rtrun.report.terminal import print_banner
    from rtrun.targets.inspection import rt_readiness

    call = as_called("rtrun")
    print_banner(study.platform, study.preempt_rt)
    answered = [scenario for scenario in written.scenarios if scenario.group.question]
    without_deadline = [group for group in study.groups if group.question is None and _is_asked_for(group, loop)]
    if answered or not without_deadline:
        print_line(sentences.headline(study, answered))
        console().print(sentences.lines(study, answered))
    print_figures(without_deadline)
    if without_deadline and not answered:
        print_line("without a deadline there are figures and no answer: ask with --deadline TIME, as --deadline 1ms")
    for text in study.left_out:
        print_line(f"not analysed: {text}")
    for probability in ASKED if answered else ():
        answers = [answer_to(scenario.group, probability) for scenario in answered]
        print_line(sentences.answers_in_words(answers, one_in(probability)))
    if written.why_late:
        print_line(f"why it was late: {written.why_late}")
    grave = [fault.check.name for fault in rt_readiness.grave_faults(findings)]
    folder, file = shlex.quote(str(results)), shlex.quote(str(target))
    explain = f"; {call} check-rt --target {file} says why, and the remedy"
    print_line(f"in the way of real time: {', '.join(grave) + explain if grave else 'nothing grave'}")
    print_line(f"to measure again: {call} run {folder}/campaign.yml --target {file} --fresh")
