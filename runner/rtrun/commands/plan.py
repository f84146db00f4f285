"""``rtrun plan``: every run of a campaign and how long it takes, without a target."""

import argparse
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rtfiles.quantities import duration, percent_at_most
from rtrun.commands._arguments import add_campaign, add_json, shipped_campaigns
from rtrun.commands._question import probability_argument

if TYPE_CHECKING:
    from rtrun.plan.campaign import Campaign
    from rtrun.plan.goal import Goal
    from rtrun.plan.observation import StreamDeadline
    from rtrun.plan.rounds import Outlook
    from rtrun.plan.run import Run

# Burst lengths whose cost is shown.
BURSTS = (1, 5, 20)
# Periods of a changing load, in seconds, for which longer runs are proposed.
LOADS_S = (60, 600)
HELP = "print every run of a campaign and how long it takes, without a target"
EXAMPLES = (
    "rtrun plan brakes.yml",
    "rtrun plan demo --json",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Forecast:
    """The cost of a goal at a rate of misses; without answer and outlook, no number of measurements decides it."""

    assumed_rate: float
    answer: str | None = None
    outlook: "Outlook | None" = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_campaign(parser, otherwise="list those")
    parser.add_argument(
        "--assume-rate",
        type=probability_argument,
        metavar="P",
        help="with a goal (until): how long it takes if so many measurements miss the deadline",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the plan, or without a campaign those that are shipped. Raises UsageError for a rate without a goal."""
    from rtfiles.errors import UsageError
    from rtfiles.output import counted, print_json, print_line
    from rtrun.plan.campaign import read_campaign, topology_path
    from rtrun.plan.run import blocks
    from rtrun.plan.selection import select
    from rtrun.plan.topology.planning import TopologyPlan
    from rtrun.plan.topology.reading import read_topology
    from rtrun.report.topology_text import topology_lines

    if args.campaign is None:
        if args.expression is not None or args.assume_rate is not None:
            raise UsageError("-k, --assume-rate: of which campaign? Name it; rtrun plan alone lists those there are")
        return _list_shipped(as_json=args.json)
    campaign, runs = read_campaign(args.campaign)
    runs = select(runs, args.expression)
    if args.assume_rate is not None and campaign.until is None:
        raise UsageError(f"{args.campaign}: --assume-rate: the campaign has no goal (until), so its length is known")
    if args.assume_rate is not None and campaign.has_streams:
        raise UsageError(f"{args.campaign}: --assume-rate: how much there is to observe is known when it was observed")
    is_foreseen = campaign.until is not None and not campaign.has_streams
    forecasts = tuple(_forecasts(campaign.until, runs, args.assume_rate)) if campaign.until and is_foreseen else ()
    if args.json:
        print_json(_as_data(campaign, runs, forecasts))
        return 0
    if isinstance(planned := runs[0].subject, TopologyPlan):
        given = topology_path(campaign, args.campaign)
        for line in topology_lines(planned, read_topology(given).remarks if given else ()):
            print_line(line)
        print_line()
    divided = blocks(runs)
    for number, block in enumerate(divided):
        if block[0].kernel:
            print_line(f"-- {'restart into ' if number else ''}kernel {block[0].kernel}")
        for run in block:
            settling = f" + {run.settle_s:g} s for the load to settle" if run.settle_s else ""
            print_line(f"{run.name}  {run.expected_s:.1f} s{settling}")
    restarts = len(divided) - 1
    times = _times(runs, restarts)
    settling = f", {duration(times['settling_s'])} for loads to settle" if times["settling_s"] else ""
    restarting = (
        f", about {duration(times['restarting_s'])} for {counted(restarts, 'restart')} into a kernel"
        if restarts
        else ""
    )
    print_line(
        f"{len(runs)} runs, {duration(times['total_s'])}: {duration(times['measuring_s'])} of measuring{settling}, "
        f"about {duration(times['start_and_end_s'])} for set-up and for programs to start and end{restarting}"
    )
    if campaign.until and not is_foreseen:
        deadlines = planned.deadlines if isinstance(planned, TopologyPlan) else campaign.deadlines
        print_line(_observed_goal_line(campaign.until, deadlines))
    elif campaign.until:
        for line in _goal_lines(campaign.until, runs, forecasts, _prices_of_bursts(campaign.until, runs)):
            print_line(line)
        for line in _load_lines(_slowest_load_s(campaign.until, runs, forecasts)):
            print_line(line)
    return 0


def _list_shipped(*, as_json: bool) -> int:
    """Print the shipped campaigns, and what each is for: the comment that its file begins with."""
    import textwrap

    from rtfiles.invocation import as_called
    from rtfiles.output import console, print_json, print_line

    purposes = {}
    for path in shipped_campaigns():
        lines = path.read_text(encoding="utf-8").splitlines()
        comment = itertools.takewhile(lambda line: line.startswith("#"), lines)
        purposes[path.stem] = " ".join(line.removeprefix("#").strip() for line in comment)
    if as_json:
        campaigns = [{"campaign": name, "purpose": purpose} for name, purpose in purposes.items()]
        print_json({"schema": 1, "campaigns": campaigns})
        return 0
    indent = max(map(len, purposes)) + 2
    for name, purpose in purposes.items():
        first, *rest = textwrap.wrap(purpose, max(40, console().width - indent))
        print_line(f"{name:<{indent}}{first}")
        for line in rest:
            print_line(" " * indent + line)
    call = as_called("rtrun")
    print_line(f"next: {call} plan NAME lists the runs of one; {call} run NAME --target TARGET.yml measures it")
    return 0


def _times(runs: "Sequence[Run]", restarts: int) -> dict[str, float]:
    """How long all runs take with `restarts` restarts of the target between them, and for what."""
    from rtrun.plan.run import RESTART_S, SET_UP_S

    return {
        "total_s": SET_UP_S + sum(run.total_s for run in runs) + restarts * RESTART_S,
        "measuring_s": sum(run.expected_s for run in runs),
        "settling_s": sum(run.settle_s for run in runs),
        "start_and_end_s": SET_UP_S + sum(run.start_and_end_s for run in runs),
        "restarting_s": restarts * RESTART_S,
    }


def _forecasts(goal: "Goal", groups: "Sequence[Run]", rate: float | None) -> Iterator[_Forecast]:
    """How long the goal takes in the best case, and at `rate`, if given, of misses."""
    from rtrun.analysis.chance.further import plan_groups
    from rtrun.analysis.deadline import Answer
    from rtrun.plan.rounds import outlook

    boot_rounds = _rounds_of_boot(goal, groups)
    for assumed in (0.0,) if rate is None else (0.0, rate):
        planned = plan_groups(goal.question, _periods_ns(groups), rate=assumed)
        if planned is None or boot_rounds is None:
            yield _Forecast(assumed_rate=assumed)
            continue
        is_proven, measurements = planned
        answer = Answer.PROVEN if is_proven else Answer.REFUTED
        expected = outlook(groups, measurements, boots=goal.boots, boot_rounds=boot_rounds)
        yield _Forecast(assumed_rate=assumed, answer=answer, outlook=expected)


def _periods_ns(groups: "Sequence[Run]") -> "dict[str, float | None]":
    return {group.name: group.period_ns for group in groups}


def _lengths_of_bursts(goal: "Goal", groups: "Sequence[Run]") -> list[int]:
    """The burst lengths that the groups' proofs have to cover, ascending, each once."""
    from rtrun.plan.question import bursts_asked

    return sorted({bursts_asked(goal.question, group.period_ns).length for group in groups})


def _rounds_of_boot(goal: "Goal", groups: "Sequence[Run]") -> int | None:
    """How many rounds each boot has if no measurement misses; None where no number of measurements is a proof."""
    from rtrun.analysis.chance.further import plan_groups
    from rtrun.plan.rounds import rounds_of_boot

    best = plan_groups(goal.question, _periods_ns(groups))
    return None if best is None else rounds_of_boot(groups, best[1], goal.boots)


def _prices_of_bursts(goal: "Goal", groups: "Sequence[Run]") -> "dict[int, Outlook]":
    """How long the goal takes without a miss if a proof has to cover other bursts, by burst length."""
    asked = _lengths_of_bursts(goal, groups)
    lengths = [length for length in BURSTS if [length] != asked]
    forecasts = {
        length: next(_forecasts(goal.model_copy(update={"bursts": length}), groups, None)) for length in lengths
    }
    return {length: forecast.outlook for length, forecast in forecasts.items() if forecast.outlook is not None}


def _slowest_load_s(goal: "Goal", groups: "Sequence[Run]", forecasts: Sequence[_Forecast]) -> float | None:
    """The slowest change of load, in seconds, that the runs of the best case can judge; None if there is none."""
    from rtrun.analysis.order.constancy import slowest_load
    from rtrun.plan.rounds import joined_s

    boot_rounds = _rounds_of_boot(goal, groups)
    if boot_rounds is None or forecasts[0].outlook is None:
        return None
    return slowest_load(joined_s(groups, forecasts[0].outlook.rounds, boots=goal.boots, boot_rounds=boot_rounds))


def _load_lines(slowest_s: float | None) -> Iterator[str]:
    if slowest_s is None:
        return
    yield (
        f"a load that comes every {slowest_s:.2g} s or more often comes back five times within the runs of a boot: it "
        "can be judged, a slower one counts as a change"
    )
    times = {load_s: load_s / slowest_s for load_s in LOADS_S if load_s > slowest_s}
    longer = [f"every {load_s} s: {factor:.{int(factor < 10)}f} times" for load_s, factor in times.items()]
    if longer:
        yield f"for a slower one make the runs longer (repetitions), {', '.join(longer)}"


def _goal_lines(
    goal: "Goal", runs: "Sequence[Run]", forecasts: Sequence[_Forecast], prices: "Mapping[int, Outlook]"
) -> Iterator[str]:
    from dataclasses import replace

    from rtfiles.output import counted
    from rtrun.plan.question import unlike_share
    from rtrun.plan.suites import suite

    measures = {suite(run.suite).judged(goal.of) for run in runs}
    asked = replace(goal.question, of=measures.pop() if len(measures) == 1 else None)
    at_most_s = goal.at_most_ns / 1e9
    yield (
        f"until P({asked.miss}) is proven or refuted to be below {goal.probability:g}, "
        f"confidence {goal.confidence:g}, in at most {duration(at_most_s)}: each round repeats these runs"
    )
    share = percent_at_most(unlike_share(goal.boots, goal.confidence))
    yield (
        f"on {counted(goal.boots, 'boot')}: boots of another kind may be up to {share} of all; "
        f"a proof covers {goal.question.covered}{_default_in_words(goal, runs)}"
    )
    for forecast in forecasts:
        name = f"if {forecast.assumed_rate} of all measurements miss it" if forecast.assumed_rate else "without a miss"
        if forecast.outlook is None:
            yield f"{name}: no number of measurements is likely to decide it"
            continue
        restarts = f" and {counted(forecast.outlook.boots - 1, 'restart')}" if goal.boots > 1 else ""
        longer = ", longer than at_most" if forecast.outlook.total_s > at_most_s else ""
        chance = " nine times in ten" if forecast.assumed_rate else ""
        yield (
            f"{name}: {forecast.answer} after {counted(forecast.outlook.rounds, 'round')}{restarts}{chance}, about "
            f"{duration(forecast.outlook.total_s)}, of which {duration(forecast.outlook.measuring_s)} "
            f"are measuring{longer}"
        )
    for length, outlook in prices.items():
        covered = f"bursts of {length}" if length > 1 else "single misses"
        yield f"to cover {covered} (bursts: {length}): {duration(outlook.total_s)} without a miss"


def _default_in_words(goal: "Goal", groups: "Sequence[Run]") -> str:
    """What a stall means where bursts are not set."""
    if goal.bursts is not None:
        return ""
    least, most = (choose(_lengths_of_bursts(goal, groups)) for choose in (min, max))
    length = f"{least}" if least == most else f"{least} to {most}"
    return f" ({length} misses in a row, the default)" if most > 1 else " (a single miss, the default)"


def _observed_goal_line(goal: "Goal", deadlines: "Sequence[StreamDeadline]") -> str:
    return (
        f"until P(miss) is proven or refuted to be below {goal.probability:g} for each of "
        f"{', '.join(deadline.text for deadline in deadlines)}, confidence {goal.confidence:g}, in at most "
        f"{duration(goal.at_most_ns / 1e9)}: each round observes again, how many it takes is not known beforehand"
    )


def _as_data(campaign: "Campaign", runs: "Sequence[Run]", forecasts: Sequence[_Forecast]) -> dict[str, Any]:
    """The plan as docs/formats.md describes it."""
    from dataclasses import asdict

    from rtrun.plan.run import blocks

    goal, restarts = campaign.until, len(blocks(runs)) - 1
    slowest_s = _slowest_load_s(goal, runs, forecasts) if goal and forecasts else None
    return {
        "schema": 1,
        "campaign": campaign.name,
        "order": campaign.order,
        "seed": campaign.seed,
        **_times(runs, restarts),
        "restarts": restarts,
        "runs": [
            {
                "run": run.name,
                "suite": run.suite,
                "parameters": dict(run.parameters),
                "condition": run.condition,
                "settings": dict(run.settings),
                "repeat": run.repeat,
                "variant": run.variant,
                "kernel": run.kernel,
                "trace": run.trace,
                **({run.subject.word: asdict(run.subject)} if run.subject.makes_streams else {}),
                "expected_s": run.expected_s,
                "settle_s": run.settle_s,
            }
            for run in runs
        ],
        "goal": goal
        and {
            **goal.model_dump(),
            "forecasts": [asdict(forecast) for forecast in forecasts],
            "slowest_load_s": slowest_s,
        },
    }
