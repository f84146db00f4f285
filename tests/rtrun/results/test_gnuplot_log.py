"""The log reader on real logs of 2014, on logs written here from the format's description, and on junk."""

import re
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from logs import LOGS_2014, SUITES
from rtfiles.errors import UsageError
from rtrun.analysis.figures import Figures, IndexedValue, figures_of_histogram
from rtrun.analysis.histogram import Histogram
from rtrun.results import gnuplot_lines
from rtrun.results.gnuplot_log import Log, read_log

ONESHOT = "oneshot_timer_tests_l200_tm1000-tnRTRR-measured.log"
LATE = "late_ct_gnuplot_l300_fq100_pl0.log"


def listing(entries: list[tuple[int, int]]) -> str:
    return "|" + "".join(f"{value}:{index}|" for value, index in entries)


def write_log(values: list[int | None], *, suite: str, negative_first: bool, padding_2014: bool) -> str:
    """A log as the programs write it; None is a missing message, which the programs of 2014 took for -1."""
    missing = [index for index, value in enumerate(values) if value is None]
    data = (
        [-1 if value is None else value for value in values] if padding_2014 else [v for v in values if v is not None]
    )
    low, high, mean = min(data), max(data), int(sum(data) / len(data))
    pairs = [(value, index) for index, value in enumerate(values) if value is not None]
    if padding_2014:
        pairs = list(zip(data, range(len(data)), strict=True))
    top = sorted(pairs, key=lambda pair: (-pair[0], pair[1]))[:10]
    lowest = sorted(pairs)[:10]
    if padding_2014:
        top = [pair for pair in top if pair[0] > low]
        lowest = [pair for pair in lowest if pair[0] < high]
        top += [(low, 0)] * (10 - len(top))
        lowest += [(high, 0)] * (10 - len(lowest))
    bounds = f"MIN: {low}us\tAVG: {mean}us\tMAX: {high}us"
    if suite == "cyclic_timer_tests":
        heading = [f"Measurement results with a total of {len(values)} measurements and a frequency of 50Hz:"]
        heading += [f"Jitter:\t{bounds}"]
    else:
        heading = [f"Amount messages: {len(values)}; Messages out of order: 3", bounds]
    heading += [f"Indices of top values(|latency:index|): {listing(top)}"]
    heading += [f"Indices of lowest values(|latency:index|): {listing(lowest)}"]
    if missing:
        heading += [f"Total of {len(missing)} missing messages."]
        heading += [f"Missing messages: |{'|'.join(map(str, missing))}|"[:511]]
    count = Counter(data)
    positive = [f"{value:06d} \t{count[value]:06d}" for value in range(high + 1)]
    negative = [f"-{-value:06d} \t{count[value]:06d}" for value in range(low, 0)]
    bins = [*negative, *positive]
    if not negative_first:
        bins = [*positive, *(["# negative Values following"] if negative else []), *(f"#{line}" for line in negative)]
    return "\n".join(
        [
            'set title "written by a test"',
            f'set xlabel "in micro seconds - MIN:  {low}us  AVG: {mean}us MAX: {high}us"',
            "plot \"-\" u 1:2 t 'Latency_Occurrence' w steps",
            "# Plot data for gnuplot",
            *(f"# {line}" for line in heading),
            *bins,
            "",
            "end",
            "",
        ]
    )


def figures_of(log: Log) -> Figures:
    bins = Histogram(values_ns=log.value_us * 1000, counts=log.count)
    return figures_of_histogram(bins, top=log.top, lowest=log.lowest)


def as_values(log: Log) -> list[int]:
    return [value for value, count in zip(log.value_us.tolist(), log.count.tolist(), strict=True) for _ in range(count)]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.integers(-2000, 2000), min_size=1, max_size=40), old=st.booleans())
