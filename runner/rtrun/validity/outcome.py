"""The outcome of a run, from the files that were fetched."""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtrun.plan import suites
from rtrun.plan.conditions import Background
from rtrun.plan.program import Exit, Program
from rtrun.plan.run import Run
from rtrun.results.gnuplot_log import Log, read_log
from rtrun.results.output import Record, SenderRecord
from rtrun.results.rate import OFF_MAX, is_missed
from rtrun.results.record import Observed, RunStatus, UnrelatedEnd
from rtrun.results.samples import read_samples
from rtrun.validity import baselines, requirements
from rtrun.validity.observations import (
    DISK_FULL,
    SAMPLER,
    SAMPLER_OUTPUT,
    Observation,
    observations_of,
    read_text,
    summarize,
    while_measuring,
)

LISTED_MAX = 1000  # The suites list at most this many indices of each kind.


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOutcome:
    """The status of a run, the reason for it, and what was in effect meanwhile."""

    status: RunStatus
    reason: str | None
    in_effect: Observed
    records: Mapping[str, Record]
    """The json of outputs, by output, as far as they were read."""
    heads: Mapping[str, Record | SenderRecord]
    """The json of each program, by its name."""
    unrelated_end: UnrelatedEnd | None = None
    """Why it is not ok, where that has nothing to do with lateness."""


def judge(
    folder: Path,
    run: Run,
    programs: Sequence[Program],
    exits: Sequence[Exit],
    outputs: Sequence[str],
    *,
    refused: Mapping[str, str],
    background: Sequence[Background],
    ended_early: Mapping[str, str],
    is_timed: bool = True,
) -> RunOutcome:
    """Determine the outcome of a run from the files in `folder`; the reason is the first thing that went wrong.

    `refused` has the files that were not taken, or not completely, with the reason; `ended_early` the background
    programs that ended before the run, with their exit status. `is_timed`: times are meaningful on the target, so a
    publisher that misses its rate makes the run invalid.
    """
    records: Mapping[str, Record] = {}
    observations: list[Observation] = []
    is_attached = run.subject.is_observed
    reason: str | None
    unrelated_end: UnrelatedEnd | None = None
    status, reason = _of_programs(folder, programs, exits) or (RunStatus.OK, None)
    if reason and (others := _said_by_others(folder, outputs)):
        reason = f"{reason}; {others}"
    if status is RunStatus.OK:
        records, failed = _of_outputs(folder, run, outputs, refused)
        status, reason = failed or (RunStatus.OK, None)
    senders, unreadable = _senders(folder, run, refused)
    heads = _by_writer(run, programs, outputs, records) | senders
    if status is RunStatus.OK and unreadable:
        status, reason = RunStatus.FAILED, unreadable
    if status in (RunStatus.OK, RunStatus.INCOMPLETE) and is_timed and (missed := _missed_rate(senders)):
        status, reason = RunStatus.INVALID, missed
    if status in (RunStatus.OK, RunStatus.INCOMPLETE) and (other := _other_middleware(run, heads)):
        status, reason, unrelated_end = RunStatus.INVALID, other, UnrelatedEnd.OTHER_SETUP
    try:
        observations = observations_of(folder)
        wrong = requirements.find_violation(run, background, observations, records)
    except UsageError as error:
        wrong = str(error)
    cut = refused.get(SAMPLER_OUTPUT)
    if is_disk_full := ended_early.get(SAMPLER) == DISK_FULL:
        cut = "the disk of the target was full (df -h)"
        ended_early = {name: exit_status for name, exit_status in ended_early.items() if name != SAMPLER}
    # An error in the part that was taken comes first: it says more than that the rest is unknown.
    unrelated: UnrelatedEnd | None = None
    if cut and (wrong is None or not while_measuring(observations, is_attached=is_attached)):
        wrong = f"nobody saw what was in effect to the end: {cut}"
        unrelated = UnrelatedEnd.DISK_FULL if is_disk_full else None
    if status in (RunStatus.OK, RunStatus.INCOMPLETE):
        if ended_early:
            name, exit_status = next(iter(ended_early.items()))
            how = (
                f"with exit status {exit_status}: {_last_word(folder, name)}" if exit_status else "killed from outside"
            )
            wrong, unrelated = f"condition {run.condition}: {name} ended in the middle of the run, {how}", None
        if wrong is not None:
            status, reason, unrelated_end = RunStatus.INVALID, wrong, unrelated
    states = requirements.measuring_threads(run, observations, records)
    in_effect = summarize(observations, states, is_attached=is_attached)
    return RunOutcome(
        status=status,
        reason=reason,
        in_effect=in_effect,
        records=records,
        heads=heads,
        unrelated_end=unrelated_end,
    )


def _by_writer(
    run: Run, programs: Sequence[Program], outputs: Sequence[str], records: Mapping[str, Record]
) -> dict[str, Record | SenderRecord]:
    """The json of outputs, by the program that wrote each."""
    alone = suites.suite(run.suite).program_json
    writers = [program.name for program in programs if program.name not in alone]
    named = zip(writers, outputs, strict=False)
    return {name: records[output] for name, output in named if output in records}


def _other_middleware(run: Run, heads: Mapping[str, Record | SenderRecord]) -> str | None:
    """Name a program that measured through another middleware than requested, or None."""
    for program, head in heads.items():
        if head.middleware != run.middleware:
            return f"{program}: asked for the middleware {run.middleware}, it measured through {head.middleware}"
    return None


