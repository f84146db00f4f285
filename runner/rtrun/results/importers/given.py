"""What the user states where the file does not: the unit of its numbers, and the interval."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from rtfiles.errors import UsageError
from rtrun.plan.quantities import time_text
from rtrun.results.importers.counts import NO_INTERVAL
from rtrun.results.importers.histogram_file import Imported
from rtrun.results.importers.samples_file import ImportedSamples

ImportedT = TypeVar("ImportedT", bound=Imported | ImportedSamples)
UNITS_NS = {"ns": 1, "us": 1000}


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """The unit in ns and the interval in us, from the options; None where the option is not given."""

    unit_ns: int | None = None
    interval_us: int | None = None

    def check(self, path: Path, *, unit_ns: int | None, period_ns: float | None) -> None:
        """Refuse a file that states other values; None: it states none. Raises UsageError that names both values."""
        if self.unit_ns and unit_ns and self.unit_ns != unit_ns:
            raise UsageError(f"{path}: its values are in {_unit(unit_ns)}, but --unit says {_unit(self.unit_ns)}")
        if self.interval_us and period_ns and 1000 * self.interval_us != period_ns:
            stated, given = time_text(round(period_ns)), time_text(1000 * self.interval_us)
            raise UsageError(f"{path}: its interval is {stated}, but --interval says {given}")

    def complete(self, path: Path, imported: ImportedT) -> ImportedT:
        """Return `imported`, with the interval where its file does not state it. Raises UsageError as `check` does."""
        self.check(path, unit_ns=imported.unit_ns, period_ns=imported.period_ns)
        if self.interval_us is None or imported.period_ns is not None:
            return imported
        return replace(
            imported,
            period_ns=1000.0 * self.interval_us,
            left_out=tuple(text for text in imported.left_out if text != NO_INTERVAL),
            parameters=imported.parameters | {"interval_us": self.interval_us},
        )


NOTHING_GIVEN = Given()


def _unit(unit_ns: int) -> str:
    return next(name for name, ns in UNITS_NS.items() if ns == unit_ns)
