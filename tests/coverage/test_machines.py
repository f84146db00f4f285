"""Machines that are drawn at random are what they say: their truth, their files, and what the tables make of them."""

import json
import math
import sqlite3
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import machines
import simulate
from drawn.files import DEADLINE_NS, MISSING
from drawn.hazards import HAZARDS, hazards_of, named_in
from drawn.machine import Machine
from drawn.tables import Tables, lower_bound
from drawn.users import User
from rows import ROWS

from rtrun.results.reading import read_runs

# Of what climbs or steps, the truth is that of a time that is not measured.
MEASURED = [name for name, hazard in HAZARDS.items() if "trend" not in hazard.slots]


def _seeds(*names, count):
    found = (seed for seed in range(100_000) if hazards_of(seed) == names)
    return [next(found) for _ in range(count)]


def _late_of_truth(seed):
    """What is late of many runs of a machine, each on a boot and a board of its own and at any hour."""
    machine = Machine(seed)
    shares = []
    for _ in range(100):
        machine._effects.clear()
        slot = machine.slots[machine.rng.integers(len(machine.slots))]
        hour = int(machine.rng.integers(24))
        values = machine.new_attempt(replace(slot, place=replace(slot.place, hour=hour)))[0][0]
        shares.append(np.mean((values > DEADLINE_NS) | (values == MISSING)))
    return np.mean(shares) / machine.truths[0]


@pytest.mark.parametrize("name", MEASURED)
def test_so_much_is_late_as_the_truth_says(name):
    ratios = [_late_of_truth(seed) for seed in _seeds(name, count=8)]
    assert abs(np.mean(ratios) - 1) < 4 * np.std(ratios) / math.sqrt(len(ratios)) + 0.02


@pytest.mark.parametrize(("name", "ahead"), [("leak", 0.25), ("climb", 0.0), ("ramp", 0.05)])
def test_what_climbs_is_asked_about_after_what_is_measured(name, ahead):
    machine = Machine(_seeds(name, count=1)[0])
    climb = machine.plan.factors[0].climb
    after = np.exp(climb * ahead * (np.arange(100_000) + 0.5) / 100_000)
    assert machine.truths[0] == pytest.approx(np.minimum(1, machine.scale * after).mean(), rel=1e-3)
    for slot in machine.slots:
        assert np.max(machine.plan.factors[0].at(slot.place, machine.rng, slot.loops)) <= 1


def test_a_step_is_asked_about_as_it_was_when_somebody_asked():
    machine = Machine(_seeds("step", count=1)[0])
    step = machine.plan.factors[0]
    runs = len(machine.slots)
    before = sum((number + 0.5) / runs < step.at_share for number in range(runs))
    assert 0 < before < runs
    assert machine.truths_after(before) != machine.truths_after(before + 1) == machine.truths
    as_it_was = machine.scale * step.before
    assert machine.truths_after(before)[0] == pytest.approx(min(1, as_it_was), rel=0.05)


def test_the_truth_is_where_it_is_aimed_at():
    for machine in map(Machine, range(100)):
        assert any(truth == pytest.approx(machine.aim * machine.plan.probability) for truth in machine.truths)


@pytest.mark.parametrize("name", HAZARDS)
def test_the_command_line_answers(name):
    line = machines.examine(_seeds(name, count=1)[0])
    assert line["hazards"] == (name,)
    assert line["status"] in (0, 1), line.get("error")


@pytest.mark.parametrize("name", HAZARDS)
def test_every_run_is_read_whole(name, tmp_path):
    machine = Machine(_seeds(name, count=1)[0])
    User(machine, tmp_path).measure_and_ask()
    runs = read_runs(tmp_path / "results")
    assert not runs.refused
    values = sum(result.figures.n for run in runs.runs for result in run.results if result.header.is_usual)
    if not HAZARDS[name].is_structural and name != "looks":
        # But for the first values of each run, which stand apart.
        loops = machine.plan.threads * sum(slot.loops for slot in machine.slots)
        lost = sum(result.header.missing for run in runs.runs for result in run.results)
        assert loops - 2 * machine.plan.threads * len(machine.slots) <= values + lost <= loops


