"""What independent nodes add to the times along the paths of a topology, from runs with and without them in turn."""

from collections.abc import Sequence
from dataclasses import dataclass

from rtrun.analysis.comparison.layers import INFLUENCE_QUANTILES, Attribution, attribute
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.kinds.known import STREAMS
from rtrun.plan.topology.others import OTHER_NODES

_SUITES = frozenset(kind.suite for kind in STREAMS.values() if kind.is_of_paths)


@dataclass(frozen=True, kw_only=True)
class Influence:
    """A path alone, the same path beside other nodes, and what those nodes add to its times."""

    alone: Group
    beside: Group
    attribution: Attribution

    @property
    def other_nodes(self) -> str:
        """The other nodes, in words."""
        return str(self.beside.parameters[OTHER_NODES])


def influences(study: Study) -> tuple[Influence, ...]:
    """Every path that was measured alone, and beside others."""
    of_paths = [group for group in study.groups if group.suite in _SUITES and group.blocks]
    return tuple(
        Influence(alone=alone, beside=beside, attribution=_attribution(alone, beside, study.question.confidence))
        for alone in of_paths
        if not alone.parameters.get(OTHER_NODES)
        for beside in of_paths
        if beside.parameters.get(OTHER_NODES) and _is_same_path(alone, beside)
    )


def _is_same_path(alone: Group, beside: Group) -> bool:
    return (
        alone.suite == beside.suite
        and alone.target == beside.target
        and _others_left_out(alone) == _others_left_out(beside)
    )


def _others_left_out(group: Group) -> dict[str, object]:
    return {key: value for key, value in group.parameters.items() if key != OTHER_NODES}


def _attribution(alone: Group, beside: Group, confidence: float) -> Attribution:
    return attribute(
        alone.blocks,
        beside.blocks,
        late_above_ns=alone.question.deadline_ns if alone.question else None,
        confidence=confidence,
        quantiles=INFLUENCE_QUANTILES,
    )


def alone_of(found: Sequence[Influence]) -> tuple[Group, ...]:
    """The paths alone, each once, in their order."""
    return tuple({influence.alone.key: influence.alone for influence in found}.values())
