"""Tables of the facts behind runs: allocations, environment, how to reproduce them."""

import hashlib
import json
import shlex
from collections import Counter

from rtfiles.output import counted
from rtfiles.quantities import time
from rtrun.judgement.study import Study, environment, in_word
from rtrun.plan.quantities import time_text
from rtrun.plan.question import NONE_TOLERATED
from rtrun.report.tables import Table
from rtrun.results.output import NON_MEASURING_THREADS
from rtrun.results.record import RunRecord


def allocations(study: Study) -> Table:
    """How often programs allocated and freed memory, in runs that count it, next to their page faults."""
    rows = []
    for record in study.records:
        for program in record.programs:
            costs, loops = program.costs, program.loops
            if costs is None or costs.allocations is None:
                continue
            counts = (costs.allocations, costs.frees, costs.allocations_of_measuring_thread, costs.page_faults)
            rate = f"{costs.allocations / loops:.3g}" if loops else "-"
            rows.append((record.run, program.name, *("-" if count is None else str(count) for count in counts), rate))
    some = sum(row[2] != "0" for row in rows)
    columns = ("run", "program", "allocations", "frees", "in the measuring thread", "page faults", "allocations a loop")
    notes = (
        "Of all threads of a program while it measured: calls of malloc and its relatives, and of free. These runs "
        "count them, which costs time: their times are in no figure and no answer.",
    )
    outcome = f"{some} of {counted(len(rows), 'program')} allocated memory while measuring"
    return Table(
        id="allocations",
        title="Allocations",
        columns=columns,
        rows=rows,
        outcome=outcome,
        numbers=range(2, 7),
        notes=notes,
    )


def environment_table(study: Study) -> Table:
    """The machine that the runs were measured on, and the settings in effect."""
    rows = [(key.replace("_", " "), value) for key, value in environment(study.records)]
    seen: dict[str, dict[str, None]] = {}
    for digest in study.digests:
        effect = digest.header.in_effect
        if effect:
            policies = {
                f"{thread.policy} {thread.priority}": None
                for thread in effect.threads
                if thread.name not in NON_MEASURING_THREADS
            }
            asked = str(digest.header.parameters.get("policy", "0"))
            seen.setdefault(f"threads in effect, policy {asked} asked for", {}).update(policies)
            settings = {
                "clock": effect.clock,
                "step of the clock": effect.clock_step_ns and time(effect.clock_step_ns),
                "memory is locked (mlockall)": effect.mlockall,
            }
            for key, value in settings.items():
                if value is not None:
                    seen.setdefault(key, {})[in_word(value)] = None
    rows += [(key, "; ".join(sorted(values))) for key, values in seen.items()]
    outcome = (
        f"{len(rows)} facts about {', '.join(sorted({record.target.name for record in study.records})) or 'a file'}"
    )
    return Table(id="environment", title="Environment", columns=("what", "found"), rows=rows, outcome=outcome)


def reproduce(study: Study) -> Table:
    """The command lines that measured and examined the results, and the checksum of what was examined."""
    rows = []
    alike = Counter(_as_asked(record) for record in study.records)
    for record in study.records:
        # The first of repeated runs stands for all: 140 command lines are eight printed pages.
        if others := alike.pop(_as_asked(record), 0):
            lines = " ; ".join(shlex.join(program.argv) for program in record.programs)
            rows.append(("measured", f"{record.run}{f' and {others - 1} like it' if others > 1 else ''}: {lines}"))
    digest = fingerprint(study)
    asked = study.question
    measure = f" --of {asked.of}" if asked.of else ""
    tolerate = f" --tolerate '{asked.tolerance}'" if asked.tolerance != NONE_TOLERATED else ""
    deadline = f" --deadline {time_text(asked.deadline_ns)}" if asked.deadline_ns else ""
    command = f"rtrun report RESULTS{measure}{tolerate}{deadline}"
    rows.append(("examined", f"{command} --probability {asked.probability!r} --confidence {asked.confidence!r}"))
    rows.append(("input", f"sha256 {digest} of all closing records"))
    rows.append(("seed", "20140715 for every resampling"))
    return Table(
        id="reproduce",
        title="How to reproduce",
        columns=("what", "how"),
        rows=rows,
        outcome=f"{counted(len(study.records), 'run')}, input sha256 {digest}",
    )


def _as_asked(record: RunRecord) -> str:
    return json.dumps([record.target.name, record.suite, record.circumstances], sort_keys=True)


def fingerprint(study: Study) -> str:
    """A hash of what was examined: the closing records, which contain the checksum of every file."""
    total = hashlib.sha256()
    paths = [folder / "run.json" for folder in study.source.folders] or [study.source.path]
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
