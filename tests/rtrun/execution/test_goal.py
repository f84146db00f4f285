"""Measuring until it is certain, on a simulated target whose true probability of a miss is known."""

import dataclasses
import zlib
from dataclasses import replace

import numpy as np
import pytest

from rtrun.analysis.account import Account
from rtrun.analysis.deadline import Answer, judge
from rtrun.analysis.standing import Standing
from rtrun.analysis.trials import count_misses
from rtrun.execution.goal import TRIES, Findings, rounds, runs_left, standings_of, stopped_by_time
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.goal import Goal
from rtrun.plan.question import THESIS
from rtrun.plan.rounds import plan_round

DEADLINE_NS = 400_000
LENGTH = 1002
# Measurements without a miss that prove P < 1e-3 at 95 %, on so many boots.
NEEDED = {1: 3688, 2: 5989, 3: 4380, 4: 4380, 5: 4380, 6: 4380}
OVERHEAD_S = 2.0


def goal(**keys):
    return Goal(**{"deadline": "400us", "probability": "1e-3", "at_most": "1h", "bursts": 1, **keys})


def groups_of(*frequencies):
    entry = {"suite": "cyclic_timer_tests", "repetitions": LENGTH, "frequency_hz": list(frequencies)}
    return plan(Campaign(schema=1, name="test", order="interleaved", seed=7, runs=[entry]), "test")


class Killed(Exception):
    """The runner was killed."""


class Board:
    """A target: `misses` holds the true P(miss) of each frequency; what it measured outlives the runner."""

    def __init__(self, misses, *, wanted, fails=(), emulated=False, tells_period=False):
        self.misses, self.wanted, self.fails, self.emulated = misses, wanted, fails, emulated
        self.tells_period = tells_period
        self.boot = 0
        self.boots = {}
        self.trials = {}
        self.calls = []
        self.spent_s = 0.0
        self.reported = []

    def measure(self, run):
        self.calls.append(run.name)
        self.spent_s += run.expected_s + OVERHEAD_S
        if run.parameters["frequency_hz"] in self.fails:
            return
        # The same run measures the same, whenever it is made.
        generator = np.random.default_rng(zlib.crc32(run.name.encode()))
        late = generator.random(LENGTH - 2) < self.misses[run.parameters["frequency_hz"]]
        values = np.where(late, 500_000, generator.integers(50_000, 90_000, LENGTH - 2)).astype(np.int64)
        self.trials[run.name] = count_misses(values, DEADLINE_NS)
        self.boots[run.name] = f"boot{self.boot}"

    def evaluate(self, groups):
        standings = []
        for group in groups:
            names = [name for name in self.trials if name.split("-r")[0] == group.name]
            trials = [self._place(name) for name in names]
            if names:
                question = replace(THESIS, probability=1e-3, boots=self.wanted.boots, bursts=self.wanted.bursts)
                period_ns = group.period_ns if self.tells_period else None
                verdict = judge(Account(trials, emulated=self.emulated, period_ns=period_ns), question)
                standings.append(
                    Standing(
                        label=group.name,
                        runs=tuple(names),
                        verdict=verdict,
                        undecidable=None,
                        measured_s=0.0,
                    )
                )
        return standings

    def _place(self, name):
        return dataclasses.replace(self.trials[name], run=name, boot=self.boots[name], start_time=name)


def rounds_of(board, groups, wanted):
    findings = Findings(
        boot_of=lambda run: board.boots.get(run.name),
        has_failed=lambda run: run.name in board.calls and run.name not in board.boots,
        evaluate=lambda: board.evaluate(groups),
        spent_s=lambda: board.spent_s,
    )
    return rounds(
        groups,
        wanted,
        7,
        {group.name: NEEDED[wanted.boots] for group in groups},
        findings,
        lambda progress, _: board.reported.append(progress),
    )


def measure(board, groups, wanted, *, calls=10**9):
    """Follow the rounds as the campaign runner does, and be killed before call number `calls`; return the standings."""
    next_round = rounds_of(board, groups, wanted)
    while current_round := next_round((), ()):
        if f"boot{board.boot}" in current_round.used_boots:
            board.boot += 1
        for run in current_round.runs:
            if len(board.calls) >= calls:
                raise Killed
            board.measure(run)
    return {name: standing.answer for name, standing in standings_of(groups, board.evaluate(groups)).items()}


