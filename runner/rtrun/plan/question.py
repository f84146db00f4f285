"""The question that an answer is to: which deadline, how seldom missed, how sure, and of what it has to hold."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Is P(miss) of this deadline below `probability`, at this confidence, on at least so many boots?

    A proof has to cover bursts of misses of this mean length, even if none was seen.
    """

    deadline_ns: int = 400_000
    probability: float = 1e-6
    confidence: float = 0.95
    boots: int = 1
    bursts: int = 1

    @property
    def covered(self) -> str:
        """The bursts that a proof has to cover, in words."""
        return f"bursts of up to {self.bursts} misses" if self.bursts > 1 else "misses that come singly"


def may_follow(first: Question, later: Question) -> bool:
    """Whether a goal may become another one after answers were seen, without measuring anew.

    The interval is about P(miss) of one deadline, and holds for every probability at once. Who chooses deadline and
    probability by what was seen finds a pair that is proven wrongly in a third of all cases.
    """
    return later.deadline_ns == first.deadline_ns


THESIS = Question()
"""The thesis' deadline (section 4.1.2), which is hardly ever missed."""


def unlike_share(boots: int, confidence: float) -> float:
    """The largest share of boots of another kind of which none may have been among so many, at this confidence.

    None of m boots is of a kind that has the share s with the chance (1 - s)^m; of (1 - confidence) / 2 it is the upper
    end of the interval of Clopper & Pearson (1934) after no event.
    """
    return -math.expm1(math.log((1 - confidence) / 2) / boots)


def boots_for(share: float, confidence: float) -> int:
    """How many boots leave at most this share of boots of another kind unseen: the inverse of `unlike_share`."""
    return math.ceil(math.log((1 - confidence) / 2) / math.log1p(-share))
