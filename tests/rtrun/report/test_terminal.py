"""The table of results: readable on 80 columns, nothing cut off on 100."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from rtrun.analysis.figures import Figures, IndexedValue, figures_of_samples
from rtrun.plan.suites import Value
from rtrun.report.terminal import BANNERS, NO_PREEMPT_RT, PREEMPT_RT_IN_PART, answer, table
from rtrun.results.series import Header, Result
from rtrun.targets.inspection.platform import Platform


def result(figures: Figures, remarks: tuple[str, ...] = (), run: str = "001-x", **parameters: Value) -> Result:
    header = Header(
        run=run,
        suite="communication_tests",
        output="4ct_gnuplot_l2000000_fq10000_pl10000-tnRTFIFO",
        series="latency",
        parameters={
            "policy": "FIFO", "repetitions": 2_000_000, "frequency_hz": 10000, "payload_bytes": 10000,
            "start_delay_s": 1, "priority": 95, "cpu": "", **parameters,
        },
        missing=123456,
        out_of_order=1234,
        remarks=remarks,
    )  # fmt: skip
    return Result(header=header, figures=figures)


def drawn(what: object, width: int) -> list[str]:
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False).print(what, crop=False)
    return [line.rstrip() for line in stream.getvalue().splitlines()]


def rows_of(results: list[Result], width: int) -> list[str]:
    """What is below the headings."""
    lines = drawn(table(results), width)
    return lines[next(k for k, line in enumerate(lines) if line.startswith("─")) + 1 :]


WIDE = figures_of_samples(np.array([12_345_600, 99_999_400, 500_000_000]))


@pytest.mark.parametrize("width", [80, 100])
def test_no_number_is_cut_off(width: int) -> None:
    lines = drawn(table([result(WIDE, subscribers=5, cpu="0-1")]), width)
    assert max(map(len, lines)) <= width
    text = " ".join(" ".join(lines).split())
    for number in ("12346", "204115", "500000", "123456", "1234"):
        assert number in text.split()
    assert "…" not in text


def test_numbers_stand_in_microseconds_with_the_digits_they_have() -> None:
    (row,) = rows_of([result(figures_of_samples(np.array([-40, 1_234_560, 50_000_000])))], 100)
    assert row.split()[1:] == [
        "FIFO",
        "10000Hz",
        "10000B",
        "3",
        "0.0",
        "17078",
        "50000",
        "50000",
        "50000",
        "123456",
        "1234",
    ]


def test_parameters_that_are_the_default_and_make_no_name_are_not_told() -> None:
    (row,) = rows_of([result(WIDE, policy="0", clock="monotonic")], 200)
    assert "OTHER 10000Hz 10000B clock=monotonic " in row
    (row,) = rows_of([result(WIDE, subscribers=5)], 200)
    assert "FIFO 10000Hz 10000B 5sub #4 " in row


def test_nothing_measured_is_a_dash_and_no_number() -> None:
    (row,) = rows_of([result(figures_of_samples(np.array([], dtype=np.int64)))], 100)
    assert row.split()[4:] == ["0", "-", "-", "-", "-", "-", "123456", "1234"]


def test_the_answer_is_banner_table_and_what_has_to_be_said_once() -> None:
    remark = ("[red]incomplete[/red]: the publisher left",)
    lines = drawn(
        answer([result(WIDE, remark), result(WIDE, remark)], platform=Platform.EMULATED, notes=["002: failed: x"]), 100
    )
    assert lines[0] == BANNERS[Platform.EMULATED]
    assert lines[-3:] == [
        "002: failed: x",
        "4ct_gnuplot_l2000000_fq10000_pl10000-tnRTFIFO: [red]incomplete[/red]: the publisher left",
        "p99.9 of fewer than 1000 values is their maximum.",
    ]

    def banner(platform: Platform, *preempt_rt: bool) -> str:
        return drawn(answer([result(WIDE)], platform=platform, preempt_rt=preempt_rt), 100)[0]

    emulated = "EMULATED: not a real-time statement"
    assert banner(Platform.VIRTUAL) == "VIRTUAL: verdicts are for this virtual machine on this host"
    assert not any(word in banner(Platform.HARDWARE) for word in ("HARDWARE", "VIRTUAL", "EMULATED"))
    assert banner(Platform.HARDWARE, True, True) == banner(Platform.HARDWARE)
    assert banner(Platform.HARDWARE, False, False) == NO_PREEMPT_RT
    assert banner(Platform.EMULATED, False) == f"{emulated}; {NO_PREEMPT_RT}"
    assert banner(Platform.HARDWARE, True, False) == PREEMPT_RT_IN_PART


def test_a_sentence_is_not_broken_where_a_program_reads_it() -> None:
    lines = drawn(answer([], platform=Platform.HARDWARE, notes=["word " * 60]), 100)
    assert len(lines) == 1


def test_a_target_does_not_command_the_terminal() -> None:
    lines = drawn(
        answer([result(WIDE, ("\x1b[2Jgone\nnew line",), cpu="\x1b]0;x\x07")], platform=Platform.HARDWARE), 200
    )
    assert lines[-2].endswith(": ?[2Jgone?new line")
    assert "cpu=?]0;x?" in lines[-3]


def test_runs_of_the_same_parameters_are_told_apart_by_their_number() -> None:
    rows = rows_of([result(WIDE, run=name) for name in ("003-x-FIFO", "007-x-FIFO", "imported")], 200)
    assert [re.search(r"10000B (run=\S+)", row)[1] for row in rows] == ["run=003", "run=007", "run=imported"]
    rows = rows_of([result(WIDE, run=name) for name in ("003-x-FIFO", "003-x-FIFO-r2", "003-x-FIFO-r13")], 200)
    assert [re.search(r"10000B (run=\S+)", row)[1] for row in rows] == ["run=003", "run=003-r2", "run=003-r13"]
    rows = rows_of([result(WIDE, run="003-x"), result(WIDE, run="007-x", cpu="1")], 200)
    assert not any("run=" in row for row in rows)


def test_threads_of_one_run_are_told_apart_by_the_end_of_their_output() -> None:
    wide = result(WIDE)
    threads = [replace(wide, header=replace(wide.header, output=f"cyclictest_l10-t{k}")) for k in (0, 1)]
    assert [row.split()[4] for row in rows_of(threads, 200)] == ["#t0", "#t1"]


def test_start_up_values_of_many_outputs_are_one_line_a_series() -> None:
    def started(value_ns: int, series: str) -> Result:
        startup = (IndexedValue(value_ns=value_ns, index=0),)
        return replace(result(WIDE), header=replace(result(WIDE).header, series=series, startup=startup))

    results = [started(538_000, "latency"), started(541_500, "latency"), started(9000, "jitter")]
    lines = [line for line in drawn(answer(results, platform=Platform.HARDWARE), 200) if "start-up" in line]
    assert lines == [
        "latency start-up of 2 outputs apart, in no figure: 538 us to 541.5 us",
        f"{results[2].header.output}: jitter start-up apart, in no figure: 9 us (loop 0)",
    ]


def test_one_timer_is_not_many() -> None:
    wide = result(WIDE)
    lines = drawn(answer([replace(wide, header=replace(wide.header, not_fired=1))], platform=Platform.HARDWARE), 200)
    assert [line.partition(": ")[2] for line in lines if "timer" in line] == [
        "1 timer did not fire, it is in no figure"
    ]


def test_messages_that_came_again_are_told() -> None:
    wide = result(WIDE)
    lines = drawn(answer([replace(wide, header=replace(wide.header, duplicate=3))], platform=Platform.HARDWARE), 200)
    assert any(line.endswith(": 3 messages came again, only the first arrival counts") for line in lines)