@pytest.mark.parametrize(
    ("misses", "boots", "is_emulated", "answer", "calls", "restarts"),
    [
        pytest.param({1000: 0.0, 500: 0.0}, 4, False, Answer.PROVEN, 2 * 5, 4, id="five runs hold the 4380 it takes"),
        pytest.param({1000: 0.0}, 6, False, Answer.PROVEN, 6, 5, id="an answer waits for its boots"),
        pytest.param({1000: 0.0}, 2, False, Answer.PROVEN, 6, 1, id="rounds that share a boot need no restart"),
        pytest.param({1000: 0.02}, 2, False, Answer.REFUTED, 4, 1, id="it is refuted"),
        pytest.param({1000: 0.0}, 3, True, Answer.NO_STATEMENT, 1, 0, id="an emulated board is measured once"),
    ],
)
def test_it_takes_the_fewest_rounds_and_the_boots_that_were_asked_for(
    misses, boots, is_emulated, answer, calls, restarts
):
    groups, wanted = groups_of(*misses), goal(boots=boots)
    board = Board(misses, wanted=wanted, emulated=is_emulated)
    assert set(measure(board, groups, wanted).values()) == {answer}
    assert (len(board.calls), board.boot, len(set(board.boots.values()))) == (calls, restarts, restarts + 1)


def test_rounds_go_on_until_a_stall_of_10_ms_is_covered_at_the_period_of_each_group():
    groups, wanted = groups_of(1000, 100), goal(bursts=None)
    board = Board({1000: 0.0, 100: 0.0}, wanted=wanted, tells_period=True)
    assert set(measure(board, groups, wanted).values()) == {Answer.PROVEN}
    calls = [sum(name.startswith(group.name) for name in board.calls) for group in groups]
    assert calls == [37, 4], "ten times 3 688 measurements at 1 kHz, once at 100 Hz"


def test_a_group_with_its_answer_gives_its_time_to_the_others():
    groups, wanted = groups_of(1000, 500), goal(at_most="200s")
    board = Board({1000: 0.0, 500: 1e-3}, wanted=wanted)
    answers = measure(board, groups, wanted)
    assert sorted(answers.values()) == [Answer.NEEDS_MORE, Answer.PROVEN]
    fast = [name for name in board.calls if "fq1000" in name]
    assert len(fast) == 4 and not any("fq1000" in name for name in board.calls[8:])
    assert len(board.calls) - len(fast) > 30


def test_it_ends_when_the_time_is_over_and_not_later():
    groups, wanted = groups_of(1000), goal(at_most="100s")
    board = Board({1000: 1e-3}, wanted=wanted)
    assert set(measure(board, groups, wanted).values()) == {Answer.NEEDS_MORE}
    assert 100 - LENGTH / 1000 - OVERHEAD_S <= board.spent_s <= 100 + OVERHEAD_S
    assert board.reported[-1][0].left_s is None or board.reported[-1][0].left_s > 0


@pytest.mark.parametrize("misses", [{1000: 0.0, 500: 0.02, 250: 0.0}, {1000: 2e-4, 500: 0.0, 250: 3e-3}])
def test_a_runner_that_is_killed_anywhere_goes_on_as_if_nothing_had_happened(misses):
    groups, wanted = groups_of(*misses), goal(boots=3)
    whole = Board(misses, wanted=wanted)
    answers = measure(whole, groups, wanted)
    for calls in (1, 2, 3, 5, 8, len(whole.calls) - 1):
        board = Board(misses, wanted=wanted)
        with pytest.raises(Killed):
            measure(board, groups, wanted, calls=calls)
        restarts = board.boot
        assert measure(board, groups, wanted) == answers
        assert sorted(board.calls) == sorted(whole.calls), "no run is lost, none is made twice"
        assert board.boot == whole.boot and restarts <= board.boot, "no restart more than without the kill"


def test_a_round_that_a_board_holds_a_run_of_comes_first():
    """Another board had the first round, and is not there."""
    groups = groups_of(1000)
    next_round = rounds_of(Board({1000: 0.0}, wanted=goal()), groups, goal())
    (run,) = next_round((), (f"{groups[0].name}-r2",)).runs
    assert run.name == f"{groups[0].name}-r2"
    (run,) = next_round((run.name,), (run.name,)).runs
    assert run.name == groups[0].name


