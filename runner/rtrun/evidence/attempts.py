"""Attempts that gave no values to judge: they failed, were invalid, were measured again, or are not there any more.

Who leaves them out keeps the lucky ones alone: a run that hung was perhaps late to the end. So each counts, unless its
end is known to have nothing to do with lateness (`UnrelatedEnd`).
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.output import counted
from rtrun.plan.suites import Value, telling_parameters
from rtrun.plan.trace import WARM_UP
from rtrun.results.journal import closings
from rtrun.results.reading import Source, target_of
from rtrun.results.record import RunRecord, RunStatus, read_record

_ASIDE = re.compile(r"\.(?:old|incomplete)-[0-9]+$", re.ASCII)
_NUMBERED = re.compile(r"([0-9]{1,6})-.*", re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class LostAttempt:
    """An attempt of which nothing is judged; `why` says what became of it.

    `kind` is that of what it would have measured (`kind_of`); "" where that is not known: it may have been any.
    """

    run: str
    why: str
    kind: str = ""

    def __str__(self) -> str:
        return f"{self.run}: {self.why}"


def kind_of(target: str, suite: str, parameters: Mapping[str, Value]) -> str:
    """What a run measures, and on which target: runs of one kind are alike but for what they found."""
    return json.dumps([target, suite, sorted(telling_parameters(parameters).items())])


def lost_attempts(
    source: Source, records: Mapping[Path, RunRecord], unreadable: Mapping[Path, str]
) -> tuple[LostAttempt, ...]:
    """What was attempted in a folder and is not judged, but for what ended for a reason of its own.

    `records` are those of the closed runs, `unreadable` says why others, or their values, cannot be read.
    """
    lost = [_lost(folder, record, unreadable.get(folder)) for folder, record in records.items()]
    lost += [LostAttempt(run=folder.name, why=why) for folder, why in unreadable.items() if folder not in records]
    lost += [_measured_again(folder) for folder in source.old]
    lost += [_cut_off(source.path / name, records) for name in source.repeated if not _is_warm_up(name)]
    return (*filter(None, lost), *_missing(source.path))


def _lost(folder: Path, record: RunRecord, unreadable: str | None) -> LostAttempt | None:
    if unreadable is None and (record.status is RunStatus.OK or record.unrelated_end is not None):
        return None
    why = unreadable or f"{record.status}: {record.reason or 'no reason given'}"
    return LostAttempt(run=folder.name, why=why, kind=_kind(record))


def _measured_again(folder: Path) -> LostAttempt | None:
    try:
        record = read_record(folder)
    except UsageError as error:
        return LostAttempt(run=folder.name, why=f"measured again, and its record cannot be read: {error}")
    if record.unrelated_end is not None:
        return None
    return LostAttempt(run=folder.name, why=f"{record.status}, then measured again", kind=_kind(record))


def _cut_off(folder: Path, records: Mapping[Path, RunRecord]) -> LostAttempt:
    """What a restart of the target cut off: whether it hung before, nobody knows."""
    again = records.get(folder.with_name(_ASIDE.sub("", folder.name)))
    return LostAttempt(
        run=folder.name, why="cut off by a restart of the target", kind=_kind(again) if again is not None else ""
    )


def _kind(record: RunRecord) -> str:
    return kind_of(target_of(record), record.suite, record.circumstances)


def _missing(folder: Path) -> Iterator[LostAttempt]:
    """What the journal says was closed, and nobody finds; without a journal, numbers that are left out."""
    if not folder.is_dir():
        return
    present: Counter[str] = Counter()
    for child in folder.iterdir():
        if child.is_dir() and not child.name.startswith(".") and not _is_warm_up(child.name):
            present[_ASIDE.sub("", child.name)] += 1
    known = closings(folder)
    if known is None:
        yield from _left_out(present)
        return
    for run, times in known.items():
        if not _is_warm_up(run) and times > present[run]:
            here = f"{present[run]} of them {'is' if present[run] == 1 else 'are'} here"
            yield LostAttempt(run=run, why=f"closed {counted(times, 'time')} by the journal, {here}")


def _is_warm_up(name: str) -> bool:
    """Whether it is a warm-up, of which no value is ever judged."""
    return _ASIDE.sub("", name).endswith(WARM_UP)


def _left_out(names: Iterable[str]) -> Iterator[LostAttempt]:
    numbers = {int(match[1]) for name in names if (match := _NUMBERED.fullmatch(name))}
    for number in range(1, max(numbers, default=0)):
        if number not in numbers:
            yield LostAttempt(run=f"number {number}", why="there is no such run, and no journal")
