"""The lines of a goal, while it is measured and at the end."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from rtrun.analysis.account import Account
from rtrun.analysis.deadline import Verdict, judge
from rtrun.analysis.order.stationarity import Change
from rtrun.analysis.standing import Standing
from rtrun.analysis.trials import count_misses
from rtrun.execution.goal import Progress
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.goal import Goal
from rtrun.plan.question import THESIS
from rtrun.report.standings import missing, progress_line, reasons, table

QUESTION = replace(THESIS, probability=1e-3, bursts=1)
GOAL = Goal(deadline="400us", probability="1e-3", at_most="1h")
(RUN,) = plan(Campaign(schema=1, name="test", runs=[{"suite": "cyclic_timer_tests"}]), "test")


def verdict_of(n: int) -> Verdict:
    trials = count_misses(np.full(n, 90_000), 400_000)
    return judge(Account([trials]), QUESTION)


def standing_of(verdict: Verdict, label: str = "timer RR") -> Standing:
    return Standing(label=label, runs=("001",), verdict=verdict, undecidable=None, measured_s=2.0)


def line_of(verdict: Verdict, left_s: float | None) -> str:
    return progress_line(Progress(group=RUN, standing=standing_of(verdict), left_s=left_s), GOAL)


CHANGED = replace(verdict_of(1000), change=Change(p_value=1e-9, significant=0.01, text="late values lie at the end"))


def test_a_line_says_how_far_a_group_is() -> None:
    assert line_of(verdict_of(1000), 75.0).endswith("; 1 000 measured; about 1 min 15 s left")
    assert line_of(verdict_of(1000), None).endswith("; no end in sight if misses stay as frequent")
    assert line_of(verdict_of(5000), None).startswith("PROVEN      timer RR: P(miss) <= ")
    assert "sight" not in line_of(verdict_of(5000), None)


def test_a_line_says_what_changed() -> None:
    assert line_of(CHANGED, None).endswith(
        "; no answer: the system changed while it was measured: late values lie at the end"
    )


def test_where_only_boots_are_missing_nothing_is_said_of_more_measurements() -> None:
    lacks_boots = judge(Account([count_misses(np.full(9000, 90_000), 400_000)]), replace(QUESTION, boots=3))
    assert missing(standing_of(lacks_boots)) == "2 more boots"


def test_what_is_no_number_stands_below_the_table() -> None:
    groups = [standing_of(CHANGED), standing_of(verdict_of(1000), "timer FIFO")]
    stream = io.StringIO()
    Console(file=stream, width=130).print(table(groups))
    changed, more = (line for line in stream.getvalue().splitlines() if "timer" in line)
    assert "NEEDS MORE" in changed and "0 of 1 000" in more
    below = list(reasons(groups))
    assert below[0] == "timer RR: no answer: the system changed while it was measured: late values lie at the end"
    assert below[1].startswith("timer FIFO: 2 688 more ")


def test_what_a_proof_holds_for_stands_below_the_table() -> None:
    assert list(reasons([standing_of(verdict_of(5000))])) == [
        "timer RR: holds on boots that were not recorded, if late values come singly"
    ]


@pytest.mark.parametrize("count", [1, 2])
def test_a_reason_is_said_once(count: int) -> None:
    refused = replace(CHANGED, refused="measured on an emulated board")
    groups = [standing_of(refused, f"timer {k}") for k in range(count)]
    about = "timer 0" if count == 1 else "all groups"
    assert list(reasons(groups)) == [f"{about}: measured on an emulated board"]
