"""The ranking of culprits over many outliers."""

import re

import pytest

from rtrun.causes.control import Windows
from rtrun.causes.outliers import Explained, Outlier
from rtrun.causes.parts import Cause, Kind, Part
from rtrun.causes.ranking import rank
from rtrun.causes.remedies import read_remedies, remedy
from rtrun.causes.waits import EVENTS_MISSING
from rtrun.report.causes import answer, table
from rtrun.targets.inspection.rt_readiness import read_checks


def outlier(*causes, usual=None, windows=10, pid=None):
    """An outlier whose causes (kind, name, us) follow each other; `usual` are us by name in each of the windows."""
    parts, at_ns = [], 0
    for kind, name, us in causes:
        end_ns = at_ns + 1000 * us
        parts.append(Part(begin_ns=at_ns, end_ns=end_ns, cause=Cause(kind=kind, name=name, pid=pid), cpu=0))
        at_ns = end_ns
    window = {name: 1000 * us for name, us in (usual or {}).items()}
    about = Outlier(run="r", output="o", index=0, value_ns=at_ns, at_ns=at_ns, clock="c", trace="t")
    control = Windows(count=windows, times_ns={0: [window] * windows})
    return Explained(outlier=about, parts=tuple(parts), control=control)


def test_the_main_cause_of_most_outliers_is_named():
    ranked = rank(
        [outlier((Kind.HIGHER, "hog", 900), (Kind.SOFTIRQ, "RCU", 100))] * 3 + [outlier((Kind.LOCK, "x", 9000))]
    )
    assert [(culprit.name, culprit.main, culprit.count) for culprit in ranked.culprits] == [
        ("hog", 3, 3),
        ("x", 1, 1),
        ("RCU", 0, 3),
    ]
    assert ranked.named == ranked.culprits[0]
    assert (ranked.outliers, ranked.late_ns) == (4, 12_000_000)
    assert (ranked.culprits[0].total_ns, ranked.culprits[0].worst_ns) == (2_700_000, 900_000)


def test_a_frequent_thread_is_not_blamed_for_being_frequent():
    """It has the CPU as long at any other time, when nothing is late."""
    frequent = [outlier((Kind.HIGHER, "frequent", 500), (Kind.TIMER_LATE, "x", 400), usual={"frequent": 450})] * 2
    ranked = rank(frequent)
    assert ranked.named is None
    culprit = next(culprit for culprit in ranked.culprits if culprit.name == "frequent")
    assert (culprit.extra_ns, culprit.windows, culprit.as_long) == (100_000, 20, 20)


def test_who_ran_while_interrupts_were_off_is_not_blamed_for_always_running():
    """A load that has the CPU all the time has it also when the host does not run the virtual machine."""
    assert rank([outlier((Kind.TIMER_LATE, "load", 1000), usual={"load": 1000})] * 3).named is None
    assert rank([outlier((Kind.NOT_PREEMPTED, "disk", 1000), usual={"disk": 600})] * 8).named is None
    assert rank([outlier((Kind.NOT_PREEMPTED, "disk", 1000), usual={"disk": 600})] * 10).named is not None, "no chance"
    named = rank([outlier((Kind.TIMER_LATE, "driver", 1000), usual={"driver": 10})] * 3).named
    assert named is not None
    assert named.name == "driver"


def test_one_outlier_alone_names_nobody_by_circumstances():
    assert rank([outlier((Kind.TIMER_LATE, "driver", 1000))]).named is None
    assert rank([outlier((Kind.HIGHER, "hog", 1000))]).named is not None


@pytest.mark.parametrize("kind", [Kind.NOT_PREEMPTED, Kind.TIMER_LATE, Kind.HIGHER])
def test_processes_of_one_name_are_one_culprit(kind):
    """A script starts the same program again and again: each process has few of the outliers."""
    many = [outlier((kind, "dd", 1000), pid=pid) for pid in range(100, 129)]
    ranked = rank([*many, *[outlier((Kind.LOCK, "x", 1000), pid=7)] * 9])
    assert ranked.named is not None
    assert (ranked.named.name, ranked.named.main, ranked.named.threads) == ("dd", 29, 29)
    assert answer(ranked).startswith(f"{kind} dd (29 threads of this name): the main cause of 29 of 38 traced outliers")
    assert table(ranked, ()).rows[0][1] == "dd (29 threads of this name)"


def test_who_has_the_cpu_often_is_there_by_chance_in_a_few_outliers():
    """A load has the CPU for 40 % of the time, so also when the host stops the virtual machine."""
    stopped = [outlier((Kind.TIMER_LATE, "load", 1000), usual={"load": 400}, pid=pid) for pid in range(10)]
    ranked = rank(stopped[:3])
    assert ranked.named is None
    assert answer(ranked).startswith(
        "Perhaps: timer interrupt late during load (3 threads of this name): the main cause"
    )
    assert rank(stopped).named is not None, "of ten outliers it is no chance"


