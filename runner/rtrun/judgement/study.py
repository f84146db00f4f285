"""A folder of runs, examined: groups of similar runs with their verdicts, and all that the formats write."""

import functools
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtfiles.output import showing_progress
from rtfiles.quantities import one_in
from rtrun.analysis.account import Account
from rtrun.analysis.deadline import Verdict, judge
from rtrun.analysis.histogram import Histogram
from rtrun.analysis.order.startup import StartUp, find_startup, left_out
from rtrun.analysis.tails.extreme_values import Bound
from rtrun.analysis.tails.worst_case import worst_case
from rtrun.analysis.trials import Trials
from rtrun.evidence.accounts import clock_step_ns, take_account
from rtrun.evidence.attempts import LostAttempt, lost_attempts
from rtrun.evidence.duplicates import copies_among, overlaps_among
from rtrun.judgement.digest import Digest, JudgedDigest, digest
from rtrun.judgement.groups import Group, key_of, scenario, short_names, slowest
from rtrun.kinds.known import MAIN_2014
from rtrun.kinds.lateness import judged
from rtrun.plan.question import NO_DEADLINE, NONE_TOLERATED, Question
from rtrun.plan.suites import ALLOCATIONS, measures, telling_parameters
from rtrun.results import reading
from rtrun.results.reading import Source
from rtrun.results.record import RunRecord, RunStatus, read_record
from rtrun.results.series import Header, read_file
from rtrun.targets.inspection.platform import Platform