def test_a_run_that_always_fails_does_not_stop_the_others():
    groups, wanted = groups_of(1000, 500), goal()
    board = Board({1000: 0.0, 500: 0.0}, wanted=wanted, fails=(500,))
    answers = measure(board, groups, wanted)
    assert list(answers.values()) == [Answer.PROVEN]
    assert len([name for name in board.calls if "fq500" in name]) == TRIES


def test_what_is_left_falls_from_round_to_round():
    groups, wanted = groups_of(1000), goal(boots=2)
    board = Board({1000: 0.0}, wanted=wanted)
    measure(board, groups, wanted)
    run_s = groups[0].expected_s + OVERHEAD_S
    first, *others = [progress[0].left_s for progress in board.reported]
    assert first == pytest.approx(6 * groups[0].expected_s), "what lies between runs is not known yet"
    # As long as the second boot is the shorter one, the first counts for no more than that.
    assert others == pytest.approx([count * run_s for count in (5, 4, 3, 4, 2, 0)])
    assert runs_left(groups[0], None, NEEDED[2], 2) == 6


def test_no_number_of_runs_is_planned_for_a_group_that_changes():
    (group,) = groups_of(1000)
    noise = np.random.default_rng(1).normal(200_000, 10_000, 20_000)

    def runs_left_of(values):
        trials = [count_misses(values.astype(np.int64), DEADLINE_NS)]
        verdict = judge(Account(trials), THESIS)
        standing = Standing(label="", runs=(group.name,), verdict=verdict, undecidable="", measured_s=0.0)
        return verdict.change, runs_left(group, standing, NEEDED[2], 2)

    change, number = runs_left_of(noise * np.linspace(1, 1.5, noise.size))
    assert change is not None and number is None
    change, number = runs_left_of(noise)
    assert change is None and number > 0


def test_a_group_is_known_by_the_names_of_its_runs():
    groups = groups_of(1000, 500)

    def standing(*runs):
        return Standing(label="", runs=runs, verdict=None, undecidable="", measured_s=0.0)

    names = [[run.name for run in sorted(plan_round(groups, n, 7), key=lambda run: run.name)] for n in (1, 2, 12)]
    old, new, other = standing(names[0][0]), standing(names[2][0], names[1][0]), standing(names[0][1])
    assert standings_of(groups, [new, old, other]) == {groups_by_name(groups)[0]: new, groups_by_name(groups)[1]: other}


def test_a_group_whose_runs_fail_was_not_stopped_by_the_time():
    groups, wanted = groups_of(1000, 500, 250), goal(boots=1)
    names = groups_by_name(groups)
    board = Board({1000: 0.0, 500: 0.0, 250: 0.0}, wanted=wanted)
    assert stopped_by_time(groups, board.evaluate(groups), []) == [group.name for group in groups]
    assert stopped_by_time(groups, [], [f"{names[0]}-r2"]) == [group.name for group in groups if group.name != names[0]]
    measure(board, groups, wanted)
    assert stopped_by_time(groups, board.evaluate(groups), []) == []


def groups_by_name(groups):
    return sorted(group.name for group in groups)


def test_a_group_that_observes_needs_an_answer_of_each_stream_with_a_deadline():
    (group,) = groups_of(1000)

    def standing(stream, number, *, has_deadline=True, misses=0):
        values = np.where(np.arange(LENGTH) < misses, 500_000, 50_000).astype(np.int64)
        return Standing(
            label=stream,
            runs=(f"{stream}-{number}",),
            observed_by=(group.name if number == 1 else f"{group.name}-r{number}",),
            stream=stream,
            verdict=judge(Account([count_misses(values, DEADLINE_NS)]), replace(THESIS, probability=0.05))
            if has_deadline
            else None,
            undecidable=None,
            measured_s=0.0,
            has_deadline=has_deadline,
        )

    proven, still_open = standing("a", 2), standing("b", 1, misses=LENGTH // 20)
    assert proven.is_final and not still_open.is_final
    plain = standing("c", 2, has_deadline=False)
    assert standings_of([group], [plain, proven, still_open]) == {group.name: still_open}
    assert standings_of([group], [plain, proven]) == {group.name: proven}
    assert standings_of([group], [plain]) == {}
