"""Boots and boards count alike, however long each was measured."""

from dataclasses import replace

import numpy as np
import pytest

from rtrun.analysis.dependence.units import boots_of, count_alike, sums
from rtrun.analysis.trials import Trials, count_misses


def run(n: int, misses: int, boot: str, board: str = "", name: str = "") -> Trials:
    values = np.full(n, 50_000)
    values[:misses] = 500_000
    trials = count_misses(values, 400_000)
    return replace(trials, boot=boot, board=board, run=name)


def test_a_boot_that_was_measured_longer_counts_for_no_more_than_the_one_in_the_middle() -> None:
    runs = [run(100, 1, "a"), run(100, 3, "b"), run(5000, 50, "c"), run(5000, 150, "c")]
    counted = count_alike(runs)
    assert [count.n for count in counted] == pytest.approx([100, 100, 50, 50])
    assert [count.misses for count in counted] == pytest.approx([1, 3, 0.5, 1.5])
    assert [count.share for count in counted] == pytest.approx([1, 1, 0.01, 0.01])


def test_a_shorter_one_counts_for_what_it_is() -> None:
    assert [count.n for count in count_alike([run(10, 0, "a"), run(100, 0, "b"), run(100, 0, "c")])] == [10, 100, 100]


def test_boards_do_so_too() -> None:
    runs = [run(100, 0, boot, board) for board, boots in (("x", "a"), ("y", "b"), ("z", "cdefgh")) for boot in boots]
    counted = count_alike(runs)
    totals = sums(counted, [trials.board for trials in runs])
    assert {board: n for board, (n, _) in totals.items()} == pytest.approx({"x": 100, "y": 100, "z": 100})


def test_runs_of_one_boot_count_whole_and_one_of_an_unknown_boot_is_its_own() -> None:
    assert [count.n for count in count_alike([run(10, 0, "a"), run(1000, 0, "a")])] == [10, 1000]
    assert len(set(boots_of([run(10, 0, "", name="1"), run(10, 0, "", name="2"), run(10, 0, "a")]))) == 3
    assert count_alike([]) == []
