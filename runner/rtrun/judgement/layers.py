"""Groups as layers upon one another: which layer of a middleware, or of the system below, each is.

Below a layer is the same measurement through the middleware below (`stands_on` of its file), or the kind of measurement
or the baseline below its own kind (`layer_below`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from rtrun.analysis.comparison.layers import Attribution, attribute
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.kinds.known import KINDS
from rtrun.kinds.lateness import JITTER
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.suites import is_real_time, kind_of, middleware_of, options, period_of, suite
from rtrun.targets.inspection.platform import Platform

# Parameters that belong to one layer; all others must be the same in both.
_OF_A_LAYER = {
    *("timeout_us", "interval_us", "frequency_hz", "busy_mode", "threads", "payload_bytes", "subscribers"),
    *("middleware", "start_delay_s", "cpu_dma_latency_us", "deepest_idle_state"),
}
# For one measurement through two middlewares, these must be the same, too.
_OF_A_MEASUREMENT = ("timeout_us", "frequency_hz", "payload_bytes", "subscribers")
UNLIKE_IDLE = (
    "idle CPUs were kept awake in one and not in the other; give both the same cpu_dma_latency_us, of which cyclictest "
    "has 0 by default and the suites none"
)


@dataclass(frozen=True, kw_only=True)
class LayerPair:
    """A layer, the one above it, and what the upper one adds; if this is not known, `attribution` says why."""

    below: Group
    above: Group
    attribution: Attribution


def layer_pairs(study: Study) -> tuple[LayerPair, ...]:
    """All pairs of groups that differ only in the layer; none for an emulated board, because its times say nothing."""
    differing = differing_in_layer(() if study.platform is Platform.EMULATED else study.groups)
    pairs = []
    for below, above in differing:
        if _kept_awake(below) == _kept_awake(above):
            attribution = attribute(
                below.blocks,
                above.blocks,
                late_above_ns=study.question.deadline_ns,
                confidence=study.question.confidence,
            )
        elif any(_kept_awake(below) == _kept_awake(other) for low, other in differing if low.key == below.key):
            continue
        else:
            attribution = Attribution(added=(), refused=UNLIKE_IDLE)
        pairs.append(LayerPair(below=below, above=above, attribution=attribution))
    return tuple(pairs)


def chains(pairs: Sequence[LayerPair]) -> tuple[tuple[LayerPair, ...], ...]:
    """The pairs whose difference is known, joined into chains, each from a lowest layer to a highest one."""
    known = [pair for pair in pairs if pair.attribution.added]

    def upward(group: Group) -> list[tuple[LayerPair, ...]]:
        found = [(pair, *rest) for pair in known if pair.below.key == group.key for rest in upward(pair.above)]
        return found or [()]

    upper = {pair.above.key for pair in known}
    lowest = {pair.below.key: pair.below for pair in known if pair.below.key not in upper}
    return tuple(chain for group in lowest.values() for chain in upward(group) if chain)


def differing_in_layer(groups: Sequence[Group]) -> list[tuple[Group, Group]]:
    """Pairs of a layer and one above it, from groups that are alike in all else."""
    measured = [group for group in groups if group.n]
    return [
        (below, above)
        for above in measured
        for below in measured
        if _is_layer_below(below, above) and _differ_in_layer_alone(below, above)
    ]


def _is_layer_below(below: Group, above: Group) -> bool:
    kind = kind_of(above.suite)
    if kind is None or JITTER in (above.measure, below.measure):
        return False
    over, under = (middleware_of(group.suite, group.parameters) for group in (above, below))
    stands_on = middlewares()[over].stands_on.get(suite(above.suite).kind or "", ())
    if kind_of(below.suite) is kind:
        return under in stands_on and all(
            below.parameters.get(key) == above.parameters.get(key) for key in _OF_A_MEASUREMENT
        )
    if kind.layer_below in KINDS:
        return kind_of(below.suite) is KINDS[kind.layer_below] and under == over and _is_one_event(above)
    # Below a middleware that stands on another one is that one, not the baseline.
    return below.suite == kind.layer_below and not stands_on and _is_one_event(above)


def _is_one_event(group: Group) -> bool:
    return all(group.parameters.get(key, 1) == 1 for key in ("subscribers", "threads"))


def _differ_in_layer_alone(low: Group, high: Group) -> bool:
    """Whether two groups with real-time policy are alike in all else: target, priority, condition, period."""
    periods_ns = [period_of(group.parameters) for group in (low, high)]
    alike = low.target == high.target and _others(low) == _others(high) and periods_ns[0] == periods_ns[1]
    means_known = all(digest.figures.mean_ns is not None for group in (low, high) for digest in group.digests)
    one_thread = low.parameters.get("threads", 1) == 1
    return alike and means_known and one_thread and is_real_time(high.parameters) and bool(low.blocks and high.blocks)


def _kept_awake(group: Group) -> object:
    """How idle CPUs were kept awake: the latency, and the deepest idle state; both are None if they were not."""
    return group.parameters.get("cpu_dma_latency_us"), group.parameters.get("deepest_idle_state")


def _others(group: Group) -> dict[str, object]:
    """Parameters that belong to both layers and are not the default (a suite without an option behaves as with its
    default)."""
    known = options()
    return {
        key: value
        for key, value in group.parameters.items()
        if key not in _OF_A_LAYER and value not in (None, "") and not (key in known and value == known[key].default)
    }
