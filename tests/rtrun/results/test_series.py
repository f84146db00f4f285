"""Series from files: what stands apart, what has no value, and what a log does not tell."""

from pathlib import Path

from written import write_communication

from logs import LOGS_2014
from rtrun.results.series import SampleSeries, read_file

LOG = LOGS_2014 / "cyclic_timer_tests_l300_fq1000-tnRTRR.log"


def test_loops_without_a_value_are_counted_from_the_end_of_the_start_up(tmp_path: Path) -> None:
    (series,) = read_file(write_communication(tmp_path))
    assert isinstance(series, SampleSeries)
    assert [value.index for value in series.header.startup] == [0]
    assert (series.index.tolist(), series.absent.tolist()) == ([1, 2, 3], [3])


def test_a_log_that_does_not_list_its_start_up_says_that_the_figures_include_it(tmp_path: Path) -> None:
    path = tmp_path / LOG.name
    lines = LOG.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith("# Indices of")))
    (series,) = read_file(path)
    assert series.header.startup == ()
    assert series.header.remarks == ("start-up values are not among the listed ones: the figures include them",)
    assert series.figures().n == 300
