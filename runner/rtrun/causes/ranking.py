"""Culprits over all outliers: how often and how long they ran, and how often as long when nothing was late."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from rtrun.analysis.chance.intervals import chance_of_so_many
from rtrun.causes.outliers import Explained
from rtrun.causes.parts import NAMELESS, Cause, Kind, Part

# These also have the CPU when nothing is late: only their time beyond that counts.
_FREQUENT = frozenset({Kind.HIGHER, Kind.DEADLINE, Kind.EQUAL, Kind.SHARED, Kind.INTERRUPT, Kind.SOFTIRQ})
# A thread that had the CPU while the kernel could not be interrupted or preempted may be innocent: the host may have
# stopped a virtual machine. So it counts less the more of the time it has the CPU anyway.
_CIRCUMSTANTIAL = frozenset({Kind.TIMER_LATE, Kind.NOT_PREEMPTED, Kind.CONSOLE})
BY_CHANCE = 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class Culprit:
    """What took time, over all outliers.

    `name`, `pid`, `prio` and `above` are those of the thread that took longest. `threads` counts the threads of that
    name, `alike` the threads whose names differ from it only in numbers. `main` counts the outliers of which it took
    more than half. `extra_ns` is its time beyond that in windows of the same length when nothing was late. In `as_long`
    of these `windows` it had the same CPU for at least half as long as in the outlier.
    """

    kind: Kind
    name: str
    pid: int | None
    prio: int | None
    above: int | None
    threads: int
    alike: int
    count: int
    main: int
    total_ns: int
    worst_ns: int
    extra_ns: int
    windows: int
    as_long: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Ranking:
    """The culprits of all outliers with a trace, worst first, and the sum of their lateness.

    `main_by_kind` counts the outliers of which all culprits of a kind together took more than half.
    """

    culprits: tuple[Culprit, ...]
    outliers: int
    late_ns: int
    main_by_kind: Mapping[Kind, int] = field(default_factory=dict)

    @property
    def named(self) -> Culprit | None:
        """The culprit that is the main one in at least half of the outliers, unless it may be so by chance."""
        first = next((culprit for culprit in self.culprits if culprit.kind not in NAMELESS), None)
        if first is None or 2 * first.main < max(1, self.outliers):
            return None
        return None if self.is_by_chance(first) else first

    @property
    def named_kind(self) -> Kind | None:
        """The kind whose culprits together are the main cause of at least half of the outliers, though none alone is.

        Kinds that depend on who had the CPU by chance are not considered.
        """
        kinds = [kind for kind in self.main_by_kind if kind not in NAMELESS | _CIRCUMSTANTIAL]
        most = max(kinds, key=lambda kind: self.main_by_kind[kind], default=None)
        return None if most is None or 2 * self.main_by_kind[most] < max(1, self.outliers) else most

    def is_by_chance(self, culprit: Culprit) -> bool:
        """Whether a culprit may have had the CPU this often without having caused the outliers.

        With one outlier that is always possible. With more, their number is binomial with the culprit's share of the
        time when nothing is late.
        """
        if culprit.kind not in _CIRCUMSTANTIAL:
            return False
        share = 1 - culprit.extra_ns / max(1, culprit.total_ns)
        return culprit.main < 2 or chance_of_so_many(culprit.main, self.outliers, share) > BY_CHANCE


def rank(explained: Iterable[Explained]) -> Ranking:
    """Rank the culprits by the number of outliers that they mainly caused, then by time."""
    cut = [case for case in explained if case.parts]
    alike = _alike(cut)
    occurrences: dict[_Identity, list[_Occurrence]] = defaultdict(list)
    main_by_kind: Counter[Kind] = Counter()
    for case in cut:
        parts: dict[_Identity, list[Part]] = defaultdict(list)
        for part in case.parts:
            identity = _identity(part.cause)
            parts[alike.get(identity, identity)].append(part)
        extra_ns: Counter[Kind] = Counter()
        for culprit, of_culprit in parts.items():
            occurrence = _occurrence(case, of_culprit)
            occurrences[culprit].append(occurrence)
            extra_ns[culprit[0]] += occurrence.length_ns - occurrence.usual_ns
        main_by_kind.update(kind for kind, length_ns in extra_ns.items() if 2 * length_ns > case.outlier.value_ns)
    culprits = [_culprit(kind, occurred) for (kind, _), occurred in occurrences.items()]
    return Ranking(
        culprits=tuple(
            sorted(culprits, key=lambda culprit: (-culprit.main, -culprit.extra_ns, culprit.kind, culprit.name))
        ),
        outliers=len(cut),
        late_ns=sum(case.outlier.value_ns for case in cut),
        main_by_kind=main_by_kind,
    )


_Identity = tuple[Kind, str]


def _identity(cause: Cause) -> _Identity:
    """The identity of a culprit: threads of one name count as one, since a script may start the same program again and
    again.

    While real-time threads are throttled, it does not matter which thread was chosen.
    """
    return cause.kind, "" if cause.kind is Kind.THROTTLED else cause.name


def _alike(cut: Iterable[Explained]) -> Mapping[_Identity, _Identity]:
    """The common name of threads that are one culprit under several names, by kind and name.

    These are kernel workers, and processes with a number in the name if each outlier has a different one: a new process
    is started for each job. Other names with numbers belong to different things, such as the threads of two devices.
    """
    seen: dict[_Identity, list[tuple[int, str, int]]] = defaultdict(list)
    for number, case in enumerate(cut):
        for kind, name, pid in {(part.cause.kind, part.cause.name, part.cause.pid) for part in case.parts}:
            if pid is not None and kind is not Kind.CALLBACK and re.search(r"\d", name):
                seen[kind, re.sub(r"\d+", "#", name)].append((number, name, pid))
    return {
        (kind, name): (kind, pattern)
        for (kind, pattern), threads in seen.items()
        if pattern.startswith("kworker/")
        or len(threads) == len({number for number, _, _ in threads}) == len({pid for _, _, pid in threads})
        for _, name, _ in threads
    }


class _Occurrence(NamedTuple):
    """One culprit in one outlier."""

    cause: Cause
    threads: frozenset[tuple[str, int]]
    length_ns: int
    usual_ns: int
    is_main: bool
    windows: int
    as_long: int


def _occurrence(explained: Explained, parts: Sequence[Part]) -> _Occurrence:
    control, value_ns = explained.control, explained.outlier.value_ns
    longest = max(parts, key=lambda part: part.length_ns)
    cause, length_ns = longest.cause, sum(part.length_ns for part in parts)
    usual_ns = windows = as_long = 0
    if cause.kind in _FREQUENT | _CIRCUMSTANTIAL:
        mean_ns = control.mean_ns(longest.cpu, cause.name)
        usual_ns = min(length_ns, mean_ns if cause.kind in _FREQUENT else mean_ns * length_ns // value_ns)
        windows, as_long = control.count, control.with_at_least(longest.cpu, cause.name, length_ns // 2)
    threads = frozenset((part.cause.name, part.cause.pid) for part in parts if part.cause.pid is not None)
    # Whether these had the CPU by chance is judged over all outliers together (`is_by_chance`).
    counted_ns = length_ns if cause.kind in _CIRCUMSTANTIAL else length_ns - usual_ns
    return _Occurrence(cause, threads, length_ns, usual_ns, 2 * counted_ns > value_ns, windows, as_long)


def _culprit(kind: Kind, occurred: Sequence[_Occurrence]) -> Culprit:
    worst = max(occurred, key=lambda occurrence: occurrence.length_ns)
    total_ns = sum(occurrence.length_ns for occurrence in occurred)
    threads = frozenset[tuple[str, int]]().union(*(occurrence.threads for occurrence in occurred))
    of_name = sum(name == worst.cause.name for name, _ in threads)
    return Culprit(
        kind=kind,
        name=worst.cause.name,
        pid=worst.cause.pid,
        prio=worst.cause.prio,
        above=worst.cause.above,
        threads=of_name,
        alike=0 if kind is Kind.THROTTLED else len(threads) - of_name,
        count=len(occurred),
        main=sum(occurrence.is_main for occurrence in occurred),
        total_ns=total_ns,
        worst_ns=worst.length_ns,
        extra_ns=total_ns - sum(occurrence.usual_ns for occurrence in occurred),
        windows=sum(occurrence.windows for occurrence in occurred),
        as_long=sum(occurrence.as_long for occurrence in occurred),
    )
