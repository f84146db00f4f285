"""A machine that is drawn by a seed: its hazards, its true probability of a miss, and the values that it measures."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from drawn.factors import Climb, Factor, Leak, Moments, Place, Ramp, Rng, SlowLoad, strata
from drawn.files import DEADLINE_NS, MISSING, PERIOD_NS
from drawn.hazards import HAZARDS, INDEPENDENT, POPULATIONS, Plan, draw_plan, hazards_of, lengths
from scipy.signal import lfilter
from scipy.special import ndtr

# Moments of the population by which the truth is computed, one of each of so many strata of every factor.
POPULATION = 20_000
_US = 1000
# The highest lateness of a timer that does not make the next call late.
_WITHIN_PERIOD_NS = 950_000


@dataclass(frozen=True, kw_only=True)
class Slot:
    """A run as it is planned: where, when about, and how long."""

    number: int
    board: int
    boot: int
    loops: int
    start: datetime
    place: Place


class Machine:
    """`truths` are the probabilities of a miss in the populations that may be meant; mostly it is one.

    `aim` is the truth in parts of the probability asked for; `is_edge` says that it is drawn to be at that.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.seed = seed
        self.hazards = hazards_of(seed)
        self.plan = plan = draw_plan(rng, self.hazards)
        self.names = self.hazards or (INDEPENDENT,)
        self.is_edge = bool(rng.random() < 0.65)
        self.aim = float(
            rng.choice([1.0, 1.05, 1 / 1.05], p=[0.7, 0.15, 0.15])
            if self.is_edge
            else math.exp(rng.choice([-1, 1]) * rng.uniform(math.log(2), math.log(20)))
        )
        self.aim = min(self.aim, 0.2 / plan.probability)
        self.slots = _slots(plan, rng)
        self.scale, self.truths = self._solve(rng)
        self._effects: dict[tuple[str, int], list[float]] = {}
        self.seen: list[tuple[Factor, float, Place]] = []
        self.rng = rng

    def population(self, rng: Rng, *, by_time: bool = False, without: str = "-") -> np.ndarray:
        """The product of the factors at moments of the population; without those of a level."""
        sizes = np.array([slot.loops for slot in self.slots])
        share = sizes / sizes.sum() if by_time else np.full(sizes.size, 1 / sizes.size)
        length = sizes[np.searchsorted(np.cumsum(share), strata(rng, POPULATION)).clip(max=sizes.size - 1)]
        moments = Moments(length=length.astype(float), loop=np.floor(strata(rng, POPULATION) * length))
        product = np.ones(POPULATION)
        for factor in self.plan.factors:
            if factor.level != without:
                product = product * factor.population(moments, rng)
        return product

    @property
    def asked_about(self) -> str:
        """The population whose truth it is, in words."""
        words = [POPULATIONS[name] for name in self.hazards if name in POPULATIONS]
        return "; ".join(dict.fromkeys(words)) or "loops like those measured"

    def truth_of(self, scale: float, product: np.ndarray) -> float:
        """The probability of a miss where the factors have these products."""
        raised = scale * product
        return float(np.mean(-np.expm1(-raised) if self.plan.base == "bursts" else np.minimum(1.0, raised)))

    def _solve(self, rng: Rng) -> tuple[float, tuple[float, ...]]:
        """The scale of the factors that makes the truth what is aimed at, and the truths."""
        products = [self.population(rng)]
        if self.plan.ratio > 1:
            products.append(self.population(rng, by_time=True))
        aimed = products[int(rng.integers(len(products)))]
        self._products = products
        target = self.aim * self.plan.probability
        low, high = 1e-12, 1e6
        for _ in range(100):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.truth_of(middle, aimed) < target else (low, middle)
        return low, tuple(self.truth_of(low, product) for product in products)

    def truths_after(self, runs: int) -> tuple[float, ...]:
        """The truths for who asks after so many runs: nobody knows of what has not happened yet."""
        so_far = math.prod(factor.until(self.slots[runs - 1].place) for factor in self.plan.factors)
        return tuple(self.truth_of(self.scale, so_far * product) for product in self._products)

    def truth_of_board(self, board: int) -> float:
        """The truth of one of the boards."""
        product = self.population(np.random.default_rng(self.seed + 1), without="board")
        return self.truth_of(self.scale, product * self._effect("board", board))

    def _effect(self, level: str, number: int) -> float:
        factors = [factor for factor in self.plan.factors if factor.level == level]
        if (level, number) not in self._effects:
            self._effects[level, number] = [factor.draw(self.rng) for factor in factors]
        return math.prod(self._effects[level, number])

    def new_attempt(self, slot: Slot) -> tuple[list[np.ndarray], bool, np.ndarray | None]:
        """Measure a run: the values of each thread, whether the attempt is a bad one, and the loops under a load."""
        plan, rng = self.plan, self.rng
        fixed = self._effect("board", slot.board) * self._effect("boot", slot.boot)
        is_bad = False
        load: np.ndarray | None = None
        product: np.ndarray | float = self.scale * fixed
        for factor in plan.factors:
            if factor.level == "run":
                drawn = factor.draw(rng)
                is_bad = drawn > 1
                value: np.ndarray | float = drawn
            elif isinstance(factor, SlowLoad) and plan.gaps:
                load = factor.states(rng, slot.loops)
                value = factor.of_states(load)
            else:
                value = factor.at(slot.place, rng, slot.loops)
            product = product * value
            mean = (
                self._effects[factor.level, getattr(slot, factor.level)]
                if factor.level in ("board", "boot")
                else [float(np.mean(value))]
            )
            self.seen.append((factor, mean[0], slot.place))
        return self._values(np.broadcast_to(np.asarray(product, float), slot.loops)), is_bad, load

    def _values(self, raised: np.ndarray) -> list[np.ndarray]:
        """Values of the threads of one process, whose misses are of one event."""
        plan, rng, size = self.plan, self.rng, raised.size
        chance = np.clip(-np.expm1(-raised) if plan.base == "bursts" else raised, 1e-300, 1.0)
        stalls = None
        if plan.base == "bursts":
            stalls = self._stalls(raised)
            uniform = chance + (1 - chance) * rng.random(size)
        elif plan.base == "ar":
            uniform = 1 - ndtr(_ar(rng, plan.rho, size))
        else:
            uniform = rng.random(size)
        # Above 0 it is late.
        height = np.log(chance) - np.log(np.clip(uniform, 1e-300, 1.0))
        late = height > 0 if stalls is None else stalls > 0
        threads = []
        for _ in range(plan.threads):
            values = self._in_ns(height * np.exp(0.02 * rng.standard_normal(size)) if plan.threads > 1 else height)
            if stalls is not None:
                # All that was due in a stall is called at its end.
                end = DEADLINE_NS + 2 * _US + rng.integers(0, 500 * _US)
                values = np.where(stalls > 0, (stalls - 1) * PERIOD_NS + end, values)
            values = np.where(
                late, np.maximum(values, DEADLINE_NS + 2 * _US), np.minimum(values, DEADLINE_NS - 2 * _US)
            )
            threads.append(np.maximum(values, 2 * _US).astype(np.int64))
        if plan.suite == "messages" and self.seed % 4 == 0:
            lost = np.flatnonzero(late[:-1] & (rng.random(size - 1) < 0.5))
            for values in threads:
                values[lost] = MISSING
        return threads

    def _stalls(self, raised: np.ndarray) -> np.ndarray:
        """How many loops each stall still takes, 0 where there is none."""
        plan, rng = self.plan, self.rng
        head = int(plan.burst if plan.is_burst_fixed else 20 * plan.burst)
        rate = np.r_[np.full(head, raised[0]), raised] / plan.burst
        starts = np.repeat(np.arange(rate.size), rng.poisson(rate))
        long = (
            np.full(starts.size, int(plan.burst)) if plan.is_burst_fixed else rng.geometric(1 / plan.burst, starts.size)
        )
        ends = np.zeros(rate.size, np.int64)
        np.maximum.at(ends, starts, starts + long)
        left = np.maximum.accumulate(ends) - np.arange(rate.size)
        return np.maximum(left, 0)[head:]

    def _in_ns(self, height: np.ndarray) -> np.ndarray:
        plan, rng = self.plan, self.rng
        if plan.tail == "mixture":
            body = 60 * _US * np.exp(0.15 * rng.standard_normal(height.size))
            return np.where(height > 0, DEADLINE_NS + self._above(height * 200 * _US), body)
        if plan.tail == "heavy":
            values = DEADLINE_NS * np.exp(np.clip(plan.tail_index * height, -20, 7))
            return np.where(height > 0, DEADLINE_NS + self._above(values - DEADLINE_NS), values)
        span = (
            2
            - math.log(min(self.scale, 0.9))
            + sum(each.climb if isinstance(each, Leak | Ramp | Climb) else 1.5 for each in plan.factors)
        )
        step = (DEADLINE_NS - 20 * _US) / span
        return np.where(height > 0, DEADLINE_NS + self._above(height * step), DEADLINE_NS + height * step)

    def _above(self, excess: np.ndarray) -> np.ndarray:
        """What comes above the deadline: of a timer within its period, so that one late call is one miss."""
        if self.plan.suite in ("oneshot", "messages", "histograms"):
            return np.asarray(np.clip(excess, 0, 9_000 * _US))
        room = _WITHIN_PERIOD_NS - DEADLINE_NS
        return np.asarray(room * -np.expm1(-np.maximum(excess, 0) / room))

    def visible(self) -> list[str]:
        """The hazards that stand in the files, or show there to who looks."""
        shown = [name for name in self.hazards if HAZARDS[name].is_structural]
        levels = {"run": "run", "boot": "boot", "board": "board"}
        for factor in self.plan.factors:
            mine = [(value, place) for each, value, place in self.seen if each is factor]
            if not mine or not factor.is_visible([value for value, _ in mine], [place for _, place in mine]):
                continue
            kind = type(factor).__name__
            shown += [
                name
                for name in self.hazards
                if name
                in {
                    "TwoKinds": {"run": ["rare states"], "boot": ["bad boots"], "board": ["bad boards"]}.get(
                        levels.get(factor.level, ""), []
                    ),
                    "Leak": ["leak"],
                    "Ramp": ["ramp"],
                    "Climb": ["climb"],
                    "Step": ["step"],
                }.get(kind, [])
            ]
        return list(dict.fromkeys(shown))