def test_a_stall_of_ten_calls_ends_with_all_of_them_late():
    machine = Machine(_seeds("bursts", count=1)[0])
    left = machine._stalls(np.full(20_000, 0.01))
    starts = np.flatnonzero((left[1:] > left[:-1]) & (left[:-1] == 0)) + 1
    assert starts.size
    for start in starts:
        assert left[start] >= 1
    falls = np.diff(left)
    assert set(falls[falls < 0]) == {-1}


def _tree(folder):
    files = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    journal = sqlite3.connect(folder / "results/journal.sqlite")
    events = journal.execute("SELECT * FROM event").fetchall()
    journal.close()
    return {name: data for name, data in files.items() if "journal" not in name.name}, events


@pytest.mark.parametrize("name", ["failures", "missed rates", "looks", "gaps"])
def test_a_seed_gives_the_same_files_and_the_same_answer(name, tmp_path):
    [seed] = _seeds(name, count=1)
    answers = [User(Machine(seed), tmp_path / which).measure_and_ask() for which in "ab"]
    assert answers[0] == answers[1]
    assert _tree(tmp_path / "a") == _tree(tmp_path / "b")


def test_what_fails_is_kept_as_the_runner_keeps_it(tmp_path):
    kept = {"failures": "*.old-1/run.json", "missed rates": "*.old-1/run.json", "hangs": "*.incomplete-1/*.npy"}
    for name, pattern in kept.items():
        seeds = _seeds(name, count=6)
        for seed in seeds:
            User(Machine(seed), tmp_path / str(seed)).measure_and_ask()
        found = [path for seed in seeds for path in (tmp_path / str(seed)).glob(f"results/{pattern}")]
        assert found, name
        if pattern.endswith("run.json"):
            assert {json.loads(path.read_text())["status"] for path in found} <= {"failed", "invalid", "ok"}
            assert any(json.loads(path.read_text())["status"] != "ok" for path in found)


def _line(*hazards, passed=True, truth=1.0, said=(), visible=(), edge=True):
    return {
        "seed": 1,
        "hazards": list(hazards),
        "edge": edge,
        "p": 1e-2,
        "truths": [truth * 1e-2],
        "passed": passed,
        "refuted": False,
        "said": list(said),
        "visible": list(visible),
    }


def test_a_row_fails_where_the_lower_bound_is_above_five_percent():
    # Of 100, 14 are above 5 % at 99.9 %, 13 are not (scipy.stats.beta.ppf).
    assert lower_bound(14, 100) > 0.05 > lower_bound(13, 100)
    for wrong, failures in ((14, ["climb"]), (13, [])):
        lines = [_line("climb", passed=number < wrong) for number in range(100)]
        assert Tables(lines).failures() == failures


def test_false_is_what_the_truth_contradicts():
    tables = Tables([])
    assert tables.share([_line("climb", truth=0.95)], "passed").of == 0
    assert tables.share([_line("climb", truth=1.05)], "passed").of == 1
    assert tables.share([_line("climb", truth=1.05)], "refuted").of == 0
    assert tables.share([_line("climb", truth=0.95)], "refuted").of == 1
    assert tables.share([_line("climb", edge=False)], "passed").of == 0


def test_a_caveat_excuses_what_nobody_saw_and_what_is_not_said_of_everything():
    wrong = [_line("bad boots", said=["bad boots"]) for _ in range(100)]
    others = [_line("climb", truth=0.1) for _ in range(100)]
    assert Tables(wrong + others).failures() == []
    assert Tables(others).share(wrong, "passed").wrong == 100
    # One that everything carries, one of another hazard, and one of what stands in the files.
    everything = [{**line, "said": ["bad boots"]} for line in others]
    assert Tables(wrong + everything).failures() == ["bad boots"]
    of_another = [{**line, "said": ["climb"]} for line in wrong]
    assert Tables(of_another + others).failures() == ["bad boots"]
    seen = [{**line, "visible": ["bad boots"]} for line in wrong]
    assert Tables(seen + others).failures() == ["bad boots"]


