"""The programs on the target for one run: those of its subject, and those in the background."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rtrun.execution.preparation import Prepared
from rtrun.plan import conditions
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.program import Program


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectPrograms:
    """The programs of the subject of a run, and what they may write.

    `stages` are the programs of a suite in the order of their start: a stage starts when all programs before it are
    ready. `system` is the program that starts the user's system, to observe it. `outputs` names what a suite writes,
    without ending; `file_limits` are other files and their largest size, in bytes. `texts` are files that the programs
    read, by name: they are put into the folder of the run on the target. `need_one_another`: if one program of the
    suite fails, the others have nothing to do.
    """

    deadline_s: float
    stages: tuple[tuple[Program, ...], ...] = ()
    system: Program | None = None
    outputs: tuple[str, ...] = ()
    file_limits: Mapping[str, int] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    need_one_another: bool = False

    @property
    def measuring(self) -> tuple[Program, ...]:
        """The programs that start last; before them nothing is measured."""
        return self.stages[-1] if self.stages else ()

    @property
    def awaited(self) -> tuple[Program, ...]:
        """The programs that start earlier; without these the last ones have nothing to do."""
        return tuple(program for stage in self.stages[:-1] for program in stage)

    @property
    def of_suite(self) -> tuple[Program, ...]:
        """All programs of the suite."""
        return (*self.measuring, *self.awaited)

    @property
    def foreground(self) -> tuple[Program, ...]:
        """All of them."""
        return self.of_suite if self.system is None else (self.system,)

    @property
    def suite_names(self) -> list[str]:
        """The names of the suite's programs."""
        return [program.name for program in self.of_suite]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPrograms:
    """What runs on the target for one run."""

    subject: SubjectPrograms
    background: tuple[conditions.Background, ...]
    sampler: Program | None
    """Observes all programs; None: the campaign has switched it off."""
    file_limits: Mapping[str, int]
    """The files that the run may write, and the largest plausible size of each, in bytes."""

    @property
    def load_names(self) -> list[str]:
        """The names of the background programs that are loads."""
        return [load.program.name for load in self.background if load.is_load]

    @property
    def other_names(self) -> list[str]:
        """The names of the background programs that hold a setting, and of the sampler."""
        names = [entry.program.name for entry in self.background if not entry.is_load]
        return [*names, *([self.sampler.name] if self.sampler else [])]

    @property
    def names(self) -> list[str]:
        """The names of all programs."""
        return [*(program.name for program in self.subject.foreground), *self.load_names, *self.other_names]


def environment_of(prepared: Prepared, middleware: str) -> tuple[tuple[str, str], ...]:
    return middlewares()[middleware].environment_with(ros_master_port=prepared.link.target.master_port)
