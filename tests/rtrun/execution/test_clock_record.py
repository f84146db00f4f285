"""What a run records of its clock."""

from written import write_cyclic

from rtrun.execution import clock_record
from rtrun.results.record import Clock
from rtrun.targets.inspection.facts import TargetState


def test_the_step_is_the_coarsest_that_any_program_saw():
    state = TargetState(clocksource="arch_sys_counter", clockevent="arch_sys_timer")
    assert clock_record.record(state, [16, 32]) == Clock(source="arch_sys_counter", event="arch_sys_timer", step_ns=32)


def test_a_program_that_saw_no_step_says_nothing():
    assert clock_record.record(TargetState(clocksource="arch_sys_counter"), [0]).step_ns is None


def test_the_32_khz_counter_is_coarse_even_where_no_program_tells():
    state = TargetState(clocksource="32k_counter", clockevent="local_timer")
    assert clock_record.record(state, []).step_ns == 30518
    assert clock_record.record(state, [100]).step_ns == 30518


def test_a_target_that_tells_nothing():
    assert clock_record.record(TargetState(), []) == Clock(source=None, event=None, step_ns=None)


def test_steps_come_from_what_the_programs_wrote(tmp_path):
    path = write_cyclic(tmp_path)
    deep = '{"in_effect": ' * 50_000 + "1" + "}" * 50_000
    for name, text in (("b", '{"in_effect": {}}'), ("c", "cut o"), ("d", deep)):
        (tmp_path / f"{name}.json").write_text(text)
    assert clock_record.steps_seen(tmp_path, [path.stem, "b", "c", "d", "none"], {}) == [16]
