"""The question to answer: which values, which deadline, how often it may be missed, and with which confidence."""

import math
import re
from dataclasses import dataclass
from typing import Literal

from rtfiles.quantities import grouped, time
from rtrun.kinds.lateness import LATENESS, Measure

# The most consecutive loops that a tolerance may cover: a second at 1 kHz.
AMONG_MAX = 1000  #: consecutive loops in which a goal tolerates misses
# No goal asks for longer bursts.
BURSTS_MAX = 1000  #: misses in a row that a proof has to cover (`--bursts`)
# The stall that a proof has to cover by default: a time slice or a page of flash takes this long, and a loop at 1 kHz
# that is judged by lateness then misses ten times in a row.
STALL_NS = 10_000_000
# A log without a period may come from a control loop, which misses ten times in a row in a stall.
UNKNOWN_PERIOD_NS = 1_000_000
# A rate that was missed by more than 1 % is no measurement (docs/analysis.md).
_PERIOD_OFF = 0.01
_TOLERANCE = re.compile(r"([0-9]{1,4}) (?:in a row|of ([0-9]{1,4}))", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How many misses are tolerated: at most `misses` among any `among` consecutive loops.

    Each window of `among` loops with more misses is then counted once, at its end. N misses in a row means N of N + 1.
    """

    misses: int = 0
    among: int = 1

    @property
    def overlap(self) -> int:
        """The number of windows that the shortest counted series of misses makes: these windows count as one."""
        return self.among - self.misses

    def is_within(self, other: "Tolerance") -> bool:
        """Whether the other one tolerates everything that this one does, even the most misses within one of its
        windows."""
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
    """Is P(miss) of this deadline below `probability`, at this confidence, on at least `boots` boots?

    `of` are the values that have the deadline; None: whatever the suite measures, for the cyclic timer the lateness. In
    the question of a verdict, `of` is what was judged, `latency` included. A proof has to cover bursts of misses of the
    mean length `bursts`, in loops of one stream, even if none was seen; None: the length that `bursts_asked` returns.
    A deadline overrides those that runs were measured for. None: only runs measured for one of their own are judged.
    """

    of: Measure | None = None
    tolerance: Tolerance = NONE_TOLERATED
    deadline_ns: int | None = None
    probability: float = 1e-6
    confidence: float = 0.95
    boots: int = 1
    bursts: int | None = None

    @property
    def limit_ns(self) -> int:
        """The deadline of a question that is judged. Raises ValueError if it has none."""
        if self.deadline_ns is None:
            raise ValueError("a question without a deadline is not judged")
        return self.deadline_ns

    @property
    def on_boots(self) -> str:
        """The boots that are asked for, in words; empty for a single one."""
        return f"on at least {self.boots} boots" if self.boots > 1 else ""

    @property
    def covered(self) -> str:
        """The bursts that a proof has to cover, in words."""
        if self.bursts is None:
            return f"bursts of {time(STALL_NS)}"
        return f"bursts of up to {grouped(self.bursts)} misses" if self.bursts > 1 else "misses that come singly"

    @property
    def in_bursts(self) -> str:
        """The bursts of misses in spite of which a proof has to hold, in words."""
        return "if late values come singly" if self.bursts == 1 else f"even if late values come in {self.covered}"

    @property
    def miss(self) -> str:
        """What counts as a miss, in words."""
        limit = "its deadline" if self.deadline_ns is None else time(self.deadline_ns)
        late = f"{self.of or 'value'} > {limit}"
        if self.tolerance == NONE_TOLERATED:
            return late
        return f"more than {self.tolerance} with {late}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bursts:
    """The mean length of bursts of misses that a proof has to cover, in loops of one stream, and the reason for it."""

    length: int
    why: Literal["asked", "stall", "longest seen", "period not known"]


def bursts_asked(asked: Question, period_ns: float | None = None, longest_seen: int = 1) -> Bursts:
    """The bursts that were asked for, else a stall of `STALL_NS`, or the longest burst that was seen if it is longer.

    `period_ns` is the period of one stream; None counts as `UNKNOWN_PERIOD_NS`. If some misses are tolerated, the
    windows with too many misses are counted: a stall of L loops makes L - N windows with more than N in a row, and
    L + M - 1 - 2 N windows of M loops with more than N misses.
    """
    if asked.bursts is not None:
        return Bursts(length=asked.bursts, why="asked")
    in_a_stall = _late_in_a_stall(asked.tolerance, UNKNOWN_PERIOD_NS if period_ns is None else period_ns)
    if longest_seen > in_a_stall:
        return Bursts(length=longest_seen, why="longest seen")
    return Bursts(length=in_a_stall, why="period not known" if period_ns is None else "stall")


def _late_in_a_stall(tolerance: Tolerance, period_ns: float) -> int:
    loops = STALL_NS / max(period_ns, 1.0)
    # A measured period does not divide the stall exactly: 0.9999 ms are no reason for an eleventh loop.
    whole = max(1, round(loops) if loops <= round(loops) * (1 + _PERIOD_OFF) else math.ceil(loops))
    # If the stall is tolerated, only other misses are left, which come singly.
    return 1 if whole <= tolerance.misses else whole + tolerance.among - 1 - 2 * tolerance.misses


def may_follow(first: Question, later: Question) -> bool:
    """Whether a goal may be replaced by another one after answers were seen, without measuring anew.

    The interval is about P(miss) of one deadline, and holds for every probability at once. Choosing both deadline and
    probability after seeing results finds a pair that is proven wrongly in a third of all cases. The same goes for
    choosing another series or other tolerated misses.
    """
    return (later.of, later.tolerance, later.deadline_ns) == (first.of, first.tolerance, first.deadline_ns)


def weaker(goal: Question, asked: Question, bursts_by_default: int = 1) -> tuple[str, ...]:
    """The points in which a question is weaker than a goal, or differs from it; a few words for each.

    `bursts_by_default` is the length of bursts that a proof has to cover if none is set, for the measured runs.
    """
    parts = []
    if asked.of != goal.of:
        parts.append(f"of the {asked.of or LATENESS}, not of the {goal.of or LATENESS}")
    if asked.deadline_ns is not None and (goal.deadline_ns is None or asked.deadline_ns > goal.deadline_ns):
        of_goal = "that of each stream" if goal.deadline_ns is None else time(goal.deadline_ns)
        parts.append(f"a deadline of {time(asked.deadline_ns)}, not {of_goal}")
    if asked.probability > goal.probability:
        parts.append(f"a probability of {asked.probability:g}, not {goal.probability:g}")
    if asked.confidence < goal.confidence:
        parts.append(f"a confidence of {asked.confidence:g}, not {goal.confidence:g}")
    if not asked.tolerance.is_within(goal.tolerance):
        parts.append(f"misses tolerated: {asked.tolerance}, not {goal.tolerance}")
    if (asked.bursts or bursts_by_default) < (goal.bursts or bursts_by_default):
        parts.append(f"covering {asked.covered}, not {goal.covered}")
    return tuple(parts)


NO_DEADLINE = Question()
"""Figures alone, but for runs that were measured for a deadline of their own."""
THESIS = Question(deadline_ns=400_000)
"""The thesis' deadline (section 4.1.2), which is hardly ever missed."""


def unlike_share(boots: int, confidence: float) -> float:
    """The largest share that boots of another kind may have if none of this many boots was of it, at this confidence.

    If a kind has the share s, the chance that m boots all miss it is (1 - s)^m. The s for which this chance is
    (1 - confidence) / 2 is the upper end of the interval of Clopper & Pearson (1934) after no event.
    """
    return -math.expm1(math.log((1 - confidence) / 2) / boots)


def boots_for(share: float, confidence: float) -> int:
    """How many boots leave at most this share of boots of another kind unseen: the inverse of `unlike_share`."""
    return math.ceil(math.log((1 - confidence) / 2) / math.log1p(-share))
