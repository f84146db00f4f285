"""The table of results: readable on 80 columns, nothing cut off on 100."""

import io

import numpy as np
import pytest
from rich.console import Console

from rtrun.analysis.figures import Figures, figures
from rtrun.plan.suites import Value
from rtrun.report.terminal import EMULATED, NO_PREEMPT_RT, answer, table
from rtrun.results.reading import Result


def result(found: Figures, remarks: tuple[str, ...] = (), **parameters: Value) -> Result:
    return Result(
        suite="communication_tests",
        output="4ct_gnuplot_l2000000_fq10000_pl10000-tnRTFIFO",
        series="latency",
        parameters={
            "policy": "FIFO", "repetitions": 2_000_000, "frequency_hz": 10000, "payload_bytes": 10000,
            "start_delay_s": 1, "priority": 95, "cpu": "", **parameters,
        },
        figures=found,
        remarks=remarks,
    )  # fmt: skip


def drawn(what: object, width: int) -> list[str]:
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False).print(what, crop=False)
    return [line.rstrip() for line in stream.getvalue().splitlines()]


WIDE = figures(np.array([12_345_600, 99_999_400, 500_000_000]), missing=123456, out_of_order=1234)


@pytest.mark.parametrize("width", [80, 100])
def test_no_number_is_cut_off(width: int) -> None:
    lines = drawn(table([result(WIDE, subscribers=5, cpu="0-1")]), width)
    assert max(map(len, lines)) <= width
    text = " ".join(" ".join(lines).split())
    for number in ("12346", "204115", "500000", "123456", "1234"):
        assert number in text.split()
    assert "…" not in text


def test_numbers_stand_in_microseconds_with_the_digits_they_have() -> None:
    (row,) = drawn(table([result(figures(np.array([-40, 1_234_560, 50_000_000])))]), 100)[3:]
    assert row.split()[1:] == ["FIFO", "10000Hz", "10000B", "3", "0.0", "17078", "50000", "50000", "50000", "0", "0"]


def test_parameters_that_are_the_default_and_make_no_name_are_not_told() -> None:
    (row,) = drawn(table([result(WIDE, policy="0", clock="monotonic")]), 200)[3:]
    assert "OTHER 10000Hz 10000B clock=monotonic " in row
    (row,) = drawn(table([result(WIDE, subscribers=5)]), 200)[3:]
    assert "FIFO 10000Hz 10000B 5sub #4 " in row


def test_nothing_measured_is_a_dash_and_no_number() -> None:
    (row,) = drawn(table([result(figures(np.array([], dtype=np.int64), missing=5))]), 100)[3:]
    assert row.split()[4:] == ["0", "-", "-", "-", "-", "-", "5", "0"]


def test_the_answer_is_banner_table_and_what_has_to_be_said_once() -> None:
    remark = ("[red]incomplete[/red]: the publisher left",)
    lines = drawn(answer([result(WIDE, remark), result(WIDE, remark)], emulated=True, notes=["002: failed: x"]), 100)
    assert lines[0] == EMULATED
    assert lines[-3:] == [
        "002: failed: x",
        "4ct_gnuplot_l2000000_fq10000_pl10000-tnRTFIFO: [red]incomplete[/red]: the publisher left",
        "p99.9 of fewer than 1000 values is their maximum.",
    ]
    assert drawn(answer([result(WIDE)], emulated=False), 100)[0] != EMULATED
    assert drawn(answer([result(WIDE)], emulated=False, preempt_rt=False), 100)[0] == NO_PREEMPT_RT
    assert drawn(answer([result(WIDE)], emulated=True, preempt_rt=False), 100)[0] == f"{EMULATED}; {NO_PREEMPT_RT}"


def test_a_sentence_is_not_broken_where_a_program_reads_it() -> None:
    lines = drawn(answer([], emulated=False, notes=["word " * 60]), 100)
    assert len(lines) == 1


def test_a_target_does_not_command_the_terminal() -> None:
    lines = drawn(answer([result(WIDE, ("\x1b[2Jgone\nnew line",), cpu="\x1b]0;x\x07")], emulated=False), 200)
    assert lines[-2].endswith(": ?[2Jgone?new line")
    assert "cpu=?]0;x?" in lines[3]
