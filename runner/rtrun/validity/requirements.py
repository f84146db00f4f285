"""What a run requests, compared with what was observed while it measured."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from rtrun.plan import conditions, suites
from rtrun.plan.conditions import Background, cpu_set
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.run import Run
from rtrun.results.output import NON_MEASURING_THREADS, Record
from rtrun.results.record import Requested
from rtrun.validity.observations import APART_S, Observation, ThreadState, busy_percent, while_measuring

# A program may take this long to get its policy. Earlier observations are recorded, but make no run invalid.
STARTING_S = 10.0
NAMED_MAX = 5  # threads that a message names
# Parameters that the sampler sees, whatever a program says of itself.
_OBSERVED = ("policy", "priority", "cpu")


def requested(run: Run, background: Sequence[Background]) -> Requested:
    """What a run requests, under the names of `Observed`; None if it requests nothing."""
    has_policy = "policy" in run.parameters
    real_time = suites.is_real_time(run.parameters)
    return Requested(
        policy=(str(run.parameters["policy"]) if real_time else "OTHER") if has_policy else None,
        priority=(int(run.parameters["priority"] or 0) if real_time else 0) if has_policy else None,
        cpus=_list(run.parameters.get("cpu")),
        loads={load.program.name: load.processes for load in background},
        load_cpus=_list(run.settings.get("load_cpu")),
        governor=str(run.settings.get("governor") or "") or None,
        busy_percent=_busy_floor(run),
    )


def _busy_floor(run: Run) -> int | None:
    floor = conditions.conditions().conditions[run.condition].busy_percent
    return floor if floor and not run.settings.get("load_cpu") else None


def _list(cpus: suites.Value) -> list[int] | None:
    return sorted(cpu_set(str(cpus))) if cpus else None


def measuring_threads(
    run: Run, observations: Sequence[Observation], records: Mapping[str, Record]
) -> Iterator[ThreadState]:
    """The states of the threads that measured: those observed, and those in the suite's own json, by output."""
    for _, _, threads in _counted(run, observations, records):
        yield from threads
    for record in records.values():
        yield from _threads_of(record)


def _threads_of(record: Record) -> list[ThreadState]:
    return [state for _, state in _named_threads(record)]


def _named_threads(record: Record) -> list[tuple[str, ThreadState]]:
    """The threads that measured, by the names that the program or its middleware gave them."""
    return [
        (thread.name, (thread.policy, thread.priority, frozenset(thread.cpus)))
        for thread in record.in_effect.threads
        if thread.name not in NON_MEASURING_THREADS
    ]


def find_violation(
    run: Run, background: Sequence[Background], observations: Sequence[Observation], records: Mapping[str, Record]
) -> str | None:
    """The first thing that was not in effect as requested, in words, or None. `records` are by output."""
    asked = requested(run, background)
    seen = while_measuring(observations, is_attached=run.subject.is_observed)
    return (
        _wrong_threads(run, asked, observations, records)
        or _wrong_facts(run, records)
        or _uncounted(run, records)
        or _unseen_condition(run, background, asked, observations, seen)
        or _wrong_loads(run, background, asked, seen)
        or _wrong_governor(asked, seen)
    )


def _why_unseen(run: Run, observations: Sequence[Observation]) -> str:
    """Why the suite was not observed while it measured."""
    if run.settings.get(conditions.SAMPLER):
        return "the campaign has switched off the sampler"
    if run.least_s < STARTING_S:
        return f"the first observation comes {conditions.FIRST_OBSERVATION_S:g} s after the start; measure longer"
    return f"the sampler made {len(observations)} observations, and none while the suite measured"


def _wrong_threads(
    run: Run, asked: Requested, observations: Sequence[Observation], records: Mapping[str, Record]
) -> str | None:
    fits = _requirement_of(run)
    for output, record in records.items():
        if not fits(_threads_of(record)):
            others = [name for name, state in _named_threads(record) if not fits([state])]
            middleware = suites.middleware_of(run.suite, run.parameters)
            given = middlewares()[middleware].threads
            remark = f"; threads of {middleware} take it {given}" if given else ""
            where = f" (not so: {', '.join(others[:NAMED_MAX])}{remark})" if others else ""
            return f"{output}: asked for {_asked_words(asked)}, in effect was {_words_of(_threads_of(record))}{where}"
    for program, after_s, threads in _counted(run, observations, records):
        if not fits(threads):
            return (
                f"{program}: asked for {_asked_words(asked)}, after {after_s:.0f} s in effect was {_words_of(threads)}"
            )
    if asked.policy in (None, "OTHER") and not asked.cpus:
        return None
    # A program that writes no json must have been observed as asked for.
    states = [threads for sample in observations for threads in sample.threads.values()]
    if records or any(map(fits, states)):
        return None
    if not states:
        return f"nobody saw {_asked_words(asked)} in effect: {_why_unseen(run, observations)}"
    seen = _words_of(state for threads in states for state in threads)
    return f"asked for {_asked_words(asked)}, in effect was {seen} in each of {len(states)} observations"


def _wrong_facts(run: Run, records: Mapping[str, Record]) -> str | None:
    """Name a fact of a middleware that is not as requested, or None."""
    for output, record in records.items():
        for key, fact in record.in_effect.facts.items():
            asked = run.parameters.get(key)
            if asked not in (None, "") and str(asked) != fact:
                return f"{output}: asked for {key} {asked}, in effect was {fact or 'none'}"
    return None


