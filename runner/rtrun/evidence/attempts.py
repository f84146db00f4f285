"""Attempts that gave no values to judge: they failed, were invalid, were measured again, or are gone.

Leaving them out would keep only the lucky runs: one that hung may have been late to its end. So each attempt counts,
unless its record (`UnrelatedEnd`) or the journal (`GivenUp`) says that its end had nothing to do with lateness.
Attempts that began to measure and left no record are known from the journal.
"""

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.output import counted
from rtrun.plan.suites import Value, telling_parameters
from rtrun.plan.trace import WARM_UP
from rtrun.results.journal import RunAttempts, attempts, is_at_work
from rtrun.results.reading import Source, target_of
from rtrun.results.record import RunRecord, RunStatus, is_closed, read_record
from rtrun.results.run_directory import numbers_begun

_ASIDE = re.compile(r"\.(?:old|incomplete)-[0-9]+$", re.ASCII)
_CUT_OFF = re.compile(r"\.incomplete-[0-9]+$", re.ASCII)
_NUMBERED = re.compile(r"([0-9]{1,6})-.*", re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class LostAttempt:
    """An attempt that gave nothing to judge, and `why`.

    `kinds` are the kinds that it would have measured (`kind_of`); empty if not known: it may have been any.
    """

    run: str
    why: str
    kinds: frozenset[str] = frozenset()

    def may_be_of(self, kinds: Collection[str]) -> bool:
        """Whether it may have measured one of these kinds."""
        return not self.kinds or not self.kinds.isdisjoint(kinds)

    def __str__(self) -> str:
        return f"{self.run}: {self.why}"


def kind_of(target: str, suite: str, parameters: Mapping[str, Value]) -> str:
    """What a run measures, and on which target: runs of one kind differ only in their results."""
    return json.dumps([target, suite, sorted(telling_parameters(parameters).items())])


def lost_attempts(
    source: Source, records: Mapping[Path, RunRecord], unreadable: Mapping[Path, str]
) -> tuple[LostAttempt, ...]:
    """The attempts in a folder that are not judged, except those whose end had nothing to do with lateness.

    `records` are those of the closed runs; `unreadable` says why other records, or values, cannot be read.
    """
    lost = [_lost(folder.name, record, unreadable.get(folder), records) for folder, record in records.items()]
    lost += [LostAttempt(run=folder.name, why=why) for folder, why in unreadable.items() if folder not in records]
    lost += [_measured_again(folder, records) for folder in source.old]
    # These may have hung before that.
    lost += [
        LostAttempt(run=name, why="cut off by a restart of the target", kinds=_kinds_of_run(name, records))
        for name in (*source.repeated, *filter(_CUT_OFF.search, source.incomplete))
        if not _is_warm_up(name)
    ]
    return (*filter(None, lost), *_without_record(source.path, records))


def _lost(run: str, record: RunRecord, unreadable: str | None, records: Mapping[Path, RunRecord]) -> LostAttempt | None:
    if unreadable is None and (record.status is RunStatus.OK or record.unrelated_end is not None):
        return None
    why = unreadable or f"{record.status}: {record.reason or 'no reason given'}"
    return LostAttempt(run=run, why=why, kinds=_kinds(record, records))


def _measured_again(folder: Path, records: Mapping[Path, RunRecord]) -> LostAttempt | None:
    try:
        record = read_record(folder)
    except UsageError as error:
        return LostAttempt(run=folder.name, why=f"measured again, and its record cannot be read: {error}")
    if record.unrelated_end is not None:
        return None
    why = f"{record.status}, then measured again"
    return LostAttempt(run=folder.name, why=why, kinds=_kinds(record, records))


def _kind(record: RunRecord) -> str:
    return kind_of(target_of(record), record.suite, record.circumstances)


def _kinds(record: RunRecord, records: Mapping[Path, RunRecord]) -> frozenset[str]:
    """What an attempt would have measured; for a failed topology, also the streams of other runs of its kind."""
    kind = _kind(record)
    if record.status is RunStatus.OK or record.coverage is not None:
        return frozenset({kind})
    alike = {other.run for other in records.values() if _kind(other) == kind}
    return frozenset({kind, *(_kind(other) for other in records.values() if other.observed_by in alike)})


def _kinds_of_run(name: str, records: Mapping[Path, RunRecord]) -> frozenset[str]:
    """What the attempts at a run measure, including its streams, on every target and kernel with runs here."""
    run = _plain(name)
    of_run = [record for folder, record in records.items() if run in (folder.name, record.observed_by)]
    targets = {target_of(record) for record in records.values()}
    return frozenset(kind_of(target, record.suite, record.circumstances) for record in of_run for target in targets)


def _without_record(folder: Path, records: Mapping[Path, RunRecord]) -> Iterator[LostAttempt]:
    """Attempts without a record: never closed, known only from the journal or, without a journal, missing in the
    numbering."""
    if not folder.is_dir():
        return
    names = [child.name for child in folder.iterdir() if child.is_dir() and not child.name.startswith(".")]
    names = [name for name in names if not _is_warm_up(name)]
    begun = numbers_begun(folder)
    for run, goes_on in begun.items():
        if not goes_on:
            yield LostAttempt(run=run, why="begun and never closed")
    known = attempts(folder)
    if known is None:
        yield from _left_out([*map(_plain, names), *(f"{run}-" for run in begun)])
        return
    kept = Counter(_plain(name) for name in names if _CUT_OFF.search(name))
    closed = Counter(_plain(name) for name in names if not _CUT_OFF.search(name) and is_closed(folder / name))
    # A runner is still at work on its attempt.
    goes_on = is_at_work(folder)
    for run, journaled in known.items():
        if not _is_warm_up(run):
            for why in _unaccounted(journaled, closed[run], kept[run], goes_on=goes_on):
                yield LostAttempt(run=run, why=why, kinds=_kinds_of_run(run, records))


def _unaccounted(journaled: RunAttempts, closed: int, kept: int, *, goes_on: bool) -> Iterator[str]:
    """What the journal says about attempts at a run that are not here; `closed` and `kept` count those here."""
    for _ in range(journaled.closed - closed):
        here = f"{closed} of them {'is' if closed == 1 else 'are'} here"
        yield f"closed {counted(journaled.closed, 'time')} by the journal, {here}"
    for _ in range(journaled.kept - kept):
        yield "cut off by a restart of the target, and what was kept of it is not here"
    yield from journaled.given_up
    # A runner that was killed may have closed or kept it without time to write that down.
    not_noted = max(0, closed - journaled.closed) + max(0, kept - journaled.kept)
    yield from journaled.never_closed(goes_on=goes_on)[not_noted:]


def _plain(name: str) -> str:
    return _ASIDE.sub("", name)


def _is_warm_up(name: str) -> bool:
    """Whether this is a warm-up: its values are never judged."""
    return _plain(name).endswith(WARM_UP)


def _left_out(names: Iterable[str]) -> Iterator[LostAttempt]:
    numbers = {int(match[1]) for name in names if (match := _NUMBERED.fullmatch(name))}
    for number in range(1, max(numbers, default=0)):
        if number not in numbers:
            yield LostAttempt(run=f"number {number}", why="there is no such run, and no journal")
