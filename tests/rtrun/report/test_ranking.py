"""Middlewares ranked: by the answer first, and only where all else is alike."""

from report.campaigns import latencies, message_run

from rtrun.judgement.study import study
from rtrun.plan.question import THESIS
from rtrun.report.ranking import ranking


def ranked(root):
    return [row[:4] for row in ranking(study(root, THESIS, bounds=False)).rows]


def test_the_best_answer_comes_first_then_the_smallest_chance_of_a_late_message(tmp_path):
    # 400 us is the deadline. All of the first are late, few of the second, and no other.
    for seed, (middleware, mean_us, late) in enumerate(
        [("roscpp", 500, 0), ("zeromq", 90, 3), ("tcp", 200, 0), ("futex", 90, 0)], start=1
    ):
        values = latencies(5000, seed, mean_us)
        values[100 : 100 + 1000 * late : 1000] = 600_000
        message_run(tmp_path, middleware, [values], parameters={"middleware": middleware})
    message_run(tmp_path, "longer", [latencies(5000, 9)], parameters={"payload_bytes": 1000})
    (what, *first), *others = ranked(tmp_path)
    assert what == "communication RR 100 Hz 0 B 1 sub"
    assert [first[1], *(row[2] for row in others)] == ["futex", "tcp", "zeromq", "roscpp"]
    assert [first[0], *(row[1] for row in others)] == ["1", "2", "3", "4"]
    assert others[-1][3] == "REFUTED"


def test_one_middleware_alone_and_an_emulated_board_are_not_ranked(tmp_path):
    message_run(tmp_path / "a", "roscpp", [latencies(500, 1)])
    assert ranked(tmp_path / "a") == []
    for name in ("tcp", "roscpp"):
        parameters = {"middleware": name}
        message_run(tmp_path / "b", name, [latencies(500, len(name))], parameters=parameters, platform="emulated")
    assert ranked(tmp_path / "b") == []