def test_cyclic_logs_come_back(tmp_path: Path, values: list[int], old: bool) -> None:
    path = tmp_path / f"cyclic_timer_tests_l{len(values)}_fq50.log"
    path.write_text(write_log([*values], suite="cyclic_timer_tests", negative_first=True, padding_2014=old))
    log = read_log(path)
    assert as_values(log) == sorted(values)
    assert (log.suite, log.series) == ("cyclic_timer_tests", "jitter")
    figures = figures_of(log)
    for entry in (*figures.top, *figures.lowest):
        assert entry.index is None or 1000 * values[entry.index] == entry.value_ns
    assert [entry.value_ns // 1000 for entry in figures.top] == sorted(values, reverse=True)[:10]
    assert old or None not in [entry.index for entry in (*figures.top, *figures.lowest)]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.none() | st.integers(0, 500), min_size=1, max_size=40).filter(
        lambda values: set(values) != {None}
    ),
    old=st.booleans(),
)
def test_a_missing_message_is_a_count_and_never_a_number(tmp_path: Path, values: list[int | None], old: bool) -> None:
    path = tmp_path / f"ct_gnuplot_l{len(values)}_fq50_pl0.log"
    path.write_text(write_log(values, suite="communication_tests", negative_first=False, padding_2014=old))
    log = read_log(path)
    arrived = [value for value in values if value is not None]
    assert as_values(log) == sorted(arrived)
    assert log.missing == len(values) - len(arrived)
    assert log.out_of_order == 3
    assert figures_of(log).min_ns == 1000 * min(arrived)
    assert [entry.value_ns // 1000 for entry in figures_of(log).lowest] == sorted(arrived)[:10]
    assert any("stand in the log as -1 us" in remark for remark in log.remarks) == (old and log.missing > 0)
    for entry in (*figures_of(log).top, *figures_of(log).lowest):
        assert entry.index is None or 1000 * values[entry.index] == entry.value_ns


def test_a_log_of_2014_with_every_message_missing_has_no_figure(tmp_path: Path) -> None:
    path = tmp_path / "ct_gnuplot_l12_fq50_pl0.log"
    path.write_text(write_log([None] * 12, suite="communication_tests", negative_first=False, padding_2014=True))
    log = read_log(path)
    figures = figures_of(log)
    assert (figures.n, log.missing, figures.min_ns, figures.top, figures.lowest) == (0, 12, None, (), ())


def test_negative_bins_after_the_others_in_comments_are_read(tmp_path: Path) -> None:
    path = tmp_path / "ct_gnuplot_l3_fq50_pl0.log"
    path.write_text(write_log([-9, 5, -2], suite="communication_tests", negative_first=False, padding_2014=False))
    assert as_values(read_log(path)) == [-9, -2, 5]


def test_every_real_log_of_2014_is_read() -> None:
    logs = {path.name: read_log(path) for path in LOGS_2014.glob("*.log")}
    assert len(logs) == 9
    for name, log in logs.items():
        assert int(log.count.sum()) + log.missing == log.parameters["repetitions"], name
        assert log.printed is not None
        assert figures_of(log).max_ns == 1000 * log.printed.max_us
    log = logs[ONESHOT]
    assert log.parameters == {"repetitions": 200, "timeout_us": 1000, "policy": "RR", "busy_mode": 0}
    assert (log.suite, log.series, log.remarks) == ("oneshot_timer_tests", "measured_2014", ())
    assert (log.printed.min_us, log.printed.avg_us, log.printed.max_us) == (14, 42, 273) if log.printed else False
    assert (figures_of(log).top[0].index, figures_of(log).lowest[0].index) == (33, 122)
    assert logs["oneshot_timer_tests_l50_tm500-tnRTFIFO-bm-measured.log"].parameters["busy_mode"] == 1


def test_the_sentinel_of_2014_is_taken_out_and_told() -> None:
    log = read_log(LOGS_2014 / LATE)
    assert log.printed is not None
    assert log.printed.min_us == -1
    assert (log.missing, figures_of(log).n, figures_of(log).min_ns) == (101, 199, 46_000)
    assert [entry.value_ns for entry in figures_of(log).lowest[:3]] == [46_000, 60_000, 66_000]
    assert all(entry.index is None for entry in figures_of(log).lowest)
    assert figures_of(log).top[0] == IndexedValue(value_ns=1_355_000, index=291)
    assert "101 missing messages stand in the log as -1 us" in log.remarks[0]


def test_padded_lists_of_2014_are_cut_and_told() -> None:
    figures = figures_of(read_log(LOGS_2014 / "oneshot_timer_tests_l4_tm5000-tnRTRR-measured.log"))
    assert [(entry.value_ns // 1000, entry.index) for entry in figures.top] == [(46, 2), (45, 0), (44, 3), (40, None)]
    log = read_log(LOGS_2014 / "short_cyclic_timer_tests_l5_fq50.log")
    assert [(entry.value_ns // 1000, entry.index) for entry in figures_of(log).top[-2:]] == [(0, 4), (-37, 0)]
    assert log.remarks == ("11 entries that pad the lists of top and lowest values, as in 2014, are left out",)


def altered(tmp_path: Path, name: str, old: str, new: str) -> Path:
    """A copy of a real log with one place altered."""
    text = (LOGS_2014 / name).read_text()
    assert old in text
    path = tmp_path / name
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("000014 \t000001", "000014 \t000002", ":12: the summary speaks of 200 measurements, 0 missing, 0 not fired"),
        ("000014 \t000001", "000014 \t000000", ":2: the summary's MIN is 14 us, that of the bins 33 us"),
        ("AVG: 42us", "AVG: 12us", ":2: the summary's AVG is 12 us, that of the bins 42 us"),
        ("000273 \t000001", "000973 \t000001", ":2: the summary's MAX is 273 us, that of the bins 973 us"),
        ("000015 \t", "000013 \t", ":33: the bins must rise, 13 follows 14"),
        ("000015 \t", "#00015 \t", ":33: only a negative value is commented out"),
        ("000015 \t000000", "000015 nan", ":33: a bin must stand here, 'value <TAB>count', not '000015 nan'"),
        ("000015", "9" * 400, ":33: a bin must stand here"),
        ("\nend", "\nend\n1", ": nothing may follow 'end', got '1'"),
        ("# Plot data", "# Data", ":11: no log of a suite: no suite writes the command '# Data for gnuplot'"),
        ("a loop length", "a length", ": no log of a suite: the summary is none of oneshot_timer_tests"),
        ("set xlabel", "exit #", ":2: no log of a suite"),
    ],
)
def test_an_altered_log_is_refused_at_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = altered(tmp_path, ONESHOT, old, new)
    with pytest.raises(UsageError) as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert message in str(error.value)


def test_counts_that_contradict_the_missing_messages_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=":16: 99 missing messages, but 101 in the bin of -1"):
        read_log(altered(tmp_path, LATE, "Total of 101 missing", "Total of 99 missing"))


def test_an_incomplete_log_holds_as_many_as_it_says(tmp_path: Path) -> None:
    text = write_log([5, 6], suite="communication_tests", negative_first=False, padding_2014=False)
    text = text.replace("messages: 2;", "messages: 9;")
    path = tmp_path / "ct_gnuplot_l9_fq50_pl0.log"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"the summary speaks of 9 measurements, 0 missing, 0 not fired, .* hold 2"):
        read_log(path)
    incomplete = "# Incomplete: 2 of 9 measured, the publisher left, last message seen: 1\n000000"
    path.write_text(text.replace("000000", incomplete, 1))
    assert read_log(path).incomplete == "the publisher left, last message seen: 1"


def test_a_measured_minus_one_is_no_missing_message(tmp_path: Path) -> None:
    path = tmp_path / "ct_gnuplot_l3_fq50_pl0.log"
    path.write_text(write_log([-1, 5, 9], suite="communication_tests", negative_first=False, padding_2014=False))
    assert (read_log(path).missing, as_values(read_log(path)), read_log(path).remarks) == (0, [-1, 5, 9], ())
    path.write_text(write_log([-1, -5, 9], suite="communication_tests", negative_first=False, padding_2014=False))
    assert read_log(path).missing == 0
    assert read_log(path).remarks == ("if this log is of 2014, 1 of its values, those of -1 us, are missing messages",)


def test_lists_of_another_series_lend_no_index(tmp_path: Path) -> None:
    log = read_log(altered(tmp_path, ONESHOT, "|273:33|", "|279:33|"))
    assert log.remarks == ("the list of top values does not belong to the bins: its indices are left out",)
    assert figures_of(log).top[0].value_ns == 273_000
    assert figures_of(log).top[0].index is None


@pytest.mark.parametrize(
    "command",
    [
        'set ylabel "`touch obeyed`"',
        'set title "a\\',
        'set title "a"; system("touch obeyed")',
        'set output "|touch obeyed; echo .jpg"',
        "system('touch obeyed')",
        "!touch obeyed",
        'load "other"',
        'set xlabel "a\r`touch obeyed`"',
        'plot "< touch obeyed" u 1:2',
        "set xrange [0:system('touch obeyed')]",
        "",
    ],
)
def test_a_command_that_no_suite_writes_is_refused(tmp_path: Path, command: str) -> None:
    path = tmp_path / ONESHOT
    path.write_text(f"{command}\n" + (LOGS_2014 / ONESHOT).read_text())
    with pytest.raises(UsageError, match=r":1: no log of a suite: no suite writes the command"):
        read_log(path)


def test_gnuplot_is_trusted_with_real_logs_of_their_own_picture(tmp_path: Path) -> None:
    for path in (*LOGS_2014.glob("*.log"), *SUITES.glob("*.log")):
        gnuplot_lines.check_commands(path)
    for wrong in ("other.jpg", "/etc/x.jpg", f"../{ONESHOT.removesuffix('.log')}.jpg"):
        path = tmp_path / ONESHOT
        path.write_text((LOGS_2014 / ONESHOT).read_text().replace(f"{ONESHOT.removesuffix('.log')}.jpg", wrong))
        with pytest.raises(UsageError, match="it would draw"):
            gnuplot_lines.check_commands(path)


def test_a_log_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    data = (LOGS_2014 / "oneshot_timer_tests_l4_tm5000-tnRTRR-measured.log").read_bytes()
    path = tmp_path / "oneshot_timer_tests_l4_tm5000-tnRTRR-measured.log"
    for length in range(len(data) - 1):  # only the last newline may be missing
        path.write_bytes(data[:length])
        with pytest.raises(UsageError, match=r"log:\d+: "):
            read_log(path)


def test_a_renamed_log_is_known_by_the_name_it_was_written_under(tmp_path: Path) -> None:
    path = tmp_path / "kept.log"
    path.write_bytes((LOGS_2014 / ONESHOT).read_bytes())
    assert read_log(path).parameters["timeout_us"] == 1000
    wrong = tmp_path / "cyclic_timer_tests_l200_fq1000.log"
    path.rename(wrong)
    with pytest.raises(UsageError, match="named as a log of cyclic_timer_tests, but its summary is one of oneshot"):
        read_log(wrong)


def test_huge_values_take_no_memory_for_the_range(tmp_path: Path) -> None:
    path = tmp_path / "cyclic_timer_tests_l2_fq50.log"
    top = 10**15 - 1
    path.write_text(
        'set xlabel "MIN: 0us AVG: 499999999999999us MAX: 999999999999999us"\n# Plot data for gnuplot\n'
        "# Measurement results with a total of 2 measurements and a frequency of 50Hz:\n"
        f"000000 \t000001\n{top} \t000001\n\nend\n"
    )
    assert figures_of(read_log(path)).max_ns == 1000 * top


def test_more_bins_than_memory_holds_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    path = LOGS_2014 / ONESHOT
    filled = int((read_log(path).count > 0).sum())
    monkeypatch.setattr(gnuplot_lines, "MAX_BINS", filled)
    read_log(path)
    monkeypatch.setattr(gnuplot_lines, "MAX_BINS", filled - 1)
    with pytest.raises(UsageError, match=f": more than {filled - 1} bins that hold something"):
        read_log(path)


def test_a_file_too_large_is_refused_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gnuplot_lines, "MAX_SIZE_BYTES", 4000)
    with pytest.raises(UsageError, match="4985 bytes, a log has at most 4000"):
        read_log(LOGS_2014 / ONESHOT)
    endless = tmp_path / "x.log"
    endless.write_bytes(b"set " + b"x" * (2 << 20))
    monkeypatch.undo()
    with pytest.raises(UsageError, match=":1: the line is longer than any in a log"):
        read_log(endless)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.log"):
        with pytest.raises(UsageError):
            read_log(path)


def test_bins_are_the_same_many_at_a_time_and_line_by_line(monkeypatch, tmp_path):
    bins = "".join(f"{value:06d} \t{value % 3:06d}\n" for value in range(200_000))
    text = (LOGS_2014 / "oneshot_timer_tests_l50_tm2000-measured.log").read_text()
    head, _, _ = text.partition("# Plot data for gnuplot\n")
    logs = {path.name: path.read_bytes() for path in LOGS_2014.glob("*.log")}
    logs["long.log"] = f"{head}# Plot data for gnuplot\n#-00003 \t000001\n{bins}end\n".encode()
    # The last of these bins is refused, whichever way it is read.
    logs["falls.log"] = logs["long.log"].replace(b"199999 \t", b"000007 \t")

    def read(name):
        (tmp_path / name).write_bytes(logs[name])
        try:
            return gnuplot_lines.read_text(tmp_path / name)
        except UsageError as error:
            return str(error)

    at_once = {name: read(name) for name in logs}
    assert "falls.log:200012: the bins must rise, 7 follows 199998" in at_once["falls.log"]
    monkeypatch.setattr(gnuplot_lines, "_PLAIN_BINS", re.compile(rb"(?!)"))
    assert {name: read(name) for name in logs} == at_once
