"""What each subject of a run defines: its programs, how to start and await them, and what is kept."""

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
    """Errors after something was observed. The observation is kept first, whatever happens."""

    observed: ObservationResult | None = None
    """None: nothing is observed, and every error is raised at once."""
    is_attended: bool = False
    troubles: list[str] = field(default_factory=list)
    """Problems with the target."""
    cut_off: BaseException | None = None
    """An error that ends more than this run; raised once the run is kept."""

    def deferring(self) -> AbstractContextManager[None]:
        """If something was observed, let the first Ctrl-C wait for the end of the context."""
        return deferred(KEPT_FIRST) if self.observed else contextlib.nullcontext()

    @contextlib.contextmanager
    def keeping(self) -> Iterator[None]:
        """Record trouble, Ctrl-C or a defect of ours instead of raising it."""
        try:
            with self.deferring():
                yield
        except (KeyboardInterrupt, Exception) as error:
            if self.observed is None:
                raise
            match error:
                case KeyboardInterrupt():
                    self.cut_off = error
                case InfrastructureError():
                    self.troubles.append(str(error))
                    # An attending user has seen the restart, and waits for nothing more.
                    if isinstance(error, TargetRebooted) and not self.is_attended:
                        self.cut_off = self.cut_off or error
                case _:
                    self.troubles.append(defect_in_words(error))
                    self.cut_off = self.cut_off or error


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringEnd:
    """How the measuring ended: the exits of the programs, why it failed if it did, and the service at that time."""

    exits: Sequence[Exit] = ()
    failure: str | None = None
    service: str = ""
    aftermath: Aftermath = field(default_factory=Aftermath)


@dataclass(frozen=True, slots=True, kw_only=True)
class Closing:
    """A run that is being closed: `partial` is filled and then becomes `place`.

    `before` is the state of the target before the run. `troubles` are problems with the target after something was
    observed.
    """

    work: ActiveRun
    partial: Path
    place: Path
    before: TargetState
    observed: ObservationResult | None
    troubles: Sequence[str]


class SubjectModule(Protocol):
    """What each module of a subject provides."""

    def plan(self, prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> SubjectPrograms:
        """The programs of the subject in the folder `remote` on the target; `token` is unique to one attempt."""

    def start(self, work: ActiveRun, life: RunLife, start_background: Callable[[], None]) -> str | None:
        """Start the programs and what the condition asks for; return why measuring did not start, if so."""

    def wait(self, work: ActiveRun, life: RunLife, not_started: str | None, now: Clock) -> MeasuringEnd:
        """Wait until the run is measured."""

    def close(self, closing: Closing, record: RunRecord) -> RunRecord:
        """Keep what the run has measured; return its closing record."""
