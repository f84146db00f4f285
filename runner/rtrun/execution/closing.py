"""Close a run that has ended on its target: download its files, judge them, and write its record."""

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rtfiles.untrusted import MIB, read_end
from rtrun.execution import clock_record, download, observed_runs, stream_runs
from rtrun.execution.active_run import ActiveRun, Clock, RunEnd
from rtrun.execution.observation import ObservationResult
from rtrun.execution.resumption import Attempt
from rtrun.execution.subjects.known import subject_of
from rtrun.execution.subjects.subject import Closing
from rtrun.plan import suites
from rtrun.plan.program import Exit
from rtrun.results import run_directory
from rtrun.results.output import Record, SenderRecord
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus, TargetFacts
from rtrun.targets import building
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import control_groups
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection.control_groups import ControlGroup
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.link import Interrupted
from rtrun.validity import baselines, requirements
from rtrun.validity.outcome import RunOutcome, judge

CONSOLE_LIMIT_BYTES = 16 * MIB  #: the end of the console of a board in QEMU, which may print without end
# Facts of a target that run.json takes from its state under the same names.
STATED = ("kernel_release", "kernel_version", "machine", "boot_id", "clocksource", "governor")


def close(
    work: ActiveRun,
    attempt: Attempt,
    end: RunEnd,
    observed: ObservationResult | None,
    now: Clock,
    troubles: Sequence[str] = (),
) -> RunRecord:
    """Fill the directory of a run that has ended on the target, and return its closing record.

    Streams that were observed, or went through a topology, become further runs next to it. `troubles` are problems with
    the target after something was observed. Raises TargetError when the target does not deliver its files; if something
    was observed, it is kept without them instead.
    """
    run = work.run
    if observed is not None:
        observed_runs.free_first_half(work.folder)
    with contextlib.ExitStack() as stack:
        place = work.folder
        if run.subject.makes_streams:
            # Its streams are runs, too: either all of these runs get their folders, or none.
            staged = stack.enter_context(run_directory.all_or_none(place.parent, place.name))
            stream_runs.put_aside(place)
            place = staged / place.name
        partial = stack.enter_context(run_directory.filling(place))
        try:
            refused = _download(work, partial, attempt, end)
        except (TargetError, Interrupted) as error:
            if observed is None:
                raise
            refused = dict.fromkeys(end.files, f"not taken: {error}")
            troubles = [*troubles, str(error)]
        verdict = _judge(work, partial, attempt, end, refused)
        record = _record(work, partial, attempt, end, refused, verdict, now)
        closing = Closing(
            work=work,
            partial=partial,
            place=place,
            before=attempt.before,
            observed=observed,
            troubles=troubles,
        )
        record = subject_of(run).close(closing, record)
        run_directory.close(partial, place, record)
    return record


def _download(work: ActiveRun, partial: Path, attempt: Attempt, end: RunEnd) -> dict[str, str]:
    """Fill a run directory; return the files that were not taken, name to reason."""
    if work.prepared.kernel_config:
        (partial / "kernel.config.gz").write_bytes(work.prepared.kernel_config)
    before, after = attempt.before.model_dump(), end.after.model_dump()
    states = {"schema": 1, "before": before, "after": after, "own_service": attempt.own_service}
    (partial / "target.json").write_text(json.dumps(states, indent=2) + "\n", encoding="utf-8")
    console = work.link.target.console
    if console is not None and console.exists():
        (partial / "console.log").write_bytes(read_end(console, max_bytes=CONSOLE_LIMIT_BYTES))
    return download.pull(work.link, work.remote, end.files, partial, work.programs.file_limits)


