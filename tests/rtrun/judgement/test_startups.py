"""A start-up is left out of the verdict of each kind of run, and reported wherever that is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from report.campaigns import latencies, message_run, oneshot_run

from rtrun.analysis.deadline import Answer
from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS, read_tolerance
from rtrun.results import reading

QUESTION = replace(THESIS, probability=1e-3, bursts=1)
WORDS = ["--deadline", "400us", "--probability", "1e-3", "--confidence", "0.95"]
N, LATE = 8000, 10


def _fading(number, n=N):
    """Values that are twice as high at first, of which the first ten are late."""
    values = latencies(n, number, 90.0)
    values = (values * (1 + np.exp(-np.arange(n) / 100))).astype(np.int64)
    values[:LATE] = 3_100_000
    return values


def write(root, runs, first=0):
    for number in range(first, first + runs):
        oneshot_run(root, f"{number:03}-a", _fading(number), target={"name": "a", "boot_id": f"{number}"})


def test_it_is_left_out_and_nothing_of_it_vanishes(tmp_path):
    write(tmp_path, 3)
    (group,) = study(tmp_path, QUESTION).groups
    verdict = group.verdict
    assert verdict.answer is Answer.PROVEN and verdict.misses == 0 and verdict.worst_ns < 400_000
    startup = verdict.startup
    assert verdict.n == 3 * (N - startup.loops) and 200 <= startup.loops <= N // 5
    assert (startup.late, startup.absent, startup.worst_ns) == (3 * LATE, 0, 3_100_000) and startup.p_value < 1e-3
    assert group.n == 3 * N and max(digest.figures.max_ns for digest in group.digests) == 3_100_000


def test_every_format_reports_it(tmp_path, capsys):
    write(tmp_path, 3)
    sentence = "loops of each run are left out (30 late, worst 3.1 ms; p = "
    xml = tmp_path.parent / "gate.xml"
    for words in (
        ["verdict", str(tmp_path), *WORDS],
        ["gate", str(tmp_path), *WORDS, "--junit", str(xml)],
        ["gate", str(tmp_path), "-v", *WORDS],
        ["report", str(tmp_path), *WORDS, "--format", "markdown", "--output", "-"],
    ):
        main(words)
        assert sentence in " ".join(capsys.readouterr().out.split()), words
    assert sentence in xml.read_text()
    main(["report", str(tmp_path), *WORDS, "--format", "html", "--output", str(tmp_path.parent / "report.html")])
    assert sentence in (tmp_path.parent / "report.html").read_text()
    capsys.readouterr()
    for words in (["report", "--format", "json", "--output", "-"], ["verdict", "--json"]):
        main([words[0], str(tmp_path), *WORDS, *words[1:]])
        (group,) = json.loads(capsys.readouterr().out)["groups"]
        assert group["verdict"]["startup"]["late"] == 30, words


def test_a_gate_of_several_answers_names_it_beside_its_own(tmp_path, capsys):
    write(tmp_path, 3)
    oneshot_run(tmp_path, "b", latencies(N, 9), policy="FIFO")
    main(["gate", str(tmp_path), *WORDS])
    lines = [line for line in capsys.readouterr().out.splitlines() if "start-up" in line]
    assert len(lines) == 1 and "FIFO" not in lines[0]


def test_what_never_came_is_where_it_was(tmp_path):
    for number in range(3):
        values = _fading(number)
        values[[5, 5000]] = -(2**63)
        oneshot_run(tmp_path, f"{number}", values)
    verdict = study(tmp_path, QUESTION).groups[0].verdict
    assert (verdict.startup.absent, verdict.startup.late) == (3, 3 * (LATE - 1))
    assert (verdict.absent, verdict.late, verdict.n) == (3, 0, 3 * (N - verdict.startup.loops))


def test_runs_without_one_have_none(tmp_path):
    for number in range(3):
        oneshot_run(tmp_path, f"{number}", latencies(N, number))
    (group,) = study(tmp_path, QUESTION).groups
    assert group.verdict.startup is None and group.verdict.n == 3 * N


def test_windows_begin_after_it(tmp_path):
    write(tmp_path, 3)
    question = replace(THESIS, probability=0.05, tolerance=read_tolerance("3 of 10"))
    (group,) = study(tmp_path, question).groups
    loops = group.verdict.startup.loops
    assert group.verdict.n == 3 * (N - loops - 9) and group.verdict.misses == 0 and group.verdict.startup.late == 30


def test_all_outputs_of_a_run_leave_out_as_many_loops(tmp_path):
    for number in range(2):
        values = _fading(number)
        message_run(tmp_path, f"{number}", [values, values + 1000])
    (group,) = study(tmp_path, QUESTION).groups
    assert group.verdict.startup.late == 4 * LATE - 2 * 2  # the first message of each stands apart
    assert len({digest.startup.n for digest in group.digests}) == 1


def test_a_file_alone_is_judged_without_it(tmp_path):
    write(tmp_path, 1)
    (npy,) = tmp_path.glob("*/*.npy")
    (group,) = study(npy, QUESTION).groups
    assert group.verdict.startup.late == LATE and group.verdict.misses == 0


def test_boards_that_are_pooled_have_one_length(tmp_path):
    facts = {"kernel_release": "6.1.0-rt", "kernel_version": "#1 SMP PREEMPT_RT", "cpus": 2, "governor": "performance"}
    for number, board in enumerate("abc"):
        target = {"name": board, "boot_id": board, **facts}
        oneshot_run(tmp_path, f"001-{board}", _fading(number), target=target)
    studied = study(tmp_path, QUESTION)
    (pooled,) = studied.pooled
    assert pooled.verdict.startup.late == 3 * LATE
    assert {digest.startup.n for digest in pooled.digests} == {pooled.verdict.startup.loops}
    for group in studied.groups:
        assert group.verdict.startup is None or group.verdict.startup.loops == group.digests[0].startup.n


@pytest.fixture
def reads(monkeypatch):
    """The folders that are read."""
    folders = []
    read_series = reading.read_series

    def counting(folder, *arguments):
        folders.append(folder.name)
        return read_series(folder, *arguments)

    monkeypatch.setattr(reading, "read_series", counting)
    return folders


def test_a_later_look_reads_only_what_is_new(tmp_path, reads):
    write(tmp_path, 4)
    known = {}
    first = study(tmp_path, QUESTION, bounds=False, known=known)
    assert sorted(reads) == sorted(2 * [f"{number:03}-a" for number in range(4)])
    reads.clear()
    again = study(tmp_path, QUESTION, bounds=False, known=known)
    assert not reads
    assert [group.verdict for group in again.groups] == [group.verdict for group in first.groups]
    write(tmp_path, 1, first=4)
    (afresh,) = study(tmp_path, QUESTION, bounds=False).groups
    reads.clear()
    (later,) = study(tmp_path, QUESTION, bounds=False, known=known).groups
    assert later.verdict == afresh.verdict and later.verdict.startup.late == 5 * LATE
    if later.verdict.startup.loops == first.groups[0].verdict.startup.loops:
        assert reads == 2 * ["004-a"]
