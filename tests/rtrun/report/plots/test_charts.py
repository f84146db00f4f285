"""The plots of scenarios: what they say of axes and outputs, and that what is drawn is what was measured."""

import base64
import re
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from report.campaigns import cyclic_rows, cyclic_run, latencies, message_run, oneshot_run, write_log_alone

from rtrun.analysis.scale import Division, Scale
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS
from rtrun.report.plots import axes
from rtrun.report.plots.charts import plots
from rtrun.report.plots.drawing import drawn
from rtrun.report.scenarios import scenarios


def plots_of(root, **question):
    (scenario,) = scenarios(study(root, replace(THESIS, **question)))
    return {plot.id: plot for plot in plots(scenario, probability=1e-6)}


@pytest.mark.parametrize(
    ("write", "measured", "ids"),
    [
        (lambda root: oneshot_run(root, "a", latencies(5000, 1)), "latency of the timer", "over-time"),
        (lambda root: cyclic_run(root, "a", latencies(5000, 1)), "lateness of the timer", "over-time"),
        (lambda root: message_run(root, "a", [latencies(5000, k) for k in range(5)]), "latency of messages", "outputs"),
    ],
)
def test_four_plots_say_what_is_measured_along_their_axes(tmp_path, write, measured, ids):
    write(tmp_path)
    by_id = plots_of(tmp_path)
    assert list(by_id) == ["values", "shares", "course", ids]
    assert (
        by_id["values"].x.title == by_id["shares"].x.title == by_id["course"].y.title == by_id[ids].y.title == measured
    )
    assert all(re.fullmatch(r"-?[0-9.]+ (ns|us|ms|s)", text) for _, text in by_id["values"].x.ticks)


def test_subscribers_have_numbers(tmp_path):
    message_run(tmp_path, "a", [latencies(2000, k) for k in range(5)])
    by_id = plots_of(tmp_path)
    names = [mark.name for mark in by_id["values"].marks if mark.kind == "steps"]
    assert names == [f"subscriber {k}" for k in range(1, 6)]
    assert by_id["outputs"].x.title == "subscriber" and [text for _, text in by_id["outputs"].x.ticks] == list("12345")
    assert by_id["outputs"].cells.counts.sum(axis=0).tolist() == [1999] * 5


def test_nothing_measured_is_lost_in_a_plot(tmp_path):
    values = latencies(5000, 1)
    values[[7, 4000]] = 3_000_000, 92_000_000
    oneshot_run(tmp_path, "a", values)
    by_id = plots_of(tmp_path, deadline_ns=400_000)
    (steps, limit) = by_id["values"].marks
    assert limit.name == "deadline 400 us" and limit.x.tolist() == [400_000] * 2
    assert steps.x[-1] > 92_000_000 and steps.y.max() > 100
    (area, dots, _) = by_id["course"].marks
    assert area.y.max() == 92_000_000 and area.low.min() == values.min() and len(dots.x) == 10
    cells = by_id["over-time"].cells
    assert cells.counts.sum() == 5000
    assert np.argwhere(cells.counts[-1]).ravel().tolist() == [np.searchsorted(cells.x_edges, 4000, "right") - 1]


def test_messages_that_never_came_leave_a_gap_and_count_as_late(tmp_path):
    message_run(tmp_path, "a", [latencies(5000, 1)], lost=tuple(range(1000, 5000)))
    by_id = plots_of(tmp_path, deadline_ns=400_000)
    along, cells = by_id["course"].x.scale, by_id["over-time"].cells
    assert (along.low, along.high) == (1, 5000)
    (area, dots, _) = by_id["course"].marks
    assert max(*area.x, *dots.x) <= 1021, "a column of 21 loops begins before the first that is missing"
    assert cells.x_edges[-1] == 5000 and cells.counts.sum(axis=0)[12:].sum() == 0 and cells.counts.sum() == 999
    measured = by_id["shares"].marks[0]
    assert measured.y[-1] == pytest.approx(4000 / 4999) and "never came" in by_id["shares"].caption


def test_values_after_a_gap_are_drawn_apart(tmp_path):
    message_run(tmp_path, "a", [latencies(5000, 1)], lost=tuple(range(1000, 2000)))
    course = plots_of(tmp_path)["course"]
    (before, after) = [(mark.x[0], mark.x[-1]) for mark in course.marks if mark.kind == "area"]
    assert before[1] < after[0] and after[1] == 5000
    assert [kind for kind, _, _ in drawn(course).keys] == ["area", "dots"], "one key for both parts"