# The digests of a run directory, by the number of loops that are left out of their trials as start-up.
Known = dict[tuple[Path, int], tuple[Digest, ...]]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Everything a report says, before it is written down.

    `groups` are judged, and so are `pooled`, which join the groups of boards that are alike. `groups_2014` hold the
    series of 2014 of runs that are judged by another series: measured_2014 beside measured, jitter beside lateness.
    """

    source: Source
    question: Question
    groups: tuple[Group, ...]
    groups_2014: tuple[Group, ...]
    others: tuple[Digest, ...]
    records: tuple[RunRecord, ...]
    left_out: tuple[str, ...]
    pooled: tuple[Group, ...] = ()

    @property
    def answers(self) -> tuple[Group, ...]:
        """The groups that get an answer: pooled ones first, each followed by its boards, then those of one board."""
        alone = [group for group in self.groups if group.key not in self.members]
        return (*(shown for group in self.pooled for shown in (group, *group.members)), *alone)

    @functools.cached_property
    def members(self) -> frozenset[str]:
        """The keys of the groups of single boards that are pooled."""
        return frozenset(member.key for group in self.pooled for member in group.members)

    def name(self, group: Group) -> str:
        """The label of a group, with its board if the study has several."""
        return group.label + self._on(group)

    def short_name(self, group: Group) -> str:
        """The name that distinguishes a group from others of the study, with its board if the study has several."""
        return self._short_names[group.key] + self._on(group)

    @functools.cached_property
    def _short_names(self) -> dict[str, str]:
        return short_names(self.answers)

    @functools.cached_property
    def _has_several_boards(self) -> bool:
        return len({record.target.name for record in self.records}) > 1

    def _on(self, group: Group) -> str:
        if not self._has_several_boards or not group.boards:
            return ""
        return f", {f'{len(group.boards)} boards' if group.members else group.boards[0]}"

    @property
    def platform(self) -> Platform:
        """What the runs were made on."""
        return next((output.header.platform for output in (*self.digests, *self.others)), Platform.HARDWARE)

    @property
    def preempt_rt(self) -> list[bool]:
        """For each run, whether its kernel was PREEMPT_RT."""
        return [record.preempt_rt for record in self.records]

    @property
    def asked(self) -> Question:
        """The question; it names the series that its groups are judged by, where that is the same for all."""
        named = {group.measure for group in self.groups}
        return replace(self.question, of=named.pop() if len(named) == 1 else None)

    @property
    def deadlines_ns(self) -> tuple[int, ...]:
        """The deadlines of its groups, ascending; if none has one, that of the question, if any."""
        of_groups = {group.question.limit_ns for group in self.groups if group.question}
        return tuple(sorted(of_groups or filter(None, [self.question.deadline_ns])))

    @property
    def miss(self) -> str:
        """What counts as a miss, in words."""
        if len(self.deadlines_ns) != 1:
            return f"{self.asked.of or 'value'} > its deadline"
        return replace(self.asked, deadline_ns=self.deadlines_ns[0]).miss

    @property
    def asked_in_words(self) -> str:
        """What is asked: how many may be late, and how sure the answer has to be."""
        asked = self.question
        late = "late" if asked.tolerance == NONE_TOLERATED else f"windows with more than {asked.tolerance} late"
        return f"at most {one_in(asked.probability)} {late}, {100 * asked.confidence:g} % sure"

    @property
    def asked_in_full(self) -> str:
        """What is asked, in words and as the probability of a miss."""
        return f"{self.asked_in_words} (P({self.miss}) < {self.question.probability:g})"

    @property
    def as_in_2014(self) -> tuple[Group, ...]:
        """The groups that compare with the publications of 2014: measured_2014 of one-shot, jitter of cyclic timers."""
        return tuple(group for group in (*self.groups, *self.groups_2014) if group.series in MAIN_2014)

    @property
    def digests(self) -> tuple[JudgedDigest, ...]:
        """Main series of all runs."""
        return tuple(output for group in self.groups for output in group.digests)


def study(
    path: Path,
    question: Question = NO_DEADLINE,
    *,
    bounds: bool = True,
    known: Known | None = None,
) -> Study:
    """Examine what is at a path: a folder of runs, one run, a log or an npy.

    `known` holds the runs of earlier calls for the same question, which are not read again, and gets the new ones. It
    lacks what only bounds and comparisons need. Raises UsageError when there is nothing to examine, or runs of several
    platforms; ``left_out`` names runs that are refused.
    """
    source = reading.find_source(path)
    of_file = question if question.deadline_ns else None
    records, refused = _read_records(source.folders)
    copies = reading.find_copies(records)
    records = {folder: record for folder, record in records.items() if folder not in copies}
    _check_of(path, records.values(), question)
    read = {folder: _read_run(folder, record, question, known) for folder, record in records.items()}
    runs = [*read.values()]
    digests = [output for run in runs for output in run.digests]
    if not source.folders:
        digests = [digest(series, of_file) for series in read_file(path, question.of)]
    _check_platform(path, digests)
    folders = {record.run: folder for folder, record in records.items()}

    @functools.lru_cache(maxsize=1)
    def read_again(run: str, startup_loops: int) -> tuple[Digest, ...]:
        if not source.folders:
            return tuple(digest(series, of_file, startup_loops) for series in read_file(path, question.of))
        return _read_run(folders[run], records[folders[run]], question, known, startup_loops).digests

    basis = _Basis(
        question=question,
        records={record.run: record for record in records.values()},
        lost=lost_attempts(
            source, records, refused | {folder: run.unreadable for folder, run in read.items() if run.unreadable}
        ),
        read_again=read_again,
    )
    same = _same_measurements([output for output in digests if isinstance(output, JudgedDigest)])
    judged_digests = [output for output in digests if isinstance(output, JudgedDigest) and output.run not in same]
    groups = _grouped([output for output in judged_digests if output.header.main], basis, bounds=bounds)
    return Study(
        source=source,
        question=question,
        groups=groups,
        pooled=tuple(_pooled(groups, basis)),
        groups_2014=_grouped([output for output in judged_digests if not output.header.main], basis, bounds=False),
        others=tuple(output for output in digests if not output.header.main and output.run not in same),
        records=tuple(records.values()),
        left_out=(
            *(f"{name}: incomplete, it has no run.json: nothing in it is analysed" for name in source.incomplete),
            *refused.values(),
            *copies.values(),
            *same.values(),
            *(text for run in runs for text in run.left_out),
        ),
    )


def _same_measurements(digests: Sequence[JudgedDigest]) -> dict[str, str]:
    """Runs of one kind that hold the measurements of another one, by name, each with a line that names both."""
    counts: dict[str, list[tuple[str, Histogram]]] = {}
    places: dict[str, list[tuple[str, Trials]]] = {}
    for output in digests:
        if output.trials is None:
            continue
        key = key_of(output.header.target, output)
        if output.trials.misses is None:
            counts.setdefault(key, []).append((output.run, output.histogram))
        elif output.header.main:
            places.setdefault(key, []).append((output.run, output.trials))
    same = {
        run: f"{run}: a copy? it and {other} hold the same counts, and neither counts"
        for members in counts.values()
        for run, other in copies_among(members).items()
    }
    for members in places.values():
        for run, other in overlaps_among(members).items():
            same[run] = (
                f"{run}: a copy? a part of it and of {other} is the same, and neither counts: remove one of them, or "
                "what the other holds already"
            )
    return same


@dataclass(frozen=True, kw_only=True)
class _Basis:
    """What the judgement of every group needs: the question, the records by run, and lost attempts.

    `read_again` gives the digests of a run with so many first loops left out of their trials.
    """

    question: Question
    records: Mapping[str, RunRecord]
    lost: tuple[LostAttempt, ...]
    read_again: Callable[[str, int], tuple[Digest, ...]]


@dataclass(frozen=True, kw_only=True)
class _DigestedRun:
    """The complete series of a run, and a line for each part left out; if it is `unreadable`, that is the whole run."""

    digests: tuple[Digest, ...] = ()
    left_out: tuple[str, ...] = ()
    unreadable: str = ""


def _read_records(folders: Sequence[Path]) -> tuple[dict[Path, RunRecord], dict[Path, str]]:
    """The records of run directories, and why others are refused.

    If runs of one name from several folders were put together here, they take the names of their folders.
    """
    records, refused = {}, {}
    for folder in showing_progress(folders, "reading run"):
        try:
            records[folder] = read_record(folder)
        except UsageError as error:
            refused[folder] = str(error)
    times = Counter(record.run for record in records.values())
    return {
        folder: record.model_copy(update={"run": folder.name}) if times[record.run] > 1 else record
        for folder, record in records.items()
    }, refused


def _read_run(
    folder: Path, record: RunRecord, question: Question, known: Known | None, startup_loops: int = 0
) -> _DigestedRun:
    if known is not None and (folder, startup_loops) in known:
        return _DigestedRun(digests=known[folder, startup_loops])
    if record.status is not RunStatus.OK:
        return _DigestedRun(left_out=(f"{record.run}: {record.status}: {record.reason or 'no reason given'}",))
    if record.parameters.get(ALLOCATIONS):
        return _DigestedRun()  # counting is in its times
    digests, incomplete = [], {}
    try:
        asked = record.asked(question)
        for series in reading.read_series(folder, record, question.of):
            if series.header.incomplete:
                incomplete[series.header.output] = series.header.incomplete
            else:
                digests.append(digest(series, asked, startup_loops))
    except UsageError as error:
        return _DigestedRun(left_out=(str(error),), unreadable=str(error))
    if known is not None:
        known[folder, startup_loops] = tuple(
            replace(output, tail=None, blocks=None, course=None) if isinstance(output, JudgedDigest) else output
            for output in digests
        )
    left_out = (f"{record.run}: {output} is incomplete: {reason}" for output, reason in incomplete.items())
    return _DigestedRun(digests=tuple(digests), left_out=tuple(left_out))


def _check_platform(path: Path, digests: Sequence[Digest]) -> None:
    if len(platforms := sorted({output.header.platform for output in digests})) > 1:
        raise UsageError(
            f"{path}: holds runs of several platforms ({', '.join(platforms)}), which say different things about time: "
            "move the runs of each platform into a folder of their own"
        )


def _check_of(path: Path, records: Iterable[RunRecord], question: Question) -> None:
    """Refuse a question about a series that no run measures; if only some runs lack it, they are left out when read."""
    wrong: dict[str, str] = {}
    suites = {record.suite for record in records}
    for suite in sorted(suites):
        try:
            judged(measures(suite), question.of)
        except UsageError as error:
            wrong[suite] = f"{suite} {error}"
    if wrong and len(wrong) == len(suites):
        raise UsageError(f"{path}: {'; '.join(wrong.values())}")


def _grouped(digests: Sequence[JudgedDigest], basis: _Basis, *, bounds: bool) -> tuple[Group, ...]:
    by_key: dict[str, list[JudgedDigest]] = {}
    for output in digests:
        by_key.setdefault(key_of(output.header.target, output), []).append(output)
    alike = showing_progress([*by_key.values()], "judging group")
    groups = [_group(members, basis, bounds=bounds) for members in alike]
    return tuple(sorted(groups, key=lambda group: (group.suite, group.target)))


def _pooled(groups: Sequence[Group], basis: _Basis) -> Iterator[Group]:
    """Yield one group for the groups of several boards in the same environment; boards are its clusters.

    The environment of imported files is not known.
    """
    alike: dict[str, list[Group]] = {}
    for group in groups:
        if group.boards and all(record.programs for record in group.records):
            alike.setdefault(json.dumps([scenario(group.digests[0]), group.environment]), []).append(group)
    for members in alike.values():
        if len({board for group in members for board in group.boards}) > 1:
            digests = [output for group in members for output in group.digests]
            pooled = _group(digests, basis, bounds=False)
            yield replace(pooled, target=", ".join(group.target for group in members), members=tuple(members))


def _group(alike: Sequence[JudgedDigest], basis: _Basis, *, bounds: bool) -> Group:
    alike, startup = _without_startup(alike, basis)
    first, records = alike[0].header, basis.records
    account = _account(alike, basis, startup)
    undecidable = next((output.undecidable for output in alike if output.undecidable), None)
    asked = alike[0].question
    worst_cases, no_bound = _bounds(alike, asked) if bounds and asked else ((), None)
    return Group(
        suite=first.suite,
        series=first.series,
        measure=first.measure,
        target=first.target,
        parameters=telling_parameters(first.parameters),
        question=asked,
        digests=tuple(alike),
        account=account,
        verdict=_verdict(account, first, asked) if account and asked and undecidable is None else None,
        undecidable=undecidable,
        bounds=worst_cases,
        no_bound=no_bound,
        records=tuple(records[run] for run in dict.fromkeys(output.run for output in alike) if run in records),
    )


def _without_startup(alike: Sequence[JudgedDigest], basis: _Basis) -> tuple[Sequence[JudgedDigest], StartUp | None]:
    """The digests without the common start-up of their runs in the trials, and that start-up."""
    by_run: dict[str, list[JudgedDigest]] = {}
    for output in alike:
        by_run.setdefault(output.run, []).append(output)
    heads = [[output.head for output in of_run if output.head is not None] for of_run in by_run.values()]
    startup = find_startup(heads) if sum(map(len, heads)) == len(alike) else None
    loops = startup.loops if startup else 0
    return [known if _startup_loops(known) == loops else _read_again(known, loops, basis) for known in alike], startup


def _startup_loops(output: JudgedDigest) -> int:
    return output.startup.n if output.startup else 0


def _read_again(known: JudgedDigest, startup_loops: int, basis: _Basis) -> JudgedDigest:
    """The same series without so many first loops in its trials. Raises UsageError when it is gone."""
    series = known.header.output, known.header.series
    for again in basis.read_again(known.run, startup_loops):
        if isinstance(again, JudgedDigest) and (again.header.output, again.header.series) == series:
            return again
    raise UsageError(f"{known.run}: {known.header.output} was changed while it was read: try again")


def _account(alike: Sequence[JudgedDigest], basis: _Basis, startup: StartUp | None) -> Account | None:
    outputs = [(output.header, output.trials) for output in alike if output.trials is not None]
    if not outputs:
        return None
    firsts = [output.startup for output in alike if output.startup is not None]
    account = take_account(outputs, basis.records, basis.lost)
    return replace(account, startup=left_out(startup, firsts)) if startup else account


def _verdict(account: Account, first: Header, question: Question) -> Verdict:
    tolerance = question.tolerance if first.main else NONE_TOLERATED
    return judge(account, replace(question, of=first.measure, tolerance=tolerance))


def _bounds(alike: Sequence[JudgedDigest], question: Question) -> tuple[tuple[Bound, ...], str | None]:
    if alike[0].header.platform is Platform.EMULATED:
        return (), "measured on an emulated board"
    tails = [output.tail for output in slowest(alike)]
    if any(tail is None for tail in tails):
        return (), "a log without samples keeps no order: neither dependence nor stationarity can be tested"
    return worst_case(
        [tail for tail in tails if tail is not None],
        probability=question.probability,
        confidence=question.confidence,
        quantum_ns=clock_step_ns([output.header for output in alike]) or 1,
    ), None


def environment(records: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """What the runs were made on, each fact once: (what, value or values)."""
    facts: dict[str, dict[str, None]] = {}
    for record in records:
        for key, value in _flat(record.target.model_dump(exclude_unset=True)):
            facts.setdefault(key, {})[value] = None
    return [(key, "; ".join(values)) for key, values in facts.items() if len(values) <= 3]


def _flat(data: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, str | int | float) and len(str(value)) <= 300:
            yield f"{prefix}{key}", in_word(value)


def in_word(value: str | float) -> str:
    """A fact as text; a truth value as yes or no."""
    return ("no", "yes")[value] if isinstance(value, bool) else str(value)
