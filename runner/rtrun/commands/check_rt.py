"""``rtrun check-rt``: what prevents real time on a target."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._arguments import add_json, add_target

if TYPE_CHECKING:
    from rtrun.targets.inspection.platform import Platform
    from rtrun.targets.inspection.rt_readiness import CheckResult
    from rtrun.targets.link import Link

HELP = "list what stands in the way of real time on a running target, why, and the remedy"
EXAMPLES = (
    "rtrun check-rt --target board.yml",
    "rtrun check-rt --target board.yml --json",
)
FAILS = "a finding is fatal or high"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser)
    add_json(parser)
    parser.add_argument(
        "--save-config", type=Path, metavar="FILE", help="keep the kernel's configuration, for rtgen kconfig verify"
    )


def run(args: argparse.Namespace) -> int:
    """Print the findings. 0: nothing fatal or high, 1: at least one such finding, 3: the target cannot be reached."""

    from rtfiles.output import print_json
    from rtrun.commands._link import linked
    from rtrun.targets.config import read_target
    from rtrun.targets.inspection import platform_signs, rt_readiness

    config = read_target(args.target)
    checks = rt_readiness.read_checks()

    with linked(config, args.target.parent) as link:
        target = link.target
        facts = rt_readiness.read_facts(link)
        known = platform_signs.find_platform(link)
        if args.save_config:
            _save_config(link, args.save_config)
    findings = rt_readiness.judge(checks, facts)
    ready = rt_readiness.is_ready(findings)
    if args.json:
        kernel = " ".join([*facts.get("kernel", []), *facts.get("kernel_version", [])])
        head = {"schema": 2, "target": target.name, "platform": known.platform, "kernel": kernel, "ready": ready}
        clock = {name: facts.get(name, []) for name in ("clocksource", "clockevent")}
        print_json({**head, **clock, "checks": [_as_json(finding) for finding in findings]})
    else:
        _print(f"{target.name} ({target.address})", known.platform, findings)
    return 0 if ready else 1


def _save_config(link: "Link", path: Path) -> None:
    from rtfiles import atomic
    from rtrun.targets.errors import TargetError
    from rtrun.targets.inspection import facts as inspection

    packed = inspection.read_kernel_config(link)
    if not packed:
        raise TargetError(
            f"{link.target.address}: the kernel keeps no configuration, neither /proc/config.gz nor /boot"
        )
    atomic.write_named(path, packed)


def _as_json(finding: "CheckResult") -> dict[str, Any]:
    check = finding.check
    return {
        "name": check.name,
        "severity": check.severity,
        "status": finding.status,
        "found": list(finding.evidence),
        "why": check.why,
        "remedy": check.advice,
    }


def _print(target: str, platform: "Platform", findings: "list[CheckResult]") -> None:
    from rtfiles.output import print_line
    from rtrun.report.terminal import banner_of
    from rtrun.targets.inspection.rt_readiness import SEVERITIES, SHOWN_LINES

    faults = [finding for finding in findings if finding.status == "fault"]
    unknown = [finding for finding in findings if finding.status == "unknown"]
    counts = [(len([finding for finding in faults if finding.check.severity == name]), name) for name in SEVERITIES]
    summary = ", ".join(f"{count} {name}" for count, name in counts if count)
    words = banner_of(platform)
    banner = f" {words}." if words else ""
    if faults:
        print_line(f"{target}: {len(faults)} of {len(findings)} checks find fault: {summary}.{banner}")
    else:
        print_line(f"{target}: nothing found in the way of real time, {len(findings)} checks.{banner}")
    for finding in faults:
        print_line()
        print_line(f"{finding.check.severity}: {finding.check.name}")
        for line in finding.evidence[:SHOWN_LINES]:
            print_line(f"  found   {line}")
        if len(finding.evidence) > SHOWN_LINES:
            print_line(f"          and {len(finding.evidence) - SHOWN_LINES} more like it")
        print_line(f"  why     {finding.check.why}")
        print_line(f"  remedy  {finding.check.advice}")
    if unknown:
        print_line()
        print_line(
            f"not to be seen: {', '.join(f'{finding.check.name} ({finding.evidence[0]})' for finding in unknown)}"
        )
