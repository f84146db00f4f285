"""Counts that do not add up."""

import pytest
from written import write_communication, write_oneshot

from logs import LOGS_2014
from rtfiles.config import read_json
from rtrun.results.gnuplot_log import read_log
from rtrun.results.output import Record
from rtrun.validity.outcome import find_count_mismatch


@pytest.fixture
def oneshot(tmp_path):
    record = read_json(write_oneshot(tmp_path), Record)
    return changed(record, indices={"not_fired": [2]})


@pytest.fixture
def communication(tmp_path):
    record = read_json(write_communication(tmp_path), Record)
    return changed(record, indices={"missing": [4], "duplicate": [3], "out_of_order": [1]})


def changed(record, *, counts=None, indices=None, **rest):
    return record.model_copy(
        update={
            "counts": record.counts.model_copy(update=counts or {}),
            "indices": record.indices.model_copy(update=indices or {}),
            **rest,
        }
    )


def test_what_adds_up(oneshot, communication):
    assert find_count_mismatch(oneshot) is None
    assert find_count_mismatch(communication) is None


def test_a_measurement_that_vanished(oneshot, communication):
    assert find_count_mismatch(changed(oneshot, counts={"measured": 2})) == (
        "4 asked for, but 3 measured + not fired + missing"
    )
    assert find_count_mismatch(changed(communication, counts={"missing": 0}, indices={"missing": []})) is not None


def test_an_incomplete_run_may_have_less(oneshot):
    assert find_count_mismatch(changed(oneshot, counts={"measured": 2}, complete=False)) is None


def test_indices_and_counts(oneshot, communication):
    assert (
        find_count_mismatch(changed(communication, indices={"duplicate": []})) == "1 duplicate, but 0 indices of them"
    )
    assert "outside 0 to 3" in (find_count_mismatch(changed(oneshot, indices={"not_fired": [4]})) or "")


def test_a_log_of_another_number(oneshot, tmp_path):
    log = read_log(LOGS_2014 / "cyclic_timer_tests_l300_fq1000-tnRTRR.log")
    assert find_count_mismatch(oneshot, [log]) == f"3 measured, but 300 in the log {log.path.name}"
