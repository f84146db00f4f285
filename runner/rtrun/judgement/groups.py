"""Runs of one suite with the same parameters: what they measured, and on which target."""

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rtrun.analysis.account import Account
from rtrun.analysis.deadline import Verdict
from rtrun.analysis.dependence.blocks import Blocks, add_outputs
from rtrun.analysis.histogram import Histogram, merge
from rtrun.analysis.tails.extreme_values import Bound
from rtrun.judgement.digest import JudgedDigest
from rtrun.kinds.known import MAIN_ONLY_IN_2014
from rtrun.kinds.lateness import Measure
from rtrun.plan.observation import stream_words
from rtrun.plan.question import Question
from rtrun.plan.short_names import format_parameters, tell_apart
from rtrun.plan.suites import Value, measures, telling_parameters
from rtrun.results.record import RunRecord
from rtrun.targets.inspection.platform import Platform

# Boards that agree in these facts of run.json, and in platform and clock step, are alike.
_ENVIRONMENT = (
    "machine",
    "cpus",
    "kernel_release",
    "kernel_version",
    "preempt_rt",
    "clocksource",
    "governor",
    "middleware_version",
)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Runs of one suite with the same parameters on the same target; outputs of one run are neighbours.

    `question` is the question that they have to answer; None: they have no deadline. A group of several boards has a
    group for each board as `members`.
    """

    suite: str
    series: str
    measure: Measure | None = None
    target: str
    parameters: dict[str, Value]
    question: Question | None
    digests: tuple[JudgedDigest, ...]
    account: Account | None
    verdict: Verdict | None
    undecidable: str | None
    bounds: tuple[Bound, ...]
    no_bound: str | None
    records: tuple[RunRecord, ...]
    members: tuple["Group", ...] = ()

    @functools.cached_property
    def key(self) -> str:
        """Distinguishes it from every other group of a study."""
        return key_of(self.target, self.digests[0])

    @property
    def boards(self) -> tuple[str, ...]:
        """The names of the targets that it was measured on."""
        return tuple(sorted({record.target.name for record in self.records}))

    @functools.cached_property
    def environment(self) -> tuple[tuple[str, str], ...]:
        """The facts in which two targets must agree for their runs to be pooled: (fact, values)."""
        facts = {fact: {str(getattr(record.target, fact)) for record in self.records} for fact in _ENVIRONMENT}
        facts |= {"platform": {str(self.platform)}, "clock step": {f"{self.clock_step_ns} ns"}}
        return tuple((fact, ", ".join(sorted(values))) for fact, values in facts.items())

    @property
    def label(self) -> str:
        """Suite and parameters in a few words; also the series, if its suite is usually judged by another one."""
        what, others = self.words
        return " ".join(filter(None, [what, format_parameters(others)]))

    @functools.cached_property
    def words(self) -> tuple[str, dict[str, Value]]:
        """What was measured in a few words, and the parameters that these do not name."""
        is_named = self.series in MAIN_ONLY_IN_2014 or (
            self.measure is not None and self.measure != measures(self.suite)[0]
        )
        observed, others = stream_words(self.suite, self.parameters)
        words = [observed or self.suite.removesuffix("_tests"), self.series if is_named else ""]
        return " ".join(filter(None, words)), others

    @property
    def platform(self) -> Platform:
        """What it was measured on."""
        return self.digests[0].header.platform

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of its runs, each once."""
        return tuple(dict.fromkeys(digest.run for digest in self.digests))

    @property
    def n(self) -> int:
        """Measurements in all runs."""
        return sum(digest.n for digest in self.digests)

    @functools.cached_property
    def blocks(self) -> tuple[Blocks, ...]:
        """One `Blocks` per run; its subscribers received the same messages and are added up."""
        by_run: dict[str, list[Blocks]] = {}
        for digest in self.digests:
            if digest.blocks is not None:
                by_run.setdefault(digest.run, []).append(digest.blocks)
        records = {record.run: record for record in self.records}
        return tuple(_blocks_of_run(outputs, records.get(run)) for run, outputs in by_run.items())

    @property
    def clock_step_ns(self) -> int:
        """The widest clock step that any of it was measured with; 1 where none is known."""
        return max((digest.header.clock_step_ns or 1 for digest in self.digests), default=1)

    @functools.cached_property
    def histogram(self) -> Histogram:
        """All counts: the digests of a group have bins of one width."""
        return merge(digest.histogram for digest in self.digests)


def short_names(groups: Sequence[Group]) -> dict[str, str]:
    """The short name of each group, by its key: what it measures, and the parameters that distinguish it from the
    others."""
    names = tell_apart([group.words for group in groups])
    return {group.key: name for group, name in zip(groups, names, strict=True)}


def key_of(target: str, digest: JudgedDigest) -> str:
    """The key of the group of a digest, which is of this target: the same for all digests of a group."""
    return json.dumps([target, *scenario(digest)])


def scenario(digest: JudgedDigest) -> list[Any]:
    """What was measured for which deadline, wherever that was."""
    header, deadline_ns = digest.header, digest.question and digest.question.deadline_ns
    telling = sorted(telling_parameters(header.parameters).items())
    return [header.suite, header.series, deadline_ns, digest.histogram.bin_ns, telling]


def slowest(alike: Sequence[JudgedDigest]) -> list[JudgedDigest]:
    """From each run the output with the highest value: subscribers of one run peak at the same messages."""
    worst: dict[str, JudgedDigest] = {}
    for digest in alike:
        known = worst.get(digest.run)
        if known is None or (digest.figures.max_ns or 0) > (known.figures.max_ns or 0):
            worst[digest.run] = digest
    return list(worst.values())


def _blocks_of_run(outputs: Sequence[Blocks], record: RunRecord | None) -> Blocks:
    blocks = add_outputs(outputs)
    if record is None:
        return blocks
    return replace(blocks, boot=str(record.target.boot_id or ""), start_time=record.start_time)
