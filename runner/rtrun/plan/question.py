"""The question that an answer is to: which values, which deadline, how seldom missed, how sure, and for what."""

import math
import re
from dataclasses import dataclass, field
from typing import Literal

from rtfiles.quantities import grouped, time
from rtrun.kinds.kind import Measure
from rtrun.kinds.lateness import LATENESS

# So many loops are looked at together at most: a second at 1 kHz.
AMONG_MAX = 1000
# No goal asks for longer bursts.
BURSTS_MAX = 1000
# A stall that a proof has to cover unless something else is asked: a time slice or a page of flash takes that long, and
# a loop at 1 kHz that is judged by lateness then misses ten times in a row.
STALL_NS = 10_000_000
# A log that does not say its period may be of a control loop, which a stall makes miss ten times in a row.
UNKNOWN_PERIOD_NS = 1_000_000
# A rate that was missed by more than 1 % is no measurement (docs/analysis.md).
_PERIOD_OFF = 0.01
_TOLERANCE = re.compile(r"([0-9]{1,4}) (?:in a row|of ([0-9]{1,4}))", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How many values may be late before it counts: at most `misses` among any `among` consecutive loops.

    What is counted is then the end of each `among` loops that hold more. `misses` in a row are those among one more.
    """

    misses: int = 0
    among: int = 1

    @property
    def overlap(self) -> int:
        """How many such ends the fewest misses that count make, when they follow one another: they count as one."""
        return self.among - self.misses

    def is_within(self, other: "Tolerance") -> bool:
        """Whether the other one tolerates whatever this one does: the most misses that it lets into its windows."""
        whole, rest = divmod(other.among, self.among)
        return whole * self.misses + min(self.misses, rest) <= other.misses

    def __str__(self) -> str:
        """As `read_tolerance` takes it."""
        return f"{self.misses} in a row" if self.overlap == 1 else f"{self.misses} of {self.among}"


NONE_TOLERATED = Tolerance()


def read_tolerance(text: object) -> Tolerance:
    """Read ``2 in a row`` or ``3 of 100``. Raises ValueError."""
    parts = _TOLERANCE.fullmatch(text) if isinstance(text, str) else None
    misses = int(parts[1]) if parts else 0
    among = int(parts[2] or misses + 1) if parts else 0
    if not misses < among <= AMONG_MAX:
        raise ValueError(
            f"{str(text)[:40]!r} is neither a number of misses in a row, as '2 in a row', nor of consecutive loops, as "
            f"'3 of 100', of which there are at most {AMONG_MAX}"
        )
    return Tolerance(misses=misses, among=among)


def read_bursts(text: str) -> int:
    """Read how many misses in a row a proof has to cover, as on a command line. Raises ValueError."""
    if not text.isascii() or not text.isdecimal() or len(text) > 4 or not 1 <= int(text) <= BURSTS_MAX:
        raise ValueError(f"{text[:40]!r} is no number of misses in a row, 1 to {BURSTS_MAX}")
    return int(text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Is P(miss) of this deadline below `probability`, at this confidence, on at least so many boots?

    `of` are the values that have it; None: whatever the suite measures, of the cyclic timer the lateness. In the
    question of a verdict it is what was judged, `latency` included. A proof has to cover `bursts` of misses of this
    mean length, in loops of one stream, even if none was seen; None: what `bursts_asked` says.
    """

    of: Measure | None = None
    tolerance: Tolerance = NONE_TOLERATED
    deadline_ns: int = 400_000
    probability: float = 1e-6
    confidence: float = 0.95
    boots: int = 1
    bursts: int | None = None
    is_deadline_stated: bool = field(default=False, compare=False)
    """Whether somebody named the deadline: it then comes before those that runs were measured for."""

    @property
    def covered(self) -> str:
        """The bursts that a proof has to cover, in words."""
        if self.bursts is None:
            return f"a stall of {time(STALL_NS)}"
        return f"bursts of up to {grouped(self.bursts)} misses" if self.bursts > 1 else "misses that come singly"

    @property
    def miss(self) -> str:
        """What counts as a miss, in words."""
        late = f"{self.of or 'value'} > {time(self.deadline_ns)}"
        if self.tolerance == NONE_TOLERATED:
            return late
        return f"more than {self.tolerance} with {late}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bursts:
    """The mean length of bursts of misses, in loops of one stream, that a proof has to cover, and why that."""

    length: int
    why: Literal["asked", "stall", "longest seen", "period not known"]


def bursts_asked(asked: Question, period_ns: float | None = None, longest_seen: int = 1) -> Bursts:
    """What was asked for, else a stall of `STALL_NS`, or the longest burst that was seen, in misses.

    `period_ns` is that of one stream; one that is not known counts as `UNKNOWN_PERIOD_NS`. Where some are tolerated,
    what is counted are the windows with too many misses: a stall of L loops makes L - N ends of more than N in a row,
    and L + M - 1 - 2 N windows of M loops that hold more than N.
    """
    if asked.bursts is not None:
        return Bursts(length=asked.bursts, why="asked")
    in_a_stall = _late_in_a_stall(asked.tolerance, UNKNOWN_PERIOD_NS if period_ns is None else period_ns)
    if longest_seen > in_a_stall:
        return Bursts(length=longest_seen, why="longest seen")
    return Bursts(length=in_a_stall, why="period not known" if period_ns is None else "stall")


def _late_in_a_stall(tolerance: Tolerance, period_ns: float) -> int:
    loops = STALL_NS / max(period_ns, 1.0)
    # A period that was measured is not a whole part of the stall: 0.9999 ms are no reason for an eleventh loop.
    whole = max(1, round(loops) if loops <= round(loops) * (1 + _PERIOD_OFF) else math.ceil(loops))
    # A stall that is tolerated leaves what other misses make.
    return 1 if whole <= tolerance.misses else whole + tolerance.among - 1 - 2 * tolerance.misses


def may_follow(first: Question, later: Question) -> bool:
    """Whether a goal may become another one after answers were seen, without measuring anew.

    The interval is about P(miss) of one deadline, and holds for every probability at once. Who chooses deadline and
    probability by what was seen finds a pair that is proven wrongly in a third of all cases. So it is with another
    series, and with misses that are tolerated.
    """
    return (later.of, later.tolerance, later.deadline_ns) == (first.of, first.tolerance, first.deadline_ns)


def weaker(goal: Question, asked: Question, bursts_by_default: int = 1) -> tuple[str, ...]:
    """In what a question asks less than a goal, a few words each, or asks something else.

    `bursts_by_default` is what a proof has to cover of what was measured where the length of bursts is not set.
    """
    parts = []
    if asked.of != goal.of:
        parts.append(f"of the {asked.of or LATENESS}, not of the {goal.of or LATENESS}")
    if asked.deadline_ns > goal.deadline_ns:
        parts.append(f"a deadline of {time(asked.deadline_ns)}, not {time(goal.deadline_ns)}")
    if asked.probability > goal.probability:
        parts.append(f"a probability of {asked.probability:g}, not {goal.probability:g}")
    if asked.confidence < goal.confidence:
        parts.append(f"a confidence of {asked.confidence:g}, not {goal.confidence:g}")
    if not asked.tolerance.is_within(goal.tolerance):
        parts.append(f"misses tolerated: {asked.tolerance}, not {goal.tolerance}")
    if (asked.bursts or bursts_by_default) < (goal.bursts or bursts_by_default):
        parts.append(f"covering {asked.covered}, not {goal.covered}")
    return tuple(parts)


THESIS = Question()
"""The thesis' deadline (section 4.1.2), which is hardly ever missed."""


def unlike_share(boots: int, confidence: float) -> float:
    """The largest share of boots of another kind that so many boots may all have missed, at this confidence.

    None of m boots is of a kind that has the share s with the chance (1 - s)^m; of (1 - confidence) / 2 it is the upper
    end of the interval of Clopper & Pearson (1934) after no event.
    """
    return -math.expm1(math.log((1 - confidence) / 2) / boots)


def boots_for(share: float, confidence: float) -> int:
    """How many boots leave at most this share of boots of another kind unseen: the inverse of `unlike_share`."""
    return math.ceil(math.log((1 - confidence) / 2) / math.log1p(-share))
