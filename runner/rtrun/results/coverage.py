"""How much of the time that an observation was asked for it has seen, and what it missed."""

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from rtfiles.config import Config
from rtfiles.output import counted, listed
from rtfiles.quantities import time
from rtrun.plan.limits import TIME_MAX_NS
from rtrun.probes.hits import Gap, GapCause, covered_ns

GAPS_MAX = 10_000
"""Of one cause; where there are more, those that lie close together become one."""

SpanNs = Annotated[int, Field(ge=0, le=TIME_MAX_NS)]


class CoverageGap(Config):
    """A time in which nothing, or not everything, was seen, in ns of CLOCK_MONOTONIC, and why."""

    begin_ns: SpanNs
    end_ns: SpanNs
    cause: Annotated[GapCause, Field(strict=False)]


class Coverage(Config):
    """The time that was asked for, and what of it was seen; times in ns, moments of CLOCK_MONOTONIC.

    What is asked for begins at `begin_ns`, with the probes. `gaps` lie within it, in the order of their begins; those
    of two causes may overlap. `seen_ns` is what no gap covers.
    """

    begin_ns: SpanNs
    asked_ns: SpanNs
    seen_ns: SpanNs
    gaps: list[CoverageGap]

    @property
    def in_words(self) -> str:
        """How much was seen, and why no more; empty where all of it was."""
        if not self.gaps:
            return ""
        causes = [
            f"{cause} {time(_covered_ns([gap for gap in self.gaps if gap.cause is cause]))}"
            for cause in GapCause
            if any(gap.cause is cause for gap in self.gaps)
        ]
        gaps = counted(len(self.gaps), "gap")
        return f"{time(self.seen_ns)} of {time(self.asked_ns)} were seen, with {gaps}: {listed(causes, len(causes))}"


def coverage(*, begin_ns: int, until_ns: int, asked_ns: int, gaps: Iterable[Gap]) -> Coverage:
    """What was seen from `begin_ns` to `until_ns` of the time that was asked for, but for the gaps."""
    end_ns = begin_ns + asked_ns
    by_cause: dict[GapCause, list[CoverageGap]] = {}
    for gap in sorted(gaps):
        from_ns, to_ns = (min(max(at_ns, begin_ns), end_ns) for at_ns in (gap.from_ns, gap.until_ns))
        _add(by_cause.setdefault(gap.cause, []), from_ns, to_ns, gap.cause)
    _add(by_cause.setdefault(GapCause.ENDED_EARLY, []), max(until_ns, begin_ns), end_ns, GapCause.ENDED_EARLY)
    every = sorted((gap for each in by_cause.values() for gap in _fewer(each)), key=lambda gap: gap.begin_ns)
    return Coverage(begin_ns=begin_ns, asked_ns=asked_ns, seen_ns=asked_ns - _covered_ns(every), gaps=every)


def _add(gaps: list[CoverageGap], begin_ns: int, end_ns: int, cause: GapCause) -> None:
    """Add a gap of the same cause that begins no earlier than those before."""
    if end_ns <= begin_ns:
        return
    if gaps and begin_ns <= gaps[-1].end_ns:
        begin_ns, end_ns = gaps[-1].begin_ns, max(end_ns, gaps.pop().end_ns)
    gaps.append(CoverageGap(begin_ns=begin_ns, end_ns=end_ns, cause=cause))


def _fewer(gaps: list[CoverageGap]) -> list[CoverageGap]:
    """At most GAPS_MAX: the shortest times between them are given up, and count as not seen."""
    if len(gaps) <= GAPS_MAX:
        return gaps
    between = sorted(range(1, len(gaps)), key=lambda place: gaps[place].begin_ns - gaps[place - 1].end_ns)
    joined = set(between[: len(gaps) - GAPS_MAX])
    fewer: list[CoverageGap] = []
    for place, gap in enumerate(gaps):
        begin_ns = fewer.pop().begin_ns if place in joined else gap.begin_ns
        fewer.append(CoverageGap(begin_ns=begin_ns, end_ns=gap.end_ns, cause=gap.cause))
    return fewer


def _covered_ns(gaps: Iterable[CoverageGap]) -> int:
    return covered_ns((gap.begin_ns, gap.end_ns) for gap in gaps)
