"""What each subject of a run answers: its programs, how they start, how they are waited for, what is kept of them."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Protocol

from rtfiles.errors import InfrastructureError
from rtfiles.interruption import deferred
from rtrun.execution.active_run import ActiveRun, Clock
from rtrun.execution.observation import KEPT_FIRST, ObservationResult, defect_in_words
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import SubjectPrograms
from rtrun.plan.program import Exit
from rtrun.plan.run import Run
from rtrun.results.record import RunRecord
from rtrun.results.run_state import RunLife
from rtrun.targets.inspection.facts import TargetState
from rtrun.targets.link import TargetRebooted


@dataclass(slots=True, kw_only=True)
class Aftermath:
    """What comes after something was observed, which is kept first, whatever comes."""

    observed: ObservationResult | None = None
    """None: nothing is observed, and whatever comes is raised at once."""
    is_attended: bool = False
    troubles: list[str] = field(default_factory=list)
    """With the target."""
    cut_off: BaseException | None = None
    """What ends more than this run: raised once it is kept."""

    def deferring(self) -> AbstractContextManager[None]:
        """Where something was observed, let the first Ctrl-C wait for the end of the context."""
        return deferred(KEPT_FIRST) if self.observed else contextlib.nullcontext()

    @contextlib.contextmanager
    def keeping(self) -> Iterator[None]:
        """Note trouble, Ctrl-C or a defect of ours instead of raising it."""
        try:
            with self.deferring():
                yield
        except KeyboardInterrupt as error:
            if self.observed is None:
                raise
            self.cut_off = error
        except InfrastructureError as error:
            if self.observed is None:
                raise
            self.troubles.append(str(error))
            # Who sits before it has seen that, and waits for nothing more.
            if isinstance(error, TargetRebooted) and not self.is_attended:
                self.cut_off = self.cut_off or error
        except Exception as error:
            if self.observed is None:
                raise
            self.troubles.append(defect_in_words(error))
            self.cut_off = self.cut_off or error


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringEnd:
    """What came of the measuring: how the programs ended, why they were ended early, if so, the service then."""

    exits: Sequence[Exit] = ()
    failure: str | None = None
    service: str = ""
    aftermath: Aftermath = field(default_factory=Aftermath)


@dataclass(frozen=True, slots=True, kw_only=True)
class Closing:
    """A run that is closed: `partial` is filled for `place`. `before` is the state of the target before it.

    `troubles` with the target are those that came after something was observed.
    """

    work: ActiveRun
    partial: Path
    place: Path
    before: TargetState
    observed: ObservationResult | None
    troubles: Sequence[str]


class SubjectModule(Protocol):
    """A module of this room."""

    def plan(self, prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> SubjectPrograms:
        """Its programs in the folder `remote` on the target; `token` is unique to one attempt."""

    def start(self, work: ActiveRun, life: RunLife, start_background: Callable[[], None]) -> str | None:
        """Start them, and what the condition asks for; return why what measures was not started, if so."""

    def wait(self, work: ActiveRun, life: RunLife, not_started: str | None, now: Clock) -> MeasuringEnd:
        """Wait until it is measured."""

    def close(self, closing: Closing, record: RunRecord) -> RunRecord:
        """Keep what the run has measured; return the record that it is to be closed with."""
