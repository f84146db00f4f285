"""The processes and threads of an observation: which have ended."""

from made_flows import program

from rtrun.flows.observation_state import ObservationState
from rtrun.flows.process_table import ProcessTable
from rtrun.flows.rows import RowStore


def test_a_thread_that_is_listed_no_more_has_ended():
    table = ProcessTable(ObservationState(0, RowStore()))
    table.observe([program(1, threads=[(10, "spin"), (11, "send")])])
    ended, stays = table.thread(1, 10), table.thread(1, 11)
    table.observe([program(1, threads=[(11, "send")])])
    assert (ended.has_ended, ended.is_alive) == (True, False)
    assert (stays.has_ended, stays.is_alive) == (False, True)
    assert table.threads == {11: stays}


def test_where_no_threads_are_listed_none_has_ended():
    table = ProcessTable(ObservationState(0, RowStore()))
    table.observe([program(1, threads=[(10, "spin")])])
    thread = table.thread(1, 10)
    table.observe([program(1)])
    assert thread.is_alive and table.threads == {10: thread}


def test_what_ended_makes_room_for_what_begins():
    state = ObservationState(0, RowStore())
    table = ProcessTable(state)
    table.observe([program(1, threads=[(10, "spin")])])
    table.thread(1, 10)
    things = state._things
    table.observe([program(1, threads=[(12, "spin")])])
    table.thread(1, 12)
    assert state._things == things