def test_a_caveat_names_a_hazard_with_a_number():
    assert "bad boots" in named_in("boots of another kind may be 71 % of all")
    assert "bad boots" not in named_in("holds for 3 boots; boots of another kind may be there")
    assert "bad boots" not in named_in("0 of 300 late")


def test_pairs_are_those_of_two_hazards_alone():
    lines = [_line("AR", "climb", passed=False)] * 400 + [_line("AR", "climb", "looks")] * 400
    assert [name for name, _ in Tables(lines).pair_rows(400)] == ["AR + climb"]
    assert Tables(lines).failures() == ["AR", "climb", "looks"], "with others, and not the pair"


def test_results_of_another_state_and_a_line_that_was_cut_off_are_left_out(tmp_path):
    path = tmp_path / "lines"
    path.write_text('{"seed": 1, "digest": "a"}\n{"seed": 2, "digest": "b"}\n{"seed": 3, "dig')
    assert [line["seed"] for line in machines.read_lines(path, "a")] == [1]


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The page of the tables as it is, for both programs that write there."""
    copy = tmp_path / "coverage.md"
    copy.write_text(machines.PAGE.read_text())
    monkeypatch.setattr(machines, "PAGE", copy)
    monkeypatch.setattr(simulate, "PAGE", copy)
    monkeypatch.setattr(simulate, "TABLE", tmp_path / "one-hazard.csv")
    return copy


def test_what_is_gone_on_with_is_not_drawn_again(tmp_path, page, monkeypatch):
    monkeypatch.setattr(machines, "digest", lambda: "a")
    path = tmp_path / "lines"
    path.write_text(json.dumps(_line() | {"seed": 0, "digest": "a"}) + '\n{"cut o')
    drawn = []

    def run(seeds, until, lines, state):
        drawn.extend(next(seeds) for _ in range(3))

    monkeypatch.setattr(machines, "run", run)
    monkeypatch.setattr(sys, "argv", ["machines.py", "--lines", str(path)])
    assert machines.main() == 0
    assert drawn == [1, 2, 3]


def test_a_run_goes_on_after_a_line_that_was_cut_off(tmp_path):
    path = tmp_path / "lines"
    path.write_text('{"cut o')
    machines.run(iter(_seeds("heavy tails", count=2)), math.inf, path, "a")
    assert len(machines.read_lines(path, "a")) == 2


def _lines_of(count):
    """Results of so many machines of each hazard, a second each."""
    lines = [_line(name, passed=False) | {"s": 1.0} for name in HAZARDS for _ in range(count)]
    return [line | {"seed": seed, "digest": "a"} for seed, line in enumerate(lines)]


@pytest.fixture
def write(tmp_path, page, monkeypatch):
    """Let machines.py write the page, which has no full run yet, from results, with no new machine; return the page."""
    begin, _, rest = page.read_text().partition(machines.BEGIN)
    page.write_text(
        f"{begin}{machines.BEGIN}\n{machines.PARTIAL}\n<!-- to here -->{rest.partition('<!-- to here -->')[2]}"
    )
    monkeypatch.setattr(machines, "digest", lambda: "a")
    monkeypatch.setattr(machines, "run", lambda *_: None)
    for module in ("drawn.tables", "machines"):
        monkeypatch.setattr(f"{module}.HAZARD_LEAST", 30)
    monkeypatch.setattr("drawn.tables.PAIRS_SHOWN", 0)
    path = tmp_path / "lines"

    def write(lines, *options):
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        monkeypatch.setattr(sys, "argv", ["machines.py", "--lines", str(path), *options])
        assert machines.main() == 0
        return page.read_text()

    return write


def test_a_partial_run_is_written_and_says_what_it_rests_on(write):
    lines = _lines_of(30)
    text = write(lines[1:])
    assert f"{machines.PARTIAL} These tables rest on {len(lines) - 1} machines (seeds 1 to {len(lines) - 1}), " in text
    assert f"This one lacks: {next(iter(HAZARDS))}: 29 of 30 machines." in text
    assert "| climb | 0.0 % of 30 |" in text


def test_a_full_run_replaces_a_partial_one_and_no_partial_one_replaces_it(write):
    lines = _lines_of(30)
    write(lines[1:])
    full = write(lines)
    assert machines.PARTIAL not in full
    assert f"A full run: {len(lines)} machines (seeds 0 to {len(lines) - 1}), " in full
    assert write(lines[1:]) == full


def test_a_run_without_pairs_is_no_full_one(write, monkeypatch):
    monkeypatch.setattr("drawn.tables.PAIRS_SHOWN", 1)
    assert "This one lacks: 0 of 1 pairs." in write(_lines_of(30))


def test_the_worst_pairs_are_examined_further(monkeypatch):
    """At first all seeds, until each hazard has its machines; then those of the pairs that were worst long before."""
    for name, value in (("HAZARD_LEAST", 20), ("_OF_A_PAIR", 3), ("_IN_WORK_MAX", 10)):
        monkeypatch.setattr(machines, name, value)
    monkeypatch.setattr("drawn.tables.PAIRS_SHOWN", 2)
    asked = []

    def tables(below):
        asked.append(below)
        # Of any three pairs the second is never wrong.
        pairs = ("AR", "climb"), ("AR", "leak"), ("AR", "step")
        lines = [_line(*pair, passed=pair != ("AR", "leak")) for pair in pairs for _ in range(40)]
        return Tables(lines)

    chosen = list(machines.wanted({3, 5}, None, tables))
    (below,) = asked
    first = [seed for seed in chosen if seed <= below + 10]
    assert first == [seed for seed in range(below + 11) if seed not in (3, 5)]
    counts = Counter(name for seed in range(below + 11) for name in hazards_of(seed))
    before = Counter(name for seed in range(below + 10) for name in hazards_of(seed))
    assert min(counts[name] for name in HAZARDS) == 20 > min(before[name] for name in HAZARDS)
    of_pairs = Counter(tuple(hazards_of(seed)) for seed in [*range(below + 11), *chosen[len(first) :]])
    assert {tuple(hazards_of(seed)) for seed in chosen[len(first) :]} <= {("AR", "climb"), ("AR", "step")}
    assert min(of_pairs["AR", "climb"], of_pairs["AR", "step"]) >= 3


def test_machines_of_one_hazard_or_none_are_not_written(write, page):
    before = page.read_text()
    assert write(_lines_of(30), "--only", "climb") == before
    assert write([]) == before


def test_each_program_leaves_what_the_other_wrote(write, page):
    machines_alone = write(_lines_of(30))
    row = next(row for row in ROWS if row.at_most == 5)
    simulate.write([simulate.Drawn(row=row, events=1, draws=100)], 1)
    both = page.read_text()
    assert f"| {row.name} | {row.event} | 1.0 % (0.0 to 5.4) | at most 5 % |" in both
    assert simulate.TABLE.read_text().splitlines()[1].endswith(",1.0,0.03,5.45,0.0,5.0,100")
    of_machines = both.partition(simulate.BEGIN)[0]
    assert of_machines == machines_alone.partition(simulate.BEGIN)[0]
    assert write(_lines_of(31)).partition(simulate.BEGIN)[2] == both.partition(simulate.BEGIN)[2]
    assert page.read_text().partition(simulate.BEGIN)[0] != of_machines
