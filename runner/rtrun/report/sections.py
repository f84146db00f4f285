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


def _culprits(of: ReportInput) -> Table:
    ranked, explained, refused = of.found
    table = causes.table(ranked, explained)
    return replace(table, notes=(*table.notes, *thresholds(of.study.records, of.judged), *refused))


def _late_paths(of: ReportInput) -> Table | None:
    return late_paths(of.study.source.folders)[0] if of.topologies else None


def _influence(of: ReportInput) -> Table | None:
    return influence.table(influences(of.study), of.study.question.confidence) if of.topologies else None


SECTIONS: tuple[Callable[[ReportInput], Table | None], ...] = (
    _culprits,
    lambda of: causes.step_table(of.found[1]),
    lambda of: tracing_cost(of.study),
    lambda of: hop_table(of.topologies),
    lambda of: bound_table(of.topologies),
    _late_paths,
    _influence,
    lambda of: causes.periods(of.study.source, of.judged)[0],
    lambda of: causes.surroundings(of.study.source, of.judged)[0],
    lambda of: hardware_gaps(of.study),
    lambda of: worst_cases(of.study),
    lambda of: ranking(of.study),
    lambda of: layers.table(of.pairs, of.study.question.confidence),
    lambda of: allocations(of.study),
    lambda of: environment_table(of.study),
    lambda of: reproduce(of.study),
)


def sections(of: ReportInput) -> tuple[Table, ...]:
    """The tables that have rows."""
    tables = (section(of) for section in SECTIONS)
    return tuple(printable_table(table) for table in tables if table is not None and table.rows)
