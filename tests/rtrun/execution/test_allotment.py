"""Which board measures what next, with boards that fail at random."""

import random
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from faulty import runs_of

from rtrun.execution.allotment import Allotment, Round, rounds_of_blocks
from rtrun.plan.run import blocks


def allot(runs, boards, owners, done, divided=None):
    divided = divided or [(run,) for run in runs]
    next_round = rounds_of_blocks(divided, {run.name for run in runs}, done, Path("nowhere"))
    return Allotment(next_round, boards, owners)


@pytest.mark.parametrize("seed", range(20))
def test_boards_that_fail_lose_no_run_and_measure_none_twice(seed):
    runs, boards = runs_of(30), [f"board{number}" for number in range(8)]
    draw = random.Random(seed)
    doomed = set(draw.sample(boards, 3))
    owners = {run.name: draw.choice([*boards, "absent"]) for run in draw.sample(list(runs), 6)}
    done, twice = {}, []
    allotment = allot(runs, boards, owners, done)

    def measure_on(board):
        last = draw.randrange(4)
        for count in range(len(runs) + 1):
            taken = allotment.take(board, ())
            if taken is None:
                break
            if board in doomed and count >= last:
                allotment.withdraw(board)
                return
            for run in taken.runs:
                twice.extend([run.name] if run.name in done else [])
                done[run.name] = board

    threads = [threading.Thread(target=measure_on, args=(board,), daemon=True) for board in boards]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads), "nobody waits for ever"
    assert set(done) == {run.name for run in runs} and not twice


def test_a_run_stays_with_the_board_that_had_begun_it():
    runs, done = runs_of(3), {}
    allotment = allot(runs, ["a", "b"], {runs[0].name: "b"}, done)
    assert allotment.take("a", ()).runs == (runs[1],)
    assert allotment.take("b", (runs[0].name,)).runs == (runs[0],)
    done |= {run.name: "ok" for run in runs[:2]}
    assert allotment.take("a", ()).runs == (runs[2],)


def test_the_run_of_a_board_that_does_not_come_back_goes_to_another():
    runs, done = runs_of(1), {}
    allotment = allot(runs, ["a", "b"], {runs[0].name: "b"}, done)
    threading.Timer(0.1, allotment.withdraw, args=("b",)).start()
    assert allotment.take("a", ()).runs == tuple(runs)


def test_a_board_that_waits_is_stopped():
    runs = runs_of(1)
    allotment = allot(runs, ["a", "b"], {}, {})
    allotment.take("a", ())
    threading.Timer(0.1, allotment.stop).start()
    with pytest.raises(KeyboardInterrupt):
        allotment.take("b", ())


def test_nobody_waits_for_an_analysis_of_all_results():
    asked, analysed = threading.Event(), threading.Event()

    def next_round(taken, begun):
        asked.set()
        analysed.wait(60)

    allotment = Allotment(next_round, ["a", "b", "c"], {})
    with ThreadPoolExecutor() as boards:
        try:
            taking = [boards.submit(allotment.take, board, ()) for board in "ab"]
            asked.wait(60)
            boards.submit(allotment.withdraw, "c").result(20)
            boards.submit(allotment.stop).result(20)
            for board in taking:
                with pytest.raises(KeyboardInterrupt):
                    board.result(20)
        finally:
            analysed.set()


def test_what_a_board_leaves_while_another_asks_is_not_lost():
    (run,) = runs_of(1)

    def next_round(taken, begun):
        if not taken:
            return Round(runs=(run,))
        allotment.withdraw("b")
        return None

    allotment = Allotment(next_round, ["a", "b"], {})
    assert allotment.take("b", ()).runs == allotment.take("a", ()).runs == (run,)


def test_a_failure_of_the_analysis_is_that_of_the_board_that_asked():
    allotment = Allotment(lambda *_: 1 / 0, ["a", "b"], {})
    for board in ("a", "b"):
        with pytest.raises(ZeroDivisionError):
            allotment.take(board, ())


def test_boards_that_wait_ask_again_only_when_something_has_changed():
    asked = []

    def next_round(taken, begun):
        asked.append(taken)
        return None if taken else Round(runs=tuple(runs_of(1)))

    allotment = Allotment(next_round, ["a", "b", "c"], {})
    allotment.take("a", ())
    with ThreadPoolExecutor() as boards:
        waiting = [boards.submit(allotment.take, board, ()) for board in "bc"]
        time.sleep(0.5)
        allotment.stop()
        assert all(isinstance(board.exception(20), KeyboardInterrupt) for board in waiting)
    assert len(asked) <= 4, "once each, and once more where the other came in between"


def test_boards_share_whole_repeats_and_a_campaign_of_one_repeat_run_by_run():
    runs = runs_of(3, repeats=2)
    shared = blocks(runs, is_shared=True)
    assert [{run.repeat for run in block} for block in shared] == [{1}, {2}]
    assert [len(block) for block in blocks(runs_of(3), is_shared=True)] == [1, 1, 1]
    assert blocks(runs) == [tuple(runs)], "one board measures them in their order"