def _senders(folder: Path, run: Run, refused: Mapping[str, str]) -> tuple[dict[str, SenderRecord], str | None]:
    """The json of programs without samples, by program, and why one cannot be read. The programs of 2014 wrote none."""
    senders: dict[str, SenderRecord] = {}
    for program, name in suites.program_json_names(run.suite, run.parameters).items():
        if name in refused:
            return senders, refused[name]
        try:
            if (folder / name).exists():
                senders[program] = read_json(folder / name, SenderRecord)
        except UsageError as error:
            return senders, str(error).replace(f"{folder}/", "")
    return senders, None


def _missed_rate(senders: Mapping[str, SenderRecord]) -> str | None:
    for program, sender in senders.items():
        if is_missed(sender.rate, sender.counts.sent):
            share = f"{100 * OFF_MAX:g} % at most"
            return f"{program}: {sender.rate.words}: off by {100 * sender.rate.off:.3g} %, {share} are allowed"
    return None


def _of_programs(folder: Path, programs: Sequence[Program], exits: Sequence[Exit]) -> tuple[RunStatus, str] | None:
    for program, exit_ in zip(programs, exits, strict=True):
        if exit_.expired:
            return RunStatus.FAILED, f"{program.name} did not end within {program.deadline_s:.0f} s and was ended"
        if exit_.status is None:
            return RunStatus.FAILED, f"{program.name} was killed from outside"
        if exit_.status != 0:
            return (
                RunStatus.FAILED,
                f"{program.name} ended with exit status {exit_.status}: {_last_word(folder, program.name)}",
            )
    return None


def _said_by_others(folder: Path, outputs: Sequence[str]) -> str | None:
    """Why a program that ended well stopped measuring when another one had failed."""
    for path in (folder / f"{output}.json" for output in outputs):
        with contextlib.suppress(UsageError):
            if path.exists() and (why := read_json(path, Record).incomplete_reason):
                return f"{path.stem}: {why}"
    return None


def _of_outputs(
    folder: Path, run: Run, outputs: Sequence[str], refused: Mapping[str, str]
) -> tuple[Mapping[str, Record], tuple[RunStatus, str] | None]:
    """The json of outputs, by output, up to the first one with an error, and that error."""
    records: dict[str, Record] = {}
    if suites.suite(run.suite).is_baseline:
        printed = f"{run.suite}.stdout"
        wrong = refused.get(printed) or baselines.check_baseline_output(run, read_text(folder / printed))
        return records, (RunStatus.INVALID, wrong) if wrong else None
    for output in outputs:
        names = (f"{output}.json", f"{output}.npy")
        if reasons := [why for name, why in refused.items() if name in names or _is_log(name, output)]:
            return records, (RunStatus.FAILED, reasons[0])
        missing = [name for name in names if not (folder / name).exists()]
        log_paths = [path for path in sorted(folder.glob("*.log")) if _is_log(path.name, output)]
        # The programs of 2014 write logs and nothing else.
        if missing and not (len(missing) == 2 and log_paths):
            return records, (
                RunStatus.FAILED,
                f"{missing[0]} is missing though its program ended with exit status 0",
            )
        status = RunStatus.FAILED
        try:
            logs = [read_log(path) for path in log_paths]
            if missing:
                if unseen := requirements.find_unseen_option(run, {}):
                    return records, (RunStatus.INVALID, f"{output}: {unseen}")
                continue
            record = records[output] = read_json(folder / names[0], Record)
            status = RunStatus.INVALID
            read_samples(folder / names[0], record)
        except UsageError as error:
            return records, (status, str(error).replace(f"{folder}/", ""))
        if wrong := _asked_otherwise(run, record) or find_count_mismatch(record, logs):
            return records, (RunStatus.INVALID, f"{output}: {wrong}")
        if not record.complete:
            reason = record.incomplete_reason or "ended before all was measured"
            return records, (RunStatus.INCOMPLETE, f"{output}: {reason}")
    return records, None


def find_count_mismatch(record: Record, logs: Iterable[Log] = ()) -> str | None:
    """What does not add up in a record and the logs beside it, or None.

    Each requested measurement was made, did not fire, or is missing; an incomplete record may have fewer (never more,
    as `read_samples` checks). A message that came twice was received once; the duplicate is counted separately.
    """
    counts = record.counts
    if record.complete and counts.known != counts.asked:
        return f"{counts.asked} asked for, but {counts.known} measured + not fired + missing"
    for kind, indices in record.indices:
        count = getattr(counts, kind)
        if len(indices) != min(count, LISTED_MAX):
            return f"{count} {kind.replace('_', ' ')}, but {len(indices)} indices of them"
        if any(index >= counts.asked for index in indices):
            return f"an index {kind.replace('_', ' ')} lies outside 0 to {counts.asked - 1}"
    for log in logs:
        if (n := int(log.count.sum())) != counts.measured:
            return f"{counts.measured} measured, but {n} in the log {log.path.name}"
    return None


def _asked_otherwise(run: Run, record: Record) -> str | None:
    """Name an option that the suite ignored or misread, or None."""
    understood = record.requested | {"repetitions": record.counts.asked}
    for name, asked in run.parameters.items():
        if name in understood and understood[name] != asked:
            return f"asked for {name} {asked}, the suite measured {name} {understood[name]}"
    held, allowed = record.in_effect.cpu_dma_latency_us, run.parameters.get("cpu_dma_latency_us")
    if held is not None and isinstance(allowed, int) and held > allowed:
        return f"asked for cpu_dma_latency_us {allowed}, in effect was {held}"
    return requirements.find_unseen_option(run, understood)


def _is_log(name: str, output: str) -> bool:
    return name.startswith(output) and name.endswith(".log")


def _last_word(folder: Path, program: str) -> str:
    stderr = read_text(folder / f"{program}.stderr")
    return next((line.strip()[:500] for line in reversed(stderr.splitlines()) if line.strip()), "it said nothing")
