"""How much of the requested time an observation covered, and what it missed."""

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from rtfiles.config import Config
from rtfiles.output import counted, listed
from rtfiles.quantities import time
from rtrun.kinds.limits import TIME_MAX_NS
from rtrun.probes.hits import Gap, GapCause, covered_ns, joined

SpanNs = Annotated[int, Field(ge=0, le=TIME_MAX_NS)]


class CoverageGap(Config):
    """A time in which nothing, or not everything, was seen, and why; in ns of CLOCK_MONOTONIC."""

    begin_ns: SpanNs
    end_ns: SpanNs
    cause: Annotated[GapCause, Field(strict=False)]


class Coverage(Config):
    """The requested time, and how much of it was seen; times in ns, moments of CLOCK_MONOTONIC.

    The requested time begins at `begin_ns`, with the probes. `gaps` lie within it, sorted by their begin; gaps with
    different causes may overlap. `seen_ns` is the time that no gap covers.
    """

    begin_ns: SpanNs
    asked_ns: SpanNs
    seen_ns: SpanNs
    gaps: list[CoverageGap]

    @property
    def in_words(self) -> str:
        """How much was seen, and why not everything; empty where everything was."""
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
    """What was seen of the requested time: from `begin_ns` to `until_ns`, except for the gaps."""
    end_ns = begin_ns + asked_ns
    missed = [*gaps, Gap(max(until_ns, begin_ns), end_ns, "", GapCause.ENDED_EARLY)]
    within = (
        gap._replace(from_ns=max(gap.from_ns, begin_ns), until_ns=min(gap.until_ns, end_ns))
        for gap in missed
        if max(gap.from_ns, begin_ns) < min(gap.until_ns, end_ns)
    )
    every = [CoverageGap(begin_ns=gap.from_ns, end_ns=gap.until_ns, cause=gap.cause) for gap in joined(within)]
    return Coverage(begin_ns=begin_ns, asked_ns=asked_ns, seen_ns=asked_ns - _covered_ns(every), gaps=every)


def _covered_ns(gaps: Iterable[CoverageGap]) -> int:
    return covered_ns((gap.begin_ns, gap.end_ns) for gap in gaps)
