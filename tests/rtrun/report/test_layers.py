"""What each layer adds: only groups that differ in the layer alone are paired."""

from dataclasses import replace

import pytest
from report.campaigns import communication_rows, latencies, oneshot_rows, write_run

from rtrun.judgement.layers import differing_in_layer, layer_pairs
from rtrun.judgement.study import study
from rtrun.report.layers import LayerBar, table
from rtrun.report.plots.stacks import stacked

CPU80 = {"condition": "cpu", "settings": {"load_percent": 80}}


@pytest.fixture
def write(tmp_path):
    """Write three runs of each of two layers, measured in turn."""

    def write_layers(name, lower, upper, **upper_record):
        for k in range(3):
            for seconds, (suite, parameters, more) in enumerate(
                [("oneshot_timer_tests", lower, {}), ("communication_tests", upper, upper_record)]
            ):
                values = latencies(500, 10 * ord(name) + 2 * k + seconds)
                timer = suite == "oneshot_timer_tests"
                rows = oneshot_rows(values, 10_000) if timer else communication_rows(values, 100)
                start = f"2026-01-01T00:00:{2 * k + seconds:02}+00:00"
                times = {"start_time": start, "end_time": start}
                folder = f"{name}-{suite}-{k}"
                write_run(tmp_path, folder, suite, [rows], parameters, asked=500, logs=False, **times, **more)

    return write_layers


def table_of(root):
    analysed = study(root, bounds=False)
    return table(layer_pairs(analysed), analysed.question.confidence)


def pairs(root):
    """The lower and the upper group of each row of the table."""
    return {(row[0], row[1]) for row in table_of(root).rows}


TIMER = {"policy": "RR", "timeout_us": 10_000, "busy_mode": 0}
MESSAGES = {"policy": "RR", "frequency_hz": 100, "payload_bytes": 0, "subscribers": 1}


def test_layers_alike_in_all_else_are_paired(write, tmp_path):
    write("a", TIMER, MESSAGES)
    assert len(pairs(tmp_path)) == 1


AWAKE = {"cpu_dma_latency_us": 0}


def test_idle_cpus_must_have_been_alike(write, tmp_path):
    """Of two groups above, the one that is alike is paired; where none is, the table says why."""
    write("a", TIMER | AWAKE, MESSAGES)
    shown = table_of(tmp_path)
    (row,) = shown.rows
    assert "refused: idle CPUs were kept awake in one and not in the other" in row[-1]
    write("b", TIMER | AWAKE, MESSAGES | AWAKE)
    shown = table_of(tmp_path)
    assert {row[-1].partition(":")[0] for row in shown.rows} != {"refused"}
    assert {row[:2] for row in shown.rows} == {(shown.rows[0][0], shown.rows[0][1])}
    assert "cpu_dma_latency_us=0" in shown.rows[0][1]


def test_idle_states_shut_for_the_baseline_alone(write, tmp_path):
    """cyclictest alone can shut deeper idle states: nothing that a suite measures compares with it."""
    write("a", TIMER, MESSAGES)
    timer = next(group for group in study(tmp_path, bounds=False).groups if group.suite == "oneshot_timer_tests")
    bare = replace(
        timer, suite="cyclictest", parameters={"policy": "RR", "interval_us": 10_000, "deepest_idle_state": 0}
    )
    assert len(differing_in_layer([bare, timer])) == 1
    analysed = replace(study(tmp_path, bounds=False), groups=(bare, timer))
    (pair,) = layer_pairs(analysed)
    assert "idle CPUs were kept awake in one" in (pair.attribution.refused or "")


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


def through(group, middleware, **parameters):
    return replace(group, parameters=group.parameters | {"middleware": middleware} | parameters)


def test_a_layer_stands_on_the_middleware_below_or_on_the_system(write, tmp_path):
    """Timers of roscpp stand on cyclictest, its messages on TCP; a timer through another middleware is on neither."""
    write("a", TIMER, MESSAGES)
    timer, messages = sorted(study(tmp_path, bounds=False).groups, key=lambda group: group.suite, reverse=True)
    bare = replace(timer, suite="cyclictest", parameters={"policy": "RR", "interval_us": 10_000})
    socket, longer = through(messages, "tcp"), through(messages, "tcp", payload_bytes=1000)
    found = differing_in_layer([bare, timer, messages, socket, longer])
    assert [(low.label, high.label) for low, high in found] == [
        (low.label, high.label) for low, high in ((bare, timer), (timer, messages), (socket, messages))
    ]


def test_one_long_bar_does_not_hide_the_others():
    """The picture is as wide as the others need, and says which goes on beyond it."""

    def bar(us, either_way_us=0.0):
        return LayerBar(label="of a chain", short="one", us=us, low_us=us - either_way_us, high_us=us + either_way_us)

    usual, long = (bar(10.0), bar(10.0, 5.0)), (bar(10.0), bar(2000.0, 5000.0))
    stacks = stacked([usual, usual, long])
    assert stacks.width == "25 us"
    places = [[(part.left, part.width, part.low, part.high) for part in stack.parts] for stack in stacks.bars]
    assert places[:2] == [[(0, 40, None, None), (40, 40, 60, 100)]] * 2
    assert places[2] == [(0, 40, None, None), (40, 60, 0, 100)]
    assert [stack.is_cut for stack in stacks.bars] == [False, False, True]
    assert "+2 ms" in stacks.bars[2].parts[1].text
