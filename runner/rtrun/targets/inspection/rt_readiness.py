"""What hinders real time on a running target: facts from a shell script, compared with rt_readiness.yml."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from rtfiles.config import Config, load_own
from rtrun.targets.inspection import control_groups

if TYPE_CHECKING:
    from rtrun.targets.link import Link

DATA = Path(__file__).with_suffix(".yml")
SCRIPT = Path(__file__).parents[2] / "on_target" / "check_rt.sh"

Severity = Literal["fatal", "high", "medium", "info"]
SEVERITIES: tuple[Severity, ...] = ("fatal", "high", "medium", "info")
Status = Literal["ok", "fault", "unknown"]
# A target with a finding of one of these severities is not ready.
GRAVE: frozenset[Severity] = frozenset({"fatal", "high"})
# The most lines of a fact that are shown, and their length.
SHOWN_LINES = 4
SHOWN_CHARACTERS = 100
# How check_rt.sh begins a line that says what it could not see.
UNSEEN = "unseen: "


class Check(Config):
    """One check; `none` and `some` are regular expressions searched for in each line of the fact.

    `safety_net` is the safety that the remedy takes away.
    """

    name: str
    severity: Severity
    fact: str
    none: str | None = None
    some: str | None = None
    absent: Literal["ok", "unknown"]
    why: str
    remedy: str
    safety_net: str = ""

    @property
    def advice(self) -> str:
        """The remedy, and what safety it costs."""
        return with_safety_net(self.remedy, self.safety_net)

    @model_validator(mode="after")
    def _one_expression(self) -> "Check":
        if (self.none is None) == (self.some is None):
            raise ValueError("give one of none and some")
        re.compile(self.none or self.some or "")
        return self


class Checks(Config):
    """rt_readiness.yml."""

    schema_: Literal[1] = Field(alias="schema")
    checks: list[Check]


def with_safety_net(change: str, safety_net: str) -> str:
    """A remedy as it is printed. Whoever follows it must know which safety it costs."""
    return f"{change}; this takes away a safety net: {safety_net}" if safety_net else change


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of a check: `evidence` are the lines at fault, or the reason why it is unknown."""

    check: Check
    status: Status
    evidence: tuple[str, ...]


def read_checks() -> list[Check]:
    """Read rt_readiness.yml."""
    return load_own(DATA, Checks).checks


def read_facts(link: "Link") -> dict[str, list[str]]:
    """Ask a target for the lines of each fact. Raises as `Link.check` does."""
    facts = parse(link.check(["sh", "-s"], stdin=SCRIPT.read_text(encoding="utf-8")))
    groups = link.check(["sh", "-s"], stdin=control_groups.SCRIPT.read_text(encoding="utf-8"))
    return facts | {"control_groups": control_groups.limits_of(control_groups.parse(groups))}


def parse(text: str) -> dict[str, list[str]]:
    """Read the output of check_rt.sh into lines by fact; a fact that the target does not have has no lines."""
    parts = re.split(r"^== (\w+)$", text, flags=re.MULTILINE)
    return {name: body.strip("\n").splitlines() for name, body in zip(parts[1::2], parts[2::2], strict=True)}


def judge(checks: list[Check], facts: dict[str, list[str]]) -> list[CheckResult]:
    """Compare facts with checks; findings are in the order of severity, faults first."""
    findings = [_judge(check, facts.get(check.fact, [])) for check in checks]
    order = ("fault", "unknown", "ok")
    return sorted(findings, key=lambda finding: (order.index(finding.status), SEVERITIES.index(finding.check.severity)))


def grave_faults(findings: list[CheckResult]) -> list[CheckResult]:
    """The findings that are fatal or high."""
    return [finding for finding in findings if finding.status == "fault" and finding.check.severity in GRAVE]


def is_ready(findings: list[CheckResult]) -> bool:
    """Whether nothing fatal or high was found."""
    return not grave_faults(findings)


def _judge(check: Check, lines: list[str]) -> CheckResult:
    unseen = [line.removeprefix(UNSEEN) for line in lines if line.startswith(UNSEEN)]
    lines = [line for line in lines if line and not line.startswith(UNSEEN)]
    if not lines:
        if check.absent == "unknown":
            unseen = [*unseen, f"the target does not show its {check.fact}"]
        return _result(check, "unknown" if unseen else "ok", unseen)
    if check.some is not None:
        good = any(re.search(check.some, line) for line in lines)
        bad = [] if good else lines
    else:
        bad = [line for line in lines if re.search(str(check.none), line)]
    if bad:
        return _result(check, "fault", bad)
    return _result(check, "unknown" if unseen else "ok", unseen)


def _result(check: Check, status: Status, lines: list[str]) -> CheckResult:
    return CheckResult(check=check, status=status, evidence=tuple(line[:SHOWN_CHARACTERS] for line in lines))
