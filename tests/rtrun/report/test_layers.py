"""What each layer adds: only groups that differ in the layer alone are paired."""

import pytest
from report.campaigns import communication_rows, latencies, oneshot_rows, write_run

from rtrun.judgement.study import study
from rtrun.report.end_tables import _layers

CPU80 = {"condition": "cpu", "settings": {"load_percent": 80}}


@pytest.fixture
def write(tmp_path):
    """Write three runs of each of two layers, measured in turn."""

    def write_layers(name, lower, upper, **upper_record):
        for k in range(3):
            for seconds, (suite, parameters, more) in enumerate(
                [("oneshot_timer_tests", lower, {}), ("communication_tests", upper, upper_record)]
            ):
                values = latencies(500, 2 * k + seconds)
                timer = suite == "oneshot_timer_tests"
                rows = oneshot_rows(values, 10_000) if timer else communication_rows(values, 100)
                start = f"2026-01-01T00:00:{2 * k + seconds:02}+00:00"
                times = {"start_time": start, "end_time": start}
                folder = f"{name}-{suite}-{k}"
                write_run(tmp_path, folder, suite, [rows], parameters, asked=500, logs=False, **times, **more)

    return write_layers


def pairs(root):
    """The lower and the upper group of each row of the table."""
    return {(row[0], row[1]) for row in _layers(study(root, bounds=False)).rows}


TIMER = {"policy": "RR", "timeout_us": 10_000, "busy_mode": 0}
MESSAGES = {"policy": "RR", "frequency_hz": 100, "payload_bytes": 0, "subscribers": 1}


def test_layers_alike_in_all_else_are_paired(write, tmp_path):
    write("a", TIMER, MESSAGES)
    assert len(pairs(tmp_path)) == 1


AWAKE = {"cpu_dma_latency_us": 0}


def test_idle_cpus_must_have_been_alike(write, tmp_path):
    """Of two groups above, the one that is alike is paired; where none is, the table says why."""
    write("a", TIMER | AWAKE, MESSAGES)
    table = _layers(study(tmp_path, bounds=False))
    (row,) = table.rows
    assert "refused: idle CPUs were kept awake in one and not in the other" in row[5]
    write("b", TIMER | AWAKE, MESSAGES | AWAKE)
    table = _layers(study(tmp_path, bounds=False))
    assert {row[5].partition(":")[0] for row in table.rows} != {"refused"}
    assert {row[:2] for row in table.rows} == {(table.rows[0][0], table.rows[0][1])}
    assert "cpu_dma_latency_us=0" in table.rows[0][1]


@pytest.mark.parametrize(
    ("parameters", "record"),
    [
        ({"policy": "FIFO"}, {}),
        ({"priority": 60}, {}),
        ({"frequency_hz": 200}, {}),
        ({"subscribers": 3}, {}),
        ({"policy": "0"}, {}),
        ({}, CPU80),
        ({}, {"target": {"name": "another board"}}),
    ],
    ids=["policy", "priority", "period", "subscribers", "no real-time policy", "condition", "target"],
)
def test_what_differs_in_more_than_the_layer_is_not_paired(write, tmp_path, parameters, record):
    write("a", TIMER, MESSAGES | parameters, **record)
    assert pairs(tmp_path) == set()