def _judge(work: ActiveRun, partial: Path, attempt: Attempt, end: RunEnd, refused: Mapping[str, str]) -> RunOutcome:
    verdict = judge(
        partial,
        work.run,
        work.programs.subject.of_suite,
        end.exits if work.programs.subject.of_suite else (),
        work.programs.subject.outputs,
        refused=refused,
        background=work.programs.background,
        ended_early=end.ended_early,
        is_timed=work.prepared.platform.platform is not Platform.EMULATED,
    )
    if end.failure:
        return replace(verdict, status=RunStatus.FAILED, reason=end.failure, unrelated_end=None)
    if work.service and end.service != attempt.service:
        reason = f"{work.service.name} died during the run" + (f"; {verdict.reason}" if verdict.reason else "")
        return replace(verdict, status=RunStatus.FAILED, reason=reason, unrelated_end=None)
    return verdict


def _take_control_groups(path: Path) -> list[ControlGroup]:
    """Take the control groups of a program from their file, which is not kept: the record has the same content."""
    if not path.is_file():
        return []
    text = path.read_bytes().decode("utf-8", errors="replace")
    path.unlink()
    return control_groups.parse_around(text)


def _program_record(
    partial: Path, name: str, argv: list[str], exit_: Exit, head: Record | SenderRecord | None
) -> ProgramRecord:
    return ProgramRecord(
        name=name,
        argv=argv,
        exit_status=exit_.status,
        control_groups=_take_control_groups(partial / f"{name}.cgroups"),
        rate=head.rate if head else None,
        costs=head.costs if head else None,
        loops=head.counts.loops if head else None,
    )


def _built_with(work: ActiveRun) -> dict[str, Any]:
    """The target's fact about what the suites were built with, if they were built there."""
    built = f"{work.link.target.work_dir / building.BUILT}/"
    used = any(program.argv[0].startswith(built) for program in work.programs.subject.foreground)
    return {"suites_built_with": dict(work.prepared.equipment.built_with)} if used else {}


def _record(
    work: ActiveRun,
    partial: Path,
    attempt: Attempt,
    end: RunEnd,
    refused: Mapping[str, str],
    verdict: RunOutcome,
    now: Clock,
) -> RunRecord:
    run, target = work.run, work.link.target
    outputs = list(work.programs.subject.outputs)
    if suites.suite(run.suite).is_baseline and verdict.status is RunStatus.OK:
        outputs = baselines.keep_histograms(partial, run, suites.output_name(run.suite, run.parameters))
    record = RunRecord(
        schema=2,
        run=run.name,
        campaign=work.campaign,
        attempt=attempt.uid,
        suite=run.suite,
        subject=suites.suite(run.suite).subject,
        parameters=dict(run.parameters),
        condition=run.condition,
        settings=dict(run.settings),
        repeat=run.repeat,
        seed=run.seed,
        variant=run.variant,
        kernel=run.kernel,
        trace=run.trace,
        platform=work.prepared.platform.platform,
        platform_evidence=work.prepared.platform.evidence,
        status=verdict.status,
        reason=verdict.reason,
        requested=requirements.requested(run, work.programs.background),
        in_effect=verdict.in_effect,
        start_time=attempt.start_time,
        end_time=now().isoformat(),
        programs=[
            _program_record(partial, program.name, attempt.argv[program.name], exit_, verdict.heads.get(program.name))
            for program, exit_ in zip(work.programs.subject.foreground, end.exits, strict=True)
        ],
        outputs=outputs,
        refused=dict(refused),
        target=TargetFacts(
            name=target.place or target.name,
            address=str(target.address),
            preempt_rt=inspection.is_preempt_rt(attempt.before),
            cpus=work.prepared.equipment.cpus,
            clock=clock_record.record(attempt.before, clock_record.steps_seen(partial, outputs, verdict.records)),
            setup=work.setup,
            **_built_with(work),
            middleware_version=work.prepared.equipment.installed(run.middleware).version,
            **{name: getattr(attempt.before, name) for name in STATED},
        ),
        files={},
    )
    return record.model_copy(update={"unrelated_end": verdict.unrelated_end}) if verdict.unrelated_end else record
