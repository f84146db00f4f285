"""What `rtrun show` prints, and `rtrun run` at its end: banner, table of results, and what has to be said of them."""

from collections.abc import Iterable

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from rtfiles.output import printable
from rtrun.analysis.figures import Figures
from rtrun.plan.suites import Value, output_name, suite, suites
from rtrun.results.reading import MAIN_SERIES, RECORD, Result, Run, Runs

EMULATED = "EMULATED: not a real-time statement"
NO_PREEMPT_RT = "NO PREEMPT_RT: this kernel promises no deadline"
COARSE_US = 10_000  # from here on a tenth of a microsecond is not worth its column

_UNITS = {"timeout_us": "us", "frequency_hz": "Hz", "payload_bytes": "B", "subscribers": "sub"}
# The number of measurements has its own column; these do not change what is measured.
_NOT_TOLD = ("repetitions", "prefix", "out_dir", "start_delay_s", "idle_timeout_s")


def table(results: Iterable[Result]) -> Table:
    """The table of these results, a row each, times in microseconds; 80 columns are enough for it."""
    found = Table(box=box.SIMPLE, padding=0, show_edge=False)
    found.add_column("suite", min_width=len("communication"))
    found.add_column("parameters", min_width=len("parameters"))
    for heading in ("n", "min\nus", "avg\nus", "max\nus", "p99\nus", "p99.9\nus", "missing", "out of\norder"):
        found.add_column(heading, justify="right", no_wrap=True)
    for result in results:
        figures = result.figures
        found.add_row(
            Text(printable(_name(result))),
            Text(printable(_parameters(result))),
            str(figures.n),
            *(
                _time(value, figures)
                for value in (figures.min_us, figures.mean_us, figures.max_us, figures.p99_us, figures.p999_us)
            ),
            str(figures.missing),
            str(figures.out_of_order),
        )
    return found


def _name(result: Result) -> str:
    """The suite; the series only where it is not the one the suite is about."""
    name = result.suite.removesuffix("_tests")
    return name if result.series in MAIN_SERIES else f"{name} {result.series}"


def _time(value_us: float | None, figures: Figures) -> str:
    if value_us is None:
        return "-"
    digits = 0 if figures.resolution_ns >= 1000 or abs(value_us) >= COARSE_US else 1
    return f"{round(value_us, digits) + 0.0:.{digits}f}"  # + 0.0: no minus in front of a zero


def _parameters(result: Result) -> str:
    """The parameters in a few words: the policy, what the output is named after, and whatever is not the default."""
    words: list[str] = []
    for key, value in result.parameters.items():
        if key == "policy":
            words.insert(0, "OTHER" if value == "0" else str(value))  # as the kernel calls it
        elif key not in _NOT_TOLD and value is not None and _is_telling(result.suite, key, value):
            words.append(f"{value}{_UNITS[key]}" if key in _UNITS else f"{key}={value}")
    if result.parameters.get("subscribers", 1) != 1:
        words.append(f"#{result.output.removesuffix(output_name(result.suite, {**result.parameters, 'prefix': ''}))}")
    return " ".join(words)


def _is_telling(suite_name: str, key: str, value: Value) -> bool:
    option = suites().options.get(key)
    return option is None or value != option.default or f"{{{key}}}" in suite(suite_name).output


def banner_of(*, emulated: bool, preempt_rt: bool) -> str:
    """What has to be said before any number, in one line; empty when there is nothing to say."""
    return "; ".join([EMULATED] * emulated + [NO_PREEMPT_RT] * (not preempt_rt))


def answer(results: Iterable[Result], *, emulated: bool, preempt_rt: bool = True, notes: Iterable[str] = ()) -> Group:
    """The banner if there is one to give, the table, and a line for every note and for every remark on a result."""
    results = list(results)
    lines = list(notes)
    for result in results:
        found = result.figures
        told = [f"{found.not_fired} timers did not fire, they are in no figure"] if found.not_fired else []
        told += [f"{found.duplicate} messages came again, only the first arrival counts"] if found.duplicate else []
        lines += [f"{result.output}: {remark}" for remark in (*told, *result.remarks)]
    if any(0 < result.figures.n < 1000 for result in results):
        lines.append("p99.9 of fewer than 1000 values is their maximum.")
    words = banner_of(emulated=emulated, preempt_rt=preempt_rt)
    banner = [Text(words, style="bold red")] if words else []
    body = [table(results)] if results else []
    return Group(
        *banner, *body, *(Text(printable(line), no_wrap=True, overflow="ignore") for line in dict.fromkeys(lines))
    )


def answer_of_run(run: Run) -> Group:
    """The answer of one run: every series of every output."""
    return answer(run.results, emulated=run.record.emulated, preempt_rt=run.record.preempt_rt, notes=_notes(run))


def answer_of_runs(found: Runs) -> Group:
    """The answer of all runs in a folder: a row for every output, and what was not analysed and why."""
    results = [result for run in found.runs for result in run.results if result.series in MAIN_SERIES]
    notes = [note for run in found.runs for note in _notes(run)]
    notes += [f"{name}: incomplete: it has no {RECORD}, nothing in it is analysed" for name in found.incomplete]
    return answer(
        results,
        emulated=any(run.record.emulated for run in found.runs),
        preempt_rt=all(run.record.preempt_rt for run in found.runs),
        notes=notes,
    )


def _notes(run: Run) -> list[str]:
    record = run.record
    return [] if record.status == "ok" else [f"{record.run}: {record.status}: {record.reason or 'no reason given'}"]