def _ar(rng: Rng, rho: float, size: int) -> np.ndarray:
    noise = math.sqrt(1 - rho**2) * rng.standard_normal(size)
    return np.asarray(lfilter([1.0], [1.0, -rho], noise, zi=[rho * rng.standard_normal()])[0])


def _slots(plan: Plan, rng: Rng) -> list[Slot]:
    """The runs in their order: one boot after the other, each on one of the boards in turn."""
    sizes = lengths(plan, rng)
    total = int(sizes.sum())
    start = datetime(2026, 5, 4, 1 if plan.nights else int(rng.integers(24)), 7, tzinfo=UTC)
    is_spread = rng.random() < 0.5
    slots: list[Slot] = []
    before, last = 0, 0
    for number, size in enumerate(sizes):
        boot = number * plan.boots // plan.runs
        step = timedelta(minutes=3)
        if plan.nights:
            night = number * min(plan.runs, 10) // plan.runs
            at = datetime(2026, 5, 4, 1, 7, tzinfo=UTC) + timedelta(days=night, minutes=5 * (number % 40))
        else:
            if boot != last and is_spread:
                step = timedelta(hours=float(rng.uniform(1, 30)))
            start += step + timedelta(seconds=int(size) / 1000)
            at = start
        last = boot
        place = Place(
            run=number,
            runs=plan.runs,
            boot=boot,
            boots=plan.boots,
            hour=at.hour,
            before=before,
            total=total,
        )
        slots.append(Slot(number=number, board=boot % plan.boards, boot=boot, loops=int(size), start=at, place=place))
        before += int(size)
    return slots
