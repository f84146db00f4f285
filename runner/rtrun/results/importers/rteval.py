"""Reader of rteval's ``summary.xml``: the histogram of each CPU that cyclictest measured (rteval 2.0 to 3.11).

Written from the code of rteval, which builds the file from the output of ``cyclictest -h``. The median is not checked:
versions before 3.8 print a wrong one. Values beyond the last bucket are left out, and so is their number; in that case
rteval writes no histograms since 3.3, and does not mention it before. Its histograms of timerlat add up interrupt,
thread and user.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.untrusted import XmlElement, parse_xml, real_number, whole_number
from rtrun.kinds.limits import COUNT_MAX, CPUS_MAX
from rtrun.results.importers.command_line import Command, read_command
from rtrun.results.importers.counts import NO_ORDER, StatedSummary, Statistics, check_bins, check_statistics, histogram
from rtrun.results.importers.histogram_file import Imported

_BEGINNING = 65_536
_ROOT = re.compile(r"^[ \t]*<rteval[ >]", re.MULTILINE)
_TOOL = ("rteval", "Measurements", "cyclictest")
_OLD_TOOL = ("rteval", "Measurements", "Profile", "cyclictest")  # 2.0 to 3.8
_VERSION = re.compile(r"([0-9]{1,4})\.([0-9]{1,4})", re.ASCII)
_KNOWS_OVERFLOW = (3, 3)
_STATED = (
    "minimum", "maximum", "mean", "mode", "range", "mean_absolute_deviation", "standard_deviation", "nbuckets",
)  # fmt: skip
_DECIMALS = 9  # of at least twelve digits
_ALIKE = 1e-9  # for numbers computed from the same counts in another order
_MORE_BUCKETS = "measure with more: rteval --cyclictest-buckets"
_NO_CYCLICTEST = (
    "no values of cyclictest. rteval's values of timerlat are not read: it adds up interrupt, thread and user, and"
    " leaves out those beyond the last bucket. Measure with: rtla timerlat hist > FILE"
)


@dataclass(kw_only=True, slots=True)
class _ReportPart:
    """What the report states about one CPU, or about the system (their sum), and the line of each number."""

    bins: dict[int, int] = field(default_factory=dict)
    stated: dict[str, tuple[int, str]] = field(default_factory=dict)

    def number(self, path: Path, name: str) -> float:
        """A number from the report. Raises UsageError naming the line."""
        line, text = self.stated[name]
        try:
            return real_number(text, lowest=0, highest=COUNT_MAX)
        except ValueError as error:
            raise UsageError(f"{path}:{line}: {name}: {error}") from error

    def whole(self, path: Path, name: str) -> int:
        """A whole number from the report. Raises UsageError naming the line."""
        line, text = self.stated[name]
        return _whole(f"{path}:{line}: {name}", text)

    def place(self, path: Path, name: str) -> str:
        """Where a number stands."""
        return f"{path}:{self.stated[name][0]}: {name}"


@dataclass(kw_only=True, slots=True)
class _Report:
    path: Path
    version: str = ""
    command: str | None = None
    threshold_us: int | None = None
    current: _ReportPart = field(default_factory=_ReportPart)
    parts: dict[str, _ReportPart] = field(default_factory=dict)  # by CPU number, and "system"
    bins: int = 0

    def take(self, element: XmlElement) -> None:
        """Keep what an element states; the elements within it were taken before it."""
        if element.path == ("rteval",):
            self.version = element.attributes.get("version", "")
        tool = next((path for path in (_TOOL, _OLD_TOOL) if element.path[: len(path)] == path), None)
        if tool is None:
            return
        place = f"{self.path}:{element.line}"
        match element.path[len(tool) :]:
            case ("core" | "system", "statistics", name):
                _keep_once(place, self.current.stated, name, (element.line, element.text))
                if name != "samples" and element.attributes.get("unit") != "us":
                    raise UsageError(f"{place}: {name}: expected the unit us, got {element.attributes.get('unit')!r}")
            case ("core" | "system", "histogram", "bucket"):
                index, count = (_whole(f"{place}: {name}", element.attributes.get(name)) for name in ("index", "value"))
                self.bins += 1
                check_bins(self.path, self.bins)
                if count:  # the first versions of rteval 2 also print empty ones
                    _keep_once(place, self.current.bins, index, count)
            case ("core" | "system", "histogram"):
                _keep_once(
                    place, self.current.stated, "nbuckets", (element.line, element.attributes.get("nbuckets", ""))
                )
            case ("core" | "system" as kind,):
                name = kind if kind == "system" else str(_whole(f"{place}: id", element.attributes.get("id")))
                self.current.stated[kind] = (element.line, name)
                _keep_once(place, self.parts, name, self.current)
                self.current = _ReportPart()
            case ("abort_report", "breaktrace"):
                self.threshold_us = _whole(f"{place}: latency_threshold", element.attributes.get("latency_threshold"))
            case ():
                if self.command is not None:
                    raise UsageError(f"{place}: a second measurement of cyclictest")
                self.command = element.attributes.get("command_line", "")


def _whole(place: str, text: str | None) -> int:
    try:
        return whole_number(text or "", lowest=0, highest=COUNT_MAX)
    except ValueError as error:
        raise UsageError(f"{place}: {error}") from error


def _keep_once(place: str, kept: dict[Any, Any], key: str | int, value: object) -> None:
    if key in kept:
        raise UsageError(f"{place}: {key} stands twice")
    kept[key] = value


def is_report(text: str) -> bool:
    """Whether a text begins like a report of rteval."""
    return _ROOT.search(text[:_BEGINNING]) is not None


def read_report(path: Path, text: str) -> tuple[Imported, ...]:
    """Read one histogram per CPU. Raises UsageError ``file:line: what is wrong``."""
    report = _Report(path=path)
    parse_xml(text, str(path), report.take)
    if report.command is None:
        raise UsageError(f"{path}: {_NO_CYCLICTEST}")
    system = report.parts.pop("system", None)
    if system is None or not report.parts:
        raise UsageError(
            f"{path}: no histograms of cyclictest: rteval leaves them out where a value was beyond the last bucket;"
            f" {_MORE_BUCKETS}"
        )
    command = read_command(path, "its command line of cyclictest", report.command)
    version = _VERSION.match(report.version)
    undecidable = ""
    if version is None or (int(version[1]), int(version[2])) < _KNOWS_OVERFLOW:
        undecidable = (
            f"rteval before {'.'.join(map(str, _KNOWS_OVERFLOW))} leaves out values beyond the last bucket and does not"
            f" say so; this is {version[0] if version else 'of an unknown version'}"
        )
    left_out = [NO_ORDER]
    if report.threshold_us is not None:
        left_out.append(f"what followed the value above {report.threshold_us} us at which rteval ended it")
    imported = tuple(
        _cpu(path, name, part, command, len(report.parts), left_out, undecidable)
        for name, part in sorted(report.parts.items(), key=lambda item: int(item[0]))
    )
    check_statistics(system.bins, _checked(path, system, command), overflow=0, limit=0)
    _check_sum(path, system, report.parts)
    return imported


def _cpu(
    path: Path, name: str, part: _ReportPart, command: Command, threads: int, left_out: list[str], undecidable: str
) -> Imported:
    if int(name) >= CPUS_MAX:
        raise UsageError(f"{part.place(path, 'core')}: id {name}, expected less than {CPUS_MAX}")
    return Imported(
        source="rteval",
        name=f"rteval-cpu{name}",
        histogram=histogram(part.bins, _checked(path, part, command), unit_ns=1000, overflow=0, limit=0),
        period_ns=1000.0 * command.interval_us,
        left_out=tuple(left_out),
        parameters=command.parameters(threads),
        undecidable=undecidable,
    )


def _checked(path: Path, part: _ReportPart, command: Command) -> Statistics:
    """What a part states about all its values, checked against its buckets. Raises UsageError."""
    kind = "core" if "core" in part.stated else "system"
    n = sum(part.bins.values())
    for name in ("samples", *(_STATED if n else ())):
        if name not in part.stated:
            raise UsageError(f"{part.place(path, kind)} {part.stated[kind][1]}: {name} is missing")
    if (samples := part.whole(path, "samples")) != n:
        raise UsageError(f"{part.place(path, 'samples')}: {samples}, but the buckets hold {n}")
    nothing = StatedSummary(place=part.place(path, "samples"), value=None)
    if n == 0:
        return Statistics(least=nothing, mean=nothing, most=nothing)
    if (buckets := part.whole(path, "nbuckets")) < len(part.bins):
        raise UsageError(f"{part.place(path, 'nbuckets')}: {buckets}, but there are {len(part.bins)}")
    least, most = (part.whole(path, name) for name in ("minimum", "maximum"))
    beyond = max(most, *part.bins)
    if command.limit is not None and beyond >= command.limit:
        raise UsageError(
            f"{part.place(path, 'maximum')}: a value of {beyond} us, but the histogram ends below {command.limit}: how"
            f" many values are beyond is not stated; {_MORE_BUCKETS}"
        )
    if n > 1:  # rteval computes nothing from one value
        for name, expected in _computed(part.bins).items():
            if abs((stated := part.number(path, name)) - expected) > _ALIKE * max(1.0, expected):
                raise UsageError(f"{part.place(path, name)}: {stated:g}, but the buckets give {expected:g}")
    return Statistics(
        least=StatedSummary(place=part.place(path, "minimum"), value=least),
        mean=StatedSummary(place=part.place(path, "mean"), value=part.number(path, "mean") if n > 1 else None),
        most=StatedSummary(place=part.place(path, "maximum"), value=most),
        decimals=_DECIMALS,
    )


def _computed(bins: Mapping[int, int]) -> dict[str, float]:
    """What rteval computes from buckets, except the mean and the median, by rteval's names."""
    values, counts = (np.array(column, dtype=np.float64) for column in (list(bins), list(bins.values())))
    n = float(counts.sum())
    mean = float((values * counts).sum()) / n
    most_often = max(bins.values())
    return {
        "mode": min(value for value, count in bins.items() if count == most_often),
        "range": max(bins) - min(bins),
        "mean_absolute_deviation": float((np.abs(values - mean) * counts).sum()) / n,
        "standard_deviation": float(np.sqrt(((values - mean) ** 2 * counts).sum() / max(1.0, n - 1))),
    }


def _check_sum(path: Path, system: _ReportPart, cpus: Mapping[str, _ReportPart]) -> None:
    """Refuse a system that is not the sum of its CPUs."""
    sums: dict[int, int] = {}
    for part in cpus.values():
        for value, count in part.bins.items():
            sums[value] = sums.get(value, 0) + count
    if sums != system.bins:
        value = min(value for value in sums.keys() | system.bins.keys() if sums.get(value) != system.bins.get(value))
        raise UsageError(
            f"{system.place(path, 'system')}: {system.bins.get(value, 0)} values of {value} us, but the CPUs have"
            f" {sums.get(value, 0)}"
        )
