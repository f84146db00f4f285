"""The evidence for one deadline: what is known about runs of one kind, and what is known to be missing.

`deadline.judge` answers from the account alone. `rtrun.evidence` makes it from a folder of runs.
"""

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

from rtrun.analysis.order.startup import LeftOut
from rtrun.analysis.trials import Trials

HOURS = 24  # of a day


@dataclass(frozen=True, slots=True)
class Account:
    """Runs of one set of parameters, how they were measured, and what was attempted beside them.

    `side_by_side` outputs measure the same event, as the subscribers of one message do. Their values count as one, and
    `period_ns` is the period of one stream divided by their number. `lost` has a sentence for each attempt that gave
    nothing to judge. `unseen_share` is the share of an observation's time that was not seen, `hidden_share` the share
    that was not seen because of load.
    """

    runs: Sequence[Trials]
    _: KW_ONLY
    period_ns: float | None = None
    clock_step_ns: int | None = None
    emulated: bool = False
    side_by_side: float = 1.0
    lost: tuple[str, ...] = ()
    unseen_share: float = 0.0
    hidden_share: float = 0.0
    hours: int | None = None
    """How many hours of the day these runs were measured in; None if not known."""
    startup: LeftOut | None = None
    """The first loops of each run, which the trials leave out."""

    @property
    def measurements_per_event(self) -> int:
        """How many measurements of one event count as one."""
        return math.ceil(self.side_by_side)

    @property
    def stream_ns(self) -> float | None:
        """The period of one stream."""
        return None if self.period_ns is None else self.period_ns * self.side_by_side

    @property
    def boards(self) -> int:
        """The boards that were measured."""
        return len({run.board for run in self.runs})

    @property
    def boots(self) -> int | None:
        """The boots that were measured; None where one is not known."""
        return len({run.boot for run in self.runs}) if all(run.boot for run in self.runs) else None

    @property
    def boots_known(self) -> int:
        """How many boots are known. Runs of unknown boots do not count; if no boot is known, they count as one boot."""
        return len({run.boot for run in self.runs if run.boot}) or 1

    @property
    def measured(self) -> int:
        """The runs that were measured, each once, however many outputs it has."""
        return len({run.run or str(index) for index, run in enumerate(self.runs)})

    @property
    def unit(self) -> Literal["boot", "run"]:
        """The unit in which attempts are counted: boots if there are several, else runs."""
        return "boot" if self.boots is not None and self.boots > 1 else "run"

    @property
    def units(self) -> int:
        """How many boots or runs (`unit`) were measured."""
        return self.boots_known if self.unit == "boot" else self.measured