@pytest.mark.parametrize(("deadline_us", "style"), [(90, "upright"), (300, "upright back"), (400, "upright back")])
def test_a_deadline_is_named_on_the_side_where_there_is_place(tmp_path, deadline_us, style):
    oneshot_run(tmp_path, "a", latencies(5000, 1))
    by_id = plots_of(tmp_path, deadline_ns=1000 * deadline_us)
    ((side, place, name),) = drawn(by_id["values"]).limits
    assert (side, name) == (style, f"deadline {deadline_us} us") and 0 < place <= 100
    assert not any("deadline" in name for _, _, name in drawn(by_id["values"]).keys)
    ((side, _, _),) = drawn(by_id["course"]).limits
    assert side == ("level" if deadline_us == 90 else "level back")


def test_counts_have_colours_once(tmp_path):
    cyclic_run(tmp_path, "a", latencies(40, 1))
    page = drawn(plots_of(tmp_path)["over-time"])
    colours, counts = zip(*page.colours, strict=True)
    assert len(set(counts)) == len(counts) < 6
    assert (colours[0], counts[0], colours[-1]) == ("rgb(0,60,120)", "1", "rgb(253,231,55)")


def test_a_deadline_far_away_leaves_the_axis_to_the_values(tmp_path):
    oneshot_run(tmp_path, "a", latencies(5000, 1))
    marks = plots_of(tmp_path, deadline_ns=10**9)["values"].marks
    assert (marks[-1].name, marks[-1].x.size) == ("deadline 1 s, beyond the right end", 0)


def test_logs_have_the_plots_that_need_no_order(tmp_path):
    for seed, name in enumerate("ab"):
        rows, parameters = cyclic_rows(latencies(500, seed), 100), {"policy": "RR", "frequency_hz": 100}
        write_log_alone(tmp_path, name, "cyclic_timer_tests", rows, parameters, asked=500)
    assert list(plots_of(tmp_path)) == ["values", "shares", "outputs"]


def test_a_path_has_the_points_of_its_data_and_a_picture_the_cells(tmp_path):
    oneshot_run(tmp_path, "a", latencies(5000, 1))
    by_id = plots_of(tmp_path)
    for plot in by_id.values():
        page = drawn(plot)
        for (kind, _, path), mark in zip(page.paths[1:], page.data["marks"], strict=True):
            numbers = re.findall(r"-?[\d.]+", path)
            per_point = 3 if kind == "dots" else 2
            assert len(numbers) == len(mark["x"]) * per_point * (2 if "low" in mark else 1)
            assert all(0 <= float(number) <= 1000 for number in numbers)
    page = drawn(by_id["over-time"])
    png = base64.b64decode(page.picture.removeprefix("data:image/png;base64,"))
    width, height = struct.unpack(">II", png[16:24])
    lines = zlib.decompress(png[png.index(b"IDAT") + 4 : png.index(b"IEND") - 8])
    pixels = np.frombuffer(lines, np.uint8).reshape(height, width + 1)[:, 1:]
    assert width == by_id["over-time"].cells.counts.shape[1] and pixels.max() == 255
    assert ((pixels > 0).any(axis=0) == (by_id["over-time"].cells.counts > 0).any(axis=0)).all()


@pytest.mark.parametrize(
    ("axis", "texts"),
    [
        (axes.times("", Scale(division=Division.LINEAR, low=80e3, high=400e3)), "100 us, 200 us, 300 us, 400 us"),
        (axes.times("", Scale(division=Division.LOG, low=45e3, high=88e6)), "100 us, 1 ms, 10 ms"),
        (axes.times("", Scale(division=Division.LOG, low=300e3, high=3e6)), "500 us, 1 ms, 2 ms"),
        (
            axes.times("", Scale(division=Division.STRETCHED, low=-88e6, high=88e6, spread=25e3)),
            "-80 ms, -1 ms, 0 us, 1 ms, 80 ms",
        ),
        (axes.many("", 0.7, 12_000), "1, 10, 100, 1 000, 10 000"),
        (axes.shares("", 1e-6), "1e-06, 0.0001, 0.01, 1"),
        (axes.counts("", 0.5, 5.5), "1, 2, 3, 4, 5"),
        (axes.dates("", 1767952800, 1767952800 + 30 * 86400), "2026-01-09, 2026-01-24, 2026-02-08"),
    ],
)
def test_ticks_are_round_numbers(axis, texts):
    assert ", ".join(text for _, text in axis.ticks) == texts
