"""Messages: how long after its publication each one came, and which never came."""

import re
from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import LogForm, MeasurementKind, StreamKind
from rtrun.kinds.rows import MAX_ABSENT, Columns, Stated, agree, check_times, disagree, without
from rtrun.kinds.values import IndexedValues, Int64s, no_values

LATENCY, HANDLED = "latency", "handled"
"""Its series."""
NOT_SEEN_NS = -(2**63)
"""Instead of a time that was not seen."""


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    publication, reception, arrived = columns["publication_ns"], columns["reception_ns"], columns["seq"]
    check_times(path, publication, reception)
    is_in_order = bool(np.all(arrived[1:] > arrived[:-1]))
    # Most samples are in order. Sorting them would take longer than all the figures.
    seq, order = (arrived, slice(None)) if is_in_order else np.unique(arrived, return_index=True)
    first, last = (int(seq[0]), int(seq[-1])) if seq.size else (0, -1)
    if first < 0 or last >= stated.asked:
        raise UsageError(
            f"{disagree(path)}: seq: {first} to {last} in the rows, {stated.asked} asked for in the counts"
        )
    if len(seq) != len(arrived):
        raise UsageError(
            f"{disagree(path)}: seq: {len(arrived) - len(seq)} numbers stand in the rows again, which hold each once"
        )
    agree(path, "measured", len(seq), stated.measured)
    # A subscriber that did not get the last message knows only the gaps between the messages that came.
    missing = range(last + 1 - len(seq), stated.asked - len(seq) + 1)
    if stated.missing not in (missing[-1:] if stated.is_complete else missing):
        agree(path, "missing", missing[-1], stated.missing)
    falls = 0 if is_in_order else int(np.count_nonzero(arrived[1:] < arrived[:-1]))
    agree(path, "out of order", falls, stated.out_of_order)
    absent = _absent(seq, stated.asked, path) if stated.missing else no_values()
    series = {LATENCY: IndexedValues(values_ns=(reception - publication)[order], index=seq, absent=absent)}
    if "callback_end_ns" in columns:
        end = columns["callback_end_ns"]
        handled = np.flatnonzero((end != NOT_SEEN_NS)[order])
        values = (end - publication)[order][handled]
        check_times(path, values)
        series[HANDLED] = IndexedValues(values_ns=values, index=seq[handled])
    return series


def _absent(index: Int64s, asked: int, path: Path) -> Int64s:
    if asked - len(index) > MAX_ABSENT:
        raise UsageError(
            f"{path}: {asked} were asked for, {len(index)} came: none with more than {MAX_ABSENT} missing is read"
        )
    return without(index, asked)


def _times(columns: Columns, values: IndexedValues) -> Int64s:
    # Rows are in the order of reception, values in that of their numbers.
    seq = columns["seq"]
    order = np.argsort(seq, kind="stable")
    return np.asarray(columns["reception_ns"][order[np.searchsorted(seq, values.index, sorter=order)]])


STREAM = StreamKind(
    word="messages",
    suite="observed_messages",
    summary="messages of programs that run already, from publication to reception",
    columns=("publication_ns", "reception_ns", "seq", "callback_end_ns"),
    named_by="topic",
    is_plain=True,
    words=("{topic}", "{publisher}", "-> {subscriber}"),
    at="reception_ns",
    index="seq",
    filled={"callback_end_ns": NOT_SEEN_NS},
    overdue="nothing of what was published in the last {} was taken, though both programs live",
    is_shown=True,
    live_words=("", "message"),
    is_traced=True,
)
KIND = MeasurementKind(
    series=_series,
    called={LATENCY: "latency"},
    times=_times,
    subject="of messages",
    # The first message.
    startup={LATENCY: 1},
    layer_below="oneshot",
    stream=STREAM,
    has_steps=True,
    logs=LogForm(
        suite="communication_tests",
        main=LATENCY,
        summary=re.compile(r"Amount messages: ([0-9]{1,12})\b"),
        series={"": LATENCY},
        missing_as_value=True,
    ),
)
