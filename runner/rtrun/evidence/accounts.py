"""The account of a group of runs: their trials, the run, boot and board of each, lost attempts, and time not seen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rtrun.analysis.account import Account
from rtrun.analysis.trials import Trials
from rtrun.evidence.attempts import LostAttempt, kind_of
from rtrun.evidence.hours import hours_measured
from rtrun.evidence.time_seen import time_seen
from rtrun.results.record import RunRecord
from rtrun.results.series import Header
from rtrun.targets.inspection.platform import Platform


def take_account(
    outputs: Sequence[tuple[Header, Trials]], records: Mapping[str, RunRecord], lost: Sequence[LostAttempt]
) -> Account:
    """The account of at least one output of runs of one kind. `records` are by run; `lost` is for the whole folder."""
    headers = [header for header, _ in outputs]
    kinds = {kind_of(header.target, header.suite, header.parameters) for header in headers}
    of_runs = [records[run] for run in dict.fromkeys(header.run for header in headers) if run in records]
    seen = time_seen(of_runs)
    periods = [header.period_ns for header in headers if header.period_ns]
    # Subscribers of one run receive the same messages; threads of cyclictest wait for the same interrupts.
    side_by_side = len(headers) / len({header.run for header in headers})
    return Account(
        tuple(_located(trials, header.run, records.get(header.run)) for header, trials in outputs),
        period_ns=sum(periods) / len(periods) / side_by_side if periods else None,
        clock_step_ns=clock_step_ns(headers),
        emulated=headers[0].platform is Platform.EMULATED,
        side_by_side=side_by_side,
        lost=tuple(str(attempt) for attempt in lost if attempt.may_be_of(kinds)),
        unseen_share=seen.unseen_share,
        hidden_share=seen.hidden_share,
        hours=hours_measured(of_runs),
    )


def clock_step_ns(headers: Sequence[Header]) -> int | None:
    """The widest clock step of these measurements; None if none is known."""
    return max((header.clock_step_ns for header in headers if header.clock_step_ns), default=None)


def _located(trials: Trials, run: str, record: RunRecord | None) -> Trials:
    """The trials with their run, boot, board and time."""
    if record is None:
        return replace(trials, run=run)
    boot = str(record.target.boot_id or "")
    return replace(trials, run=run, boot=boot, board=record.target.name, start_time=record.start_time)