def _uncounted(run: Run, records: Mapping[str, Record]) -> str | None:
    """Name a program that did not count allocations as requested, or None."""
    for output, record in records.items() if run.parameters.get(suites.ALLOCATIONS) else ():
        if record.costs is None or record.costs.allocations is None:
            return f"{output}: allocations were not counted: the library for that was not preloaded"
    return None


def _unseen_condition(
    run: Run,
    background: Sequence[Background],
    asked: Requested,
    observations: Sequence[Observation],
    seen: Sequence[Observation],
) -> str | None:
    if (background or asked.governor) and not seen:
        return f"nobody saw condition {run.condition} in effect: {_why_unseen(run, observations)}"
    return None


def _wrong_loads(
    run: Run, background: Sequence[Background], asked: Requested, seen: Sequence[Observation]
) -> str | None:
    for load in background:
        name = load.program.name
        for sample in seen:
            processes, cpus = sample.loads.get(name, (0, frozenset()))
            if processes < load.processes:
                return (
                    f"condition {run.condition}: {name} had {processes} of {load.processes} processes "
                    "while the suite ran"
                )
            if asked.load_cpus and load.is_load and not cpus <= set(asked.load_cpus):
                return f"condition {run.condition}: {name} ran on CPUs {sorted(cpus)}, not on {asked.load_cpus}"
    busy = busy_percent(seen)
    if asked.busy_percent is not None and busy is not None and busy < asked.busy_percent:
        return f"condition {run.condition}: the CPUs were {busy} % busy, below {asked.busy_percent} %"
    return None


def _wrong_governor(asked: Requested, seen: Sequence[Observation]) -> str | None:
    if not asked.governor:
        return None
    others = {name for sample in seen for name in sample.governor} - {asked.governor}
    if others:
        return f"asked for the governor {asked.governor}, in effect was {', '.join(sorted(others))}"
    return None


def _counted(
    run: Run, observations: Sequence[Observation], records: Mapping[str, Record]
) -> Iterator[tuple[str, float, tuple[ThreadState, ...]]]:
    """Yield the threads of each program at each observation that counts, and the time since its first, in seconds.

    A program that starts has no priority yet, and a program that has measured, or stopped early, gives it up. So
    observations before the first one that is as requested, and after the last such one, do not count, unless the
    program has had STARTING_S, or should still be measuring. While a busy target is observed, a program may end.
    """
    fits = _requirement_of(run)
    complete = all(record.complete for record in records.values())
    for program in dict.fromkeys(name for sample in observations for name in sample.threads):
        states = [(sample, sample.threads[program]) for sample in observations if program in sample.threads]
        first_s, fitting = states[0][0].uptime_s, [sample for sample, threads in states if fits(threads)]
        begin_s = min([first_s + STARTING_S, *(sample.uptime_s for sample in fitting)])
        end_s = max([first_s - APART_S + run.least_s if complete else 0.0, *(sample.until_s for sample in fitting)])
        for sample, threads in states:
            if begin_s <= sample.uptime_s and sample.until_s <= end_s:
                yield program, sample.uptime_s - first_s, threads


def _requirement_of(run: Run) -> Callable[[Iterable[ThreadState]], bool]:
    """Return a check whether threads are as requested: all of them, or as many as the run's scope names."""
    asked = requested(run, [])

    def fits(state: ThreadState) -> bool:
        policy, priority, cpus = state
        allowed = asked.cpus is None or cpus <= set(asked.cpus)
        return allowed and (asked.policy is None or (policy, priority) == (asked.policy, asked.priority))

    if "threads" in run.parameters:  # cyclictest: its main thread only waits
        least = int(run.parameters["threads"] or 1)
        return lambda threads: sum(map(fits, threads)) >= least
    if run.parameters.get("rt_scope") == "measuring-thread":
        return lambda threads: any(map(fits, threads))
    return lambda threads: all(map(fits, threads))


def _asked_words(asked: Requested) -> str:
    return _words(asked.policy, asked.priority, asked.cpus)


def _words_of(threads: Iterable[ThreadState]) -> str:
    texts = dict.fromkeys(_words(policy, priority, sorted(cpus)) for policy, priority, cpus in threads)
    return "; ".join(list(texts)[:4]) or "nothing"


def _words(policy: str | None, priority: int | None, cpus: list[int] | None) -> str:
    on = f" on CPUs {','.join(map(str, cpus))}" if cpus is not None else ""
    return f"{policy or 'any policy'} {priority if priority is not None else ''}".rstrip() + on


def find_unseen_option(run: Run, understood: Mapping[str, suites.Value]) -> str | None:
    """Name an option of a run that cannot be seen in effect, or None. `understood` is what the program reports.

    The programs of 2014 silently ignore unknown options, so an option that is not among `understood` may have had no
    effect. Policy, priority and CPUs are observed from outside.
    """
    for name, value in run.parameters.items():
        option = suites.options().get(name)
        if name in understood or name in _OBSERVED or option is None or value in (None, "", option.default):
            continue
        if option.is_of_2014:
            continue
        return f"asked for {name} {value}, but nobody can see it in effect: the program does not say that it knows it"
    return None
