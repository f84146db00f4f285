"""What a suite has measured so far, read from a line that nobody has checked."""

import pytest

from rtrun.results.figures_so_far import FiguresSoFar, pooled, read_figures


def test_a_line_of_a_suite():
    line = "1200                -50                 8900               120300"
    assert read_figures(line) == FiguresSoFar(n=1200, min_ns=-50, mean_ns=8900, max_ns=120300)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "1 2 3",
        "1 2 3 4 5",
        "0 1 2 3",
        "9 5 4 6",  # read while it was written
        "9 1 4 3",
        "9 1 2 1e3",
        f"{10**12 + 1} 1 2 3",
        f"9 1 2 {10**18 + 1}",
        "9 1 2 \u0663",
        "\x1b[2J 1 2 3",
    ],
)
def test_any_other_line_has_no_figures(line):
    assert read_figures(line) is None


def test_outputs_of_one_run_are_pooled_by_their_numbers():
    parts = [
        FiguresSoFar(n=1, min_ns=5, mean_ns=5, max_ns=5),
        FiguresSoFar(n=3, min_ns=-1, mean_ns=9, max_ns=20),
    ]
    assert pooled(parts) == FiguresSoFar(n=4, min_ns=-1, mean_ns=8, max_ns=20)
