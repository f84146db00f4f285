"""The sections after the scenarios of a report, in their order: each is a table of what was examined, or nothing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from rtrun.judgement.influence import influences
from rtrun.judgement.layers import LayerPair
from rtrun.judgement.study import Study
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.kinds.lateness import LATENESS, Measure
from rtrun.report import causes, influence, layers
from rtrun.report.hardware_gaps import hardware_gaps
from rtrun.report.late_paths import late_paths
from rtrun.report.ranking import ranking
from rtrun.report.run_facts import allocations, environment_table, reproduce
from rtrun.report.tables import Table, printable_table
from rtrun.report.topology_tables import bound_table, hop_table
from rtrun.report.tracing_cost import thresholds, tracing_cost
from rtrun.report.worst_cases import worst_cases


@dataclass(frozen=True, kw_only=True)
class ReportInput:
    """A study, with the pairs of its layers, the findings in its traces, and the measured topologies."""

    study: Study
    pairs: Sequence[LayerPair]
    found: causes.Found
    topologies: Sequence[MeasuredTopology]

    @property
    def judged(self) -> Measure:
        """The series that is judged; whatever a suite measures may be late."""
        return self.study.question.of or LATENESS


def _culprits(inputs: ReportInput) -> Table:
    ranked, explained, refused = inputs.found
    table = causes.table(ranked, explained)
    return replace(table, notes=(*table.notes, *thresholds(inputs.study.records, inputs.judged), *refused))


def _late_paths(inputs: ReportInput) -> Table | None:
    return late_paths(inputs.study.source.folders)[0] if inputs.topologies else None


def _influence(inputs: ReportInput) -> Table | None:
    return influence.table(influences(inputs.study), inputs.study.question.confidence) if inputs.topologies else None


SECTIONS: tuple[Callable[[ReportInput], Table | None], ...] = (
    _culprits,
    lambda inputs: causes.step_table(inputs.found[1]),
    lambda inputs: tracing_cost(inputs.study),
    lambda inputs: hop_table(inputs.topologies),
    lambda inputs: bound_table(inputs.topologies),
    _late_paths,
    _influence,
    lambda inputs: causes.periods(inputs.study.source, inputs.judged)[0],
    lambda inputs: causes.surroundings(inputs.study.source, inputs.judged)[0],
    lambda inputs: hardware_gaps(inputs.study),
    lambda inputs: worst_cases(inputs.study),
    lambda inputs: ranking(inputs.study),
    lambda inputs: layers.table(inputs.pairs, inputs.study.question.confidence),
    lambda inputs: allocations(inputs.study),
    lambda inputs: environment_table(inputs.study),
    lambda inputs: reproduce(inputs.study),
)


def sections(inputs: ReportInput) -> tuple[Table, ...]:
    """The tables that have rows."""
    tables = (section(inputs) for section in SECTIONS)
    return tuple(printable_table(table) for table in tables if table is not None and table.rows)
