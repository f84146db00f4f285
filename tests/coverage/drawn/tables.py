"""How often machines got a false answer: by hazard, by pair of hazards, and the worst of them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from drawn.hazards import HAZARDS, INDEPENDENT
from scipy.stats import beta

Line = dict[str, Any]
# More false answers than this is a failure, where even the lower bound says so.
FALSE_MAX, SURE = 0.05, 0.999
# A caveat that so many machines carry which do not have its hazard says nothing.
CARRIED_MAX = 0.20
PAIR_LEAST, HAZARD_LEAST = 400, 2000
PAIRS_SHOWN, WORST_SHOWN = 40, 20
ANSWERS = ("passed", "refuted")
# Truths are solved for to better than this.
_EXACT = 1e-3


def is_false(line: Line, answer: str) -> bool:
    """Whether this answer is false of this machine: the truth is not below what is asked, or not above it."""
    if answer == "passed":
        return bool(min(line["truths"]) >= (1 - _EXACT) * line["p"])
    return bool(max(line["truths"]) <= (1 + _EXACT) * line["p"])


def lower_bound(events: int, of: int) -> float:
    """The lower end of the interval of Clopper & Pearson, one-sided."""
    return float(beta.ppf(1 - SURE, events, of - events + 1)) if events else 0.0


@dataclass(frozen=True, kw_only=True)
class Share:
    """False answers of one kind, among machines at the edge of which that answer would be false."""

    of: int
    wrong: int
    bare: int
    """Without a caveat that excuses."""

    @property
    def is_failure(self) -> bool:
        return lower_bound(self.bare, self.of) > FALSE_MAX

    def __str__(self) -> str:
        if not self.of:
            return "-"
        shown = f"{100 * self.wrong / self.of:.1f} % of {self.of}"
        if self.bare != self.wrong:
            shown += f", {100 * self.bare / self.of:.1f} % without a caveat"
        return f"**{shown}**" if self.is_failure else shown


class Tables:
    """The answers about all machines that were drawn."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines = list(lines)
        self.carried = {(name, answer): self._carried(name, answer) for name in HAZARDS for answer in ANSWERS}

    def _carried(self, name: str, answer: str) -> float:
        others = [line for line in self.lines if line[answer] and name not in line["hazards"]]
        return sum(name in line["said"] for line in others) / max(1, len(others))

    def is_excused(self, line: Line, answer: str) -> bool:
        """Whether its answer names a hazard of it that nobody could see, which it does not name of every machine."""
        hidden = set(line["hazards"]) - set(line["visible"])
        return any(name in line["said"] and self.carried[name, answer] <= CARRIED_MAX for name in hidden)

    def share(self, lines: Iterable[Line], answer: str) -> Share:
        at_edge = [line for line in lines if line["edge"] and is_false(line, answer)]
        wrong = [line for line in at_edge if line[answer]]
        bare = [line for line in wrong if not self.is_excused(line, answer)]
        return Share(of=len(at_edge), wrong=len(wrong), bare=len(bare))

    def with_exactly(self, *names: str) -> list[Line]:
        return [line for line in self.lines if set(line["hazards"]) == set(names)]

    def hazard_rows(self) -> list[tuple[str, list[Share]]]:
        """Of each hazard: PROVEN and REFUTED where it is alone, then among all machines that have it."""
        rows = []
        for name in (INDEPENDENT, *HAZARDS):
            alone = self.with_exactly(*([] if name == INDEPENDENT else [name]))
            every = alone if name == INDEPENDENT else [line for line in self.lines if name in line["hazards"]]
            rows.append((name, [self.share(lines, answer) for lines in (alone, every) for answer in ANSWERS]))
        return rows

    def _by_pair(self) -> dict[tuple[str, ...], list[Line]]:
        """The machines with two hazards and no others, by these."""
        by_pair: dict[tuple[str, ...], list[Line]] = {}
        for line in self.lines:
            if len(line["hazards"]) == 2:
                by_pair.setdefault(tuple(line["hazards"]), []).append(line)
        return by_pair

    def pair_rows(self, least: int) -> list[tuple[str, list[Share]]]:
        """Of each pair with at least so many machines at the edge, the worst first."""
        rows = []
        for pair, lines in self._by_pair().items():
            if sum(line["edge"] for line in lines) >= least:
                rows.append((" + ".join(pair), [self.share(lines, answer) for answer in ANSWERS]))
        return sorted(rows, key=lambda row: -max(lower_bound(each.bare, each.of) for each in row[1]))

    def worst_pairs(self) -> set[tuple[str, ...]]:
        """The pairs that are shown: those with the most false answers, as shares of the machines they may be of."""

        by_pair = self._by_pair()

        def worst_share(pair: tuple[str, ...]) -> float:
            shares = [self.share(by_pair[pair], answer) for answer in ANSWERS]
            return max((each.bare + 0.5) / (each.of + 1) for each in shares)

        return set(sorted(by_pair, key=worst_share, reverse=True)[:PAIRS_SHOWN])

    def worst(self) -> list[Line]:
        """The machines that are furthest from their false answer: of which it is wrong by the most."""

        def distance(line: Line) -> float:
            if line["passed"] and is_false(line, "passed"):
                return float(min(line["truths"]) / line["p"])
            return float(line["p"] / max(max(line["truths"]), 1e-9))

        wrong = [
            line
            for line in self.lines
            if any(line[answer] and is_false(line, answer) and not self.is_excused(line, answer) for answer in ANSWERS)
        ]
        return sorted(wrong, key=distance, reverse=True)[:WORST_SHOWN]

    def failures(self, least: int = PAIR_LEAST) -> list[str]:
        """The rows that fail: hazards, alone and with others, and pairs."""
        rows = self.hazard_rows() + self.pair_rows(least)
        return [name for name, shares in rows if any(share.is_failure for share in shares)]

    def lacking(self) -> list[str]:
        """What a full run has and this one has not."""
        count: Callable[[str], int] = lambda name: sum(name in line["hazards"] for line in self.lines)  # noqa: E731
        few = [f"{name}: {count(name)} of {HAZARD_LEAST} machines" for name in HAZARDS if count(name) < HAZARD_LEAST]
        pairs = len(self.pair_rows(PAIR_LEAST))
        return few + ([f"{pairs} of {PAIRS_SHOWN} pairs"] if pairs < PAIRS_SHOWN else [])

    def text(self, least: int = PAIR_LEAST) -> str:
        """The tables in Markdown."""
        return "\n".join(
            [
                "| hazard | PROVEN, alone | REFUTED, alone | PROVEN, with others too | REFUTED, with others too |",
                "|---|---|---|---|---|",
                *(f"| {name} | {' | '.join(map(str, shares))} |" for name, shares in self.hazard_rows()),
                "",
                *self._text_of_pairs(least),
                "",
                f"| the worst {WORST_SHOWN}, by seed | hazards | answer | truth, in parts of what is asked |",
                "|---|---|---|---|",
                *map(_worst_row, self.worst()),
            ]
        )

    def _text_of_pairs(self, least: int) -> list[str]:
        rows = self.pair_rows(least)[:PAIRS_SHOWN]
        if not rows:
            return [f"No pair of hazards has {least} machines at the edge yet."]
        return [
            f"| the worst {PAIRS_SHOWN} pairs with {least} machines at the edge or more | PROVEN | REFUTED |",
            "|---|---|---|",
            *(f"| {name} | {' | '.join(map(str, shares))} |" for name, shares in rows),
        ]


def _worst_row(line: Line) -> str:
    answer = "PROVEN" if line["passed"] else "REFUTED"
    truths = " or ".join(f"{truth / line['p']:.3g}" for truth in line["truths"])
    return f"| {line['seed']} | {', '.join(line['hazards']) or INDEPENDENT} | {answer} | {truths} |"


def wrong_seeds(lines: Sequence[Line]) -> list[int]:
    """The seeds of machines with a false answer."""
    return [line["seed"] for line in lines if any(line[answer] and is_false(line, answer) for answer in ANSWERS)]
