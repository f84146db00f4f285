"""The 19 claims of the thesis, each with its examiner: confirmed, refuted, or not decided by the data at hand.

The texts and sections of the claims are in pandaboard-2014.yml.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from rtfiles.output import showing_progress
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.targets.inspection.platform import Platform
from rtrun.thesis import general, timers
from rtrun.thesis.examination import ClaimResult, Finding
from rtrun.thesis.reference import published


@dataclass(frozen=True, kw_only=True, slots=True)
class Examiner:
    """An examiner; a ``functional`` claim is about what ROS does, not how fast, and may be decided in emulation."""

    examine: Callable[[Study], ClaimResult]
    functional: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Examined:
    """A claim with what was found."""

    id: str
    section: str
    text: str
    result: ClaimResult


EXAMINERS: dict[str, Examiner] = {
    "oneshot-sub-millisecond": Examiner(examine=timers.oneshot_sub_millisecond, functional=True),
    "oneshot-ignored-without-rt": Examiner(examine=timers.oneshot_ignored_without_rt),
    "oneshot-reported-accurate": Examiner(examine=timers.oneshot_reported_accurate),
    "oneshot-400us-rare": Examiner(examine=timers.oneshot_400us_rare),
    "oneshot-latency-grows-with-timeout": Examiner(examine=timers.oneshot_latency_grows_with_timeout),
    "cyclic-negative-cluster": Examiner(examine=timers.cyclic_negative_cluster),
    "cyclic-first-two-negative": Examiner(examine=timers.cyclic_first_two_negative),
    "cyclic-frequency-kept": Examiner(examine=timers.cyclic_frequency_kept),
    "cyclic-400us-never": Examiner(examine=timers.cyclic_400us_never),
    "cyclic-degrades-above-1khz": Examiner(examine=timers.cyclic_degrades_above_1khz),
    "peaks-random": Examiner(examine=general.peaks_random),
    "nanosleep-better": Examiner(examine=general.nanosleep_better),
    "comm-first-message-worst": Examiner(examine=general.comm_first_message_worst),
    "comm-more-subscribers-broader": Examiner(examine=general.comm_more_subscribers_broader),
    "comm-higher-frequency-faster": Examiner(examine=general.comm_higher_frequency_faster),
    "comm-nothing-lost": Examiner(examine=general.comm_nothing_lost, functional=True),
    "rr-equals-fifo": Examiner(examine=general.rr_equals_fifo),
    "single-cpu-shutdown-stuck": Examiner(examine=general.single_cpu_shutdown_stuck, functional=True),
    "default-priority-unpredictable": Examiner(examine=general.default_priority_unpredictable),
}


def examine_claims(study: Study) -> tuple[Examined, ...]:
    """Examine every claim, in the order of the thesis. Timing claims are never decided by emulated runs.

    The claims are about a system with PREEMPT_RT: in a campaign on both kernels, runs on the standard one do not count.
    """
    study = _on_preempt_rt(study)
    examined = []
    for claim in showing_progress(published()["claims"], "examining claim"):
        examiner = EXAMINERS[claim["id"]]
        result = examiner.examine(study)
        if study.platform is Platform.EMULATED and not examiner.functional and result.runs:
            result = ClaimResult(
                finding=Finding.UNDECIDED,
                numbers=f"measured on an emulated board, not a real-time statement ({result.numbers})",
                test=result.test,
                runs=result.runs,
            )
        examined.append(Examined(id=claim["id"], section=claim["section"], text=claim["text"], result=result))
    return tuple(examined)


def _on_preempt_rt(study: Study) -> Study:
    """The study without the runs on the standard kernel, where there are runs on both."""
    on_standard = {record.run for record in study.records if record.kernel == "standard"}
    if all(record.kernel != "rt" for record in study.records):
        return study

    def remaining(groups: Iterable[Group]) -> tuple[Group, ...]:
        return tuple(group for group in groups if on_standard.isdisjoint(group.runs))

    return replace(
        study,
        groups=remaining(study.groups),
        groups_2014=remaining(study.groups_2014),
        others=tuple(digest for digest in study.others if digest.run not in on_standard),
        records=tuple(record for record in study.records if record.run not in on_standard),
    )
