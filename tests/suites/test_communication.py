"""communication_tests on a real ROS master: messages that come, that do not, and publishers that die."""

import json
import re
import signal
import subprocess

import numpy as np
import pytest

from .conftest import (
    Bench,
    check_outputs,
    check_that_skipped_periods_make_up_the_time,
    defaults_of,
    end,
    is_measuring,
    launch,
    wait_until,
)

pytestmark = pytest.mark.ros


def test_defaults(bench: Bench) -> None:
    receiver, sender = bench.communicate("-r", "500")
    assert (sender.status, sender.out, sender.err) == (0, "\tINFO: Done publishing...\n", "")
    assert (receiver.status, receiver.err) == (0, "")
    base = "ct_gnuplot_l500_fq1000_pl0"
    assert bench.files() == sorted([f"{base}-publisher.json", f"{base}.json", f"{base}.log", f"{base}.npy"])
    expected = [
        "\tINFO: Measurement results:",
        "\tINFO: Amount messages: 500; Messages out of order: 0",
        "\tINFO: MIN: ",
        "\tINFO: Indices of top values(|latency:index|): |",
        "\tINFO: Indices of lowest values(|latency:index|): |",
    ]
    assert [line[: len(start)] for line, start in zip(receiver.lines, expected, strict=False)] == expected
    record = check_outputs(bench.folder, base)
    assert record["complete"] is True
    assert record["counts"]["measured"] + record["counts"]["missing"] == 500
    rows = np.load(bench.folder / f"{base}.npy")
    assert sorted(rows[:, 2]) == sorted(set(range(500)) - set(record["indices"]["missing"]))
    sent = json.loads((bench.folder / f"{base}-publisher.json").read_text())
    assert (sent["complete"], sent["counts"]) == (True, {"asked": 500, "sent": 500})
    # Each message was sent when its stamp says.
    achieved_hz = pytest.approx(499e9 / (rows[:, 0].max() - rows[:, 0].min()), rel=1e-6)
    assert (sent["rate"]["asked_hz"], sent["rate"]["achieved_hz"]) == (1000, achieved_hz)
    for written, changed in ((record, {}), (sent, {"start_delay_s": 1})):
        assert written["requested"] == defaults_of(written["program"]) | {"repetitions": 500} | changed


@pytest.mark.root
def test_a_publisher_that_cannot_keep_its_frequency_says_so(bench: Bench) -> None:
    assert bench.run("communication_tests_publisher", "-f", "1000000", "-r", "2000", "-s", "FIFO").status == 0
    sent = json.loads((bench.folder / "ct_gnuplot_l2000_fq1000000_pl0-tnRTFIFO-publisher.json").read_text())
    check_that_skipped_periods_make_up_the_time(sent["rate"], 2000)


@pytest.mark.root
def test_in_real_time_with_payload(bench: Bench) -> None:
    receiver, sender = bench.communicate("-r", "100", "-s", "FIFO", "-l", "100000", "-f", "200")
    assert (receiver.status, sender.status) == (0, 0)
    record = check_outputs(bench.folder, "ct_gnuplot_l100_fq200_pl100000-tnRTFIFO")
    assert {(thread["policy"], thread["priority"]) for thread in record["in_effect"]["threads"]} == {("FIFO", 95)}
    assert record["in_effect"]["mlockall"] is True


def test_publisher_killed(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "100000", "--idle-timeout", "10")
    wait_until(lambda: bench.subscribers() == 1, receiver)
    sender = bench.start("communication_tests_publisher", "-r", "100000", "-d", "1")
    wait_until(lambda: is_measuring(sender), sender)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(2)
    sender.kill()
    assert end(receiver, timeout=60).status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l100000_fq1000_pl0")
    assert record["complete"] is False
    assert record["incomplete_reason"].startswith("nothing came for 10 s, last message seen: ")
    last = int(record["incomplete_reason"].rsplit(" ", 1)[1])
    assert record["counts"]["measured"] + record["counts"]["missing"] == last + 1 < 100000


def test_publisher_stopped_before_its_last_message(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "100000")
    wait_until(lambda: bench.subscribers() == 1, receiver)
    sender = bench.start("communication_tests_publisher", "-r", "100000", "-d", "1")
    wait_until(lambda: is_measuring(sender), sender)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(2)
    sender.send_signal(signal.SIGINT)
    stopped = end(sender)
    assert (stopped.status, stopped.out) == (1, "")
    assert re.fullmatch(r"\tERROR: ended by SIGINT after \d+ of 100000 messages\n", stopped.err)
    sent = json.loads((bench.folder / "ct_gnuplot_l100000_fq1000_pl0-publisher.json").read_text())
    assert (sent["complete"], sent["incomplete_reason"]) == (False, "ended by SIGINT")
    assert f" after {sent['counts']['sent']} of " in stopped.err
    assert end(receiver, timeout=8).status == 0  # sooner than the idle timeout: the publisher took its leave
    record = check_outputs(bench.folder, "ct_gnuplot_l100000_fq1000_pl0")
    assert record["incomplete_reason"].startswith("the publisher left, last message seen: ")


def test_nothing_ever_comes(bench: Bench) -> None:
    ended = bench.run("communication_tests_subscriber", "--idle-timeout", "1")
    assert ended.status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l1000_fq1000_pl0")
    assert record["incomplete_reason"] == "nothing came for 1 s (0 publishers seen), no message came"
    assert record["summary"]["latency"]["n"] == 0


def test_subscriber_ends_on_a_signal(bench: Bench) -> None:
    process = bench.start("communication_tests_subscriber")
    wait_until(lambda: is_measuring(process), process)
    process.terminate()
    assert end(process).status == 0
    assert check_outputs(bench.folder, "ct_gnuplot_l1000_fq1000_pl0")["incomplete_reason"].startswith(
        "ended by SIGTERM"
    )


def test_publisher_of_more_messages_than_expected(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "10")
    wait_until(lambda: bench.subscribers() == 1, receiver)
    assert bench.run("communication_tests_publisher", "-r", "50", "-d", "1").status == 0
    assert end(receiver).status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l10_fq1000_pl0")
    assert record["counts"]["measured"] <= 10
    assert record["incomplete_reason"].endswith("publisher and subscriber need the same -r")


@pytest.mark.root
def test_five_subscribers_by_the_launch_file(bench: Bench) -> None:
    launch(
        bench, "communication_tests", "communication_tests_5sub", "s:=RR", "r:=200", "f:=500", "p:=n", "d:=2", "l:=64"
    )
    for number in range(5):
        record = check_outputs(bench.folder, f"n{number}ct_gnuplot_l200_fq500_pl64-tnRTRR")
        assert record["complete"] is True
        assert record["counts"]["measured"] + record["counts"]["missing"] == 200
