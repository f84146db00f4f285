"""A run while it is measured: where it is measured, where it is kept, and how it ended on the target."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath

from rtrun.execution.middleware.known import SERVICES
from rtrun.execution.middleware.service import Service
from rtrun.execution.observation import Onlooker
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import RunPrograms
from rtrun.plan.program import Exit
from rtrun.plan.run import Run
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import Link

Clock = Callable[[], datetime]


@dataclass(frozen=True, slots=True, kw_only=True)
class ActiveRun:
    """One run, where it is measured and where it is kept."""

    prepared: Prepared
    campaign: str
    run: Run
    folder: Path
    remote: PurePosixPath
    programs: RunPrograms
    token: str
    onlooker: Onlooker

    @property
    def link(self) -> Link:
        return self.prepared.link

    @property
    def service(self) -> Service | None:
        """The service that its middleware needs in addition to the programs; None: it needs none."""
        return SERVICES.get(self.run.middleware)

    def service_identity(self) -> str:
        """The identity of its middleware's service as it runs now; empty: it needs none, or it does not run."""
        return (self.service.identity(self.link) if self.service else None) or ""

    @property
    def measuring(self) -> list[str]:
        """The names of the programs that measure: once they run, the target continues on its own."""
        return [program.name for program in self.programs.subject.measuring]

    @property
    def setup(self) -> str | None:
        """The shell file that sets up what its programs need."""
        if self.programs.subject.system is not None:
            return self.prepared.setup or self.link.target.setup
        return self.prepared.setup_of(self.run.middleware)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEnd:
    """How a run ended on the target."""

    failure: str | None
    """Why the measuring programs were not started, or were ended; None: neither happened."""
    exits: Sequence[Exit]
    ended_early: Mapping[str, str]
    """Background programs that ended before the suite, name to exit status."""
    service: str
    """The identity of its middleware's service; empty: it needs none, or the service has died."""
    after: inspection.TargetState
    """State of the target."""
    files: Mapping[str, int]
    """The files that the run left in its folder on the target, name to size in bytes."""
