"""The steps of a late message, on a trace of real programs and on parts."""

import pytest
from traced import specimen, write_traced_run

from rtrun.causes.outliers import explain_run
from rtrun.causes.parts import Cause, Kind, Part
from rtrun.causes.steps import Step, steps
from rtrun.causes.timeline import State
from rtrun.cli import main
from rtrun.results.record import read_record

OUTPUT = "1ct_gnuplot_l2000_fq500_pl0-tnRTRR"
SUBSCRIBER = [28179, 28197, 28198, 28199, 28200]


def test_a_message_of_real_programs_is_followed_from_publisher_to_callback(tmp_path):
    folder = write_traced_run(tmp_path, {0: specimen(0)}, SUBSCRIBER, output=OUTPUT)
    (explained,) = explain_run(folder, read_record(folder))
    assert list(explained.steps) == [step for step in Step if step is not Step.UNKNOWN]
    assert sum(explained.steps.values()) == explained.outlier.value_ns == 335_245
    # As read by hand: the publisher wakes its poll thread at .544483, that writes until .544588, the poll thread of the
    # subscriber wakes the callback at .544714 - 29 us later it had its message.
    ids = list(dict.fromkeys(part.pid for part in explained.parts if part.pid is not None))
    assert ids == [28218, 28224, 28197, 28179]
    starts = {pid: min(part.begin_ns for part in explained.parts if part.pid == pid) for pid in ids}
    assert list(starts.values()) == sorted(starts.values())


def test_why_prints_the_chain_and_the_table(tmp_path, capsys):
    write_traced_run(tmp_path, {0: specimen(0)}, SUBSCRIBER, output=OUTPUT)
    assert main(["why", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    chain = next(line for line in lines if line.startswith("  publisher ") and " > " in line)
    assert [part.rsplit(" ", 2)[0].strip() for part in chain.split(" > ")] == list(Step)[:6]
    assert any(line.startswith("Where late messages were: longest in step") for line in lines)


def test_a_container_whose_ids_are_others_has_no_steps(tmp_path):
    """Publisher and subscriber have the same names there."""
    folder = write_traced_run(tmp_path, {0: specimen(0)}, [7], output=OUTPUT)
    (explained,) = explain_run(folder, read_record(folder))
    assert explained.steps == {}
    assert sum(part.length_ns for part in explained.parts) == 335_245


def part(begin_ns, end_ns, pid=None, state=None, kind=Kind.OTHER_THREAD):
    return Part(begin_ns=begin_ns, end_ns=end_ns, cause=Cause(kind=kind), pid=pid, state=state)


@pytest.mark.parametrize(
    ("single", "step"),
    [
        (part(0, 5, 1, State.RUNNING), Step.CALLBACK),
        (part(0, 5, 1, State.RUNNING, Kind.INTERRUPT), Step.CALLBACK),
        (part(0, 5, 1, State.WAITING, Kind.HIGHER), Step.QUEUE),
        (part(0, 5, 1, State.ASLEEP, Kind.LOCK), Step.QUEUE),
        (part(0, 5, 2, State.WAITING), Step.READ),
        (part(0, 5, 3, State.RUNNING), Step.WRITE),
        (part(0, 5, kind=Kind.SOFTIRQ), Step.TRANSPORT),
        (part(0, 5, kind=Kind.UNEXPLAINED), Step.UNKNOWN),
    ],
)
def test_the_step_of_a_part(single, step):
    assert steps([single], pid=1, own=frozenset({1, 2})) == {step: 5}


def test_of_other_threads_the_last_one_wrote():
    lengths = steps([part(0, 5, 4), part(5, 6, 3), part(6, 9, 2), part(9, 10, 1)], pid=1, own=frozenset({1, 2}))
    assert lengths == {Step.PUBLISHER: 5, Step.WRITE: 1, Step.READ: 3, Step.QUEUE: 1}