def test_processes_with_a_number_in_the_name_are_one_culprit():
    """Each job is a process of its own; names with numbers that are there all the time are of different things."""
    jobs = [outlier((Kind.HIGHER, f"job{pid}", 1000), pid=pid) for pid in range(100, 104)]
    ranked = rank([*jobs, *[outlier((Kind.HIGHER, f"irq/{pid}-eth", 1000), pid=pid) for pid in (7, 8)] * 2])
    assert [(culprit.main, culprit.threads + culprit.alike) for culprit in ranked.culprits] == [(4, 4), (2, 1), (2, 1)]
    assert re.search(r"higher priority job10\d \(4 threads of such names\): the main cause of 4 of 8", answer(ranked))
    devices = outlier((Kind.HIGHER, "irq/7-eth", 600), (Kind.HIGHER, "irq/8-eth", 400), pid=7)
    assert [culprit.name for culprit in rank([devices]).culprits] == ["irq/7-eth", "irq/8-eth"]
    workers = [outlier((Kind.HIGHER, f"kworker/1:{pid}", 1000), pid=pid) for pid in (7, 8)] * 2
    assert [culprit.main for culprit in rank(workers).culprits] == [4]


def test_many_who_share_a_cpu_are_the_cause_together():
    """No thread of a build is the main cause of half of the outliers, but that they share the CPU is of all."""
    names = ("cc1", "as", "ld", "make", "sh", "cmake")
    ranked = rank(outlier((Kind.SHARED, name, 600), (Kind.SHARED, "python", 400)) for name in names)
    assert answer(ranked) == (
        "thread that shares the CPU without real-time priority, none of them alone: the main cause of 6 of 6 traced "
        "outliers, 100 % of their lateness: as, cc1, cmake, ld, make and 2 more"
    )
    assert [note for note in table(ranked, ()).notes if "-s RR" in note] == [
        "as, cc1, cmake, ld, make, sh, python: without a real-time policy a thread shares the CPU: run it with one "
        "(-s RR) (sched(7))"
    ]
    by_chance = rank(outlier((Kind.TIMER_LATE, name, 900), (Kind.SHARED, "x", 100)) for name in names)
    assert answer(by_chance).startswith("No cause stands out")


@pytest.mark.parametrize(
    ("kind", "name", "why"),
    [
        (Kind.UNEXPLAINED, "", "no event of the trace explains the wait. `rtrun why --all` lists the parts of each"),
        (Kind.UNEXPLAINED, EVENTS_MISSING, "the trace lost events there. Trace fewer of them: raise the limit ("),
        (Kind.OUTSIDE, "irq/7", "the thread had nothing to do until irq/7 woke it, and the trace does not show why"),
    ],
)
def test_what_is_known_comes_before_what_is_not_and_what_would_help(kind, name, why):
    ranked = rank([outlier((kind, name, 900), (Kind.HIGHER, "hog", 100))] * 4)
    known = "Thread of higher priority hog: 10 % of all lateness; cause not known for 4 of 4 traced outliers: "
    assert answer(ranked).startswith(known + why)
    assert answer(rank([outlier((kind, name, 900))])).startswith("Cause not known for 1 of 1 traced outlier: ")


@pytest.mark.parametrize("kind", [Kind.OWN_SLEEP, Kind.PROGRAM])
def test_the_answer_is_the_first_row_of_the_table_also_where_that_blames_nobody(kind):
    ranked = rank([outlier((kind, "x", 1000))] * 22 + [outlier((Kind.HIGHER, "hog", 1000))] * 3)
    assert ranked.named is None
    assert answer(ranked) == f"{kind} x: the main cause of 22 of 25 traced outliers, 88 % of their lateness"


def test_what_is_unexplained_is_not_named():
    ranked = rank([outlier((Kind.UNEXPLAINED, "", 900), (Kind.HIGHER, "hog", 100))])
    assert ranked.named is None
    assert ranked.culprits[0].kind is Kind.UNEXPLAINED


def test_nothing():
    assert rank([]).named is None


def test_every_kind_that_names_somebody_has_a_remedy():
    without = {Kind.UNEXPLAINED, Kind.PROGRAM, Kind.OUTSIDE, Kind.OWN_SLEEP}
    for kind in Kind:
        assert (remedy(kind, "somebody") is None) is (kind in without)
    assert all(entry.source and entry.change for entry in read_remedies())


def test_every_remedy_that_takes_away_a_safety_net_says_so():
    """Of whatever gives the advice: what switches a limit or a watchdog of the kernel off, or swap."""
    advice = [entry.advice for entry in read_remedies()] + [check.advice for check in read_checks()]
    risky = [text for text in advice if re.search(r"runtime_us=-1|watchdog=0|swapoff|swap off|scaling_max_freq", text)]
    assert len(risky) == 6
    assert all("; this takes away a safety net: " in text for text in risky)


def test_the_first_remedy_that_fits():
    stopper = remedy(Kind.HIGHER, "migration/1")
    assert stopper is not None
    assert "hotplug" in stopper.change
    other = remedy(Kind.HIGHER, "migration")
    assert other is not None
    assert "lower real-time priority" in other.change
