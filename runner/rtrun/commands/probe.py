"""``rtrun probe``: describe a target without measuring anything."""

import argparse
from typing import TYPE_CHECKING

from rtrun.commands._arguments import add_json, add_target

if TYPE_CHECKING:
    from rtrun.execution.middleware.service import Service
    from rtrun.targets.inspection.facts import Fact, Installed

HELP = "say what a target is and whether it is ready for a campaign"
EXAMPLES = (
    "rtrun probe --target board.yml",
    "rtrun probe --target board.yml --json",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Describe the target. 0: ready, 2: its suites are for another machine, 3: out of reach or lacks something."""
    from dataclasses import asdict

    from rtfiles.output import print_json, print_line, print_status
    from rtrun.commands._link import linked
    from rtrun.execution.middleware.known import SERVICES
    from rtrun.targets import deploy
    from rtrun.targets.config import read_target
    from rtrun.targets.inspection import facts as inspection
    from rtrun.targets.inspection import platform_signs

    config = read_target(args.target)

    print_status(f"connecting to {config.name}")
    with linked(config, args.target.parent) as link:
        target = link.target
        print_status(f"asking {config.name} what it is")
        equipment = inspection.inspect(link)
        if target.suites is not None:
            inspection.check_suites(target.suites, target, equipment)
        known = platform_signs.find_platform(link)
        state = inspection.read_state(link, deploy.deploy(link, deploy.ON_TARGET, "scripts") / "state.sh")
        services = {name: service.identity(link) is not None for name, service in SERVICES.items()}
    print_status("")
    if args.json:
        facts = {
            "schema": 1,
            "target": f"{target.name} ({target.address})",
            "platform": asdict(known),
            "equipment": asdict(equipment),
            "services": services,
            "state": state.model_dump(),
        }
        print_json(facts)
        return 0
    suites = target.suites or ", ".join(sorted(equipment.programs)) or "none installed"
    lines = {
        "target": f"{target.name} ({target.address})",
        "platform": f"{known.platform}: {known.evidence}",
        "kernel": f"{_shown(state.kernel_release)} {_shown(state.kernel_version)}",
        "PREEMPT_RT": "yes" if inspection.is_preempt_rt(state) else "no",
        **({"kernels to boot": ", ".join(target.boot_kernel)} if target.boot_kernel else {}),
        "CPUs": f"{equipment.cpus} x {_shown(state.machine)}",
        "clocksource": _shown(state.clocksource),
        "governor": _shown(state.governor, absent="none"),
        "real-time threads": f"{len(state.rt_threads)} of {state.threads}",
        "free on disk": f"{equipment.free_bytes // 2**20} MiB in {target.work_dir}",
        **{name: _middleware(equipment.installed(name), SERVICES[name], runs) for name, runs in services.items()},
        **{
            name: " or ".join(installed.several) or installed.version
            for name, installed in equipment.middlewares.items()
            if name not in SERVICES and (installed.several or installed.version)
        },
        "suites": suites,
        **({"built with": ", ".join(map(" ".join, equipment.built_with.items()))} if equipment.built_with else {}),
    }
    width = max(map(len, lines))
    for name, value in lines.items():
        print_line(f"{name:{width}}  {value}")
    return 0


def _middleware(installed: "Installed", service: "Service", runs: bool) -> str:
    """What the target has for a middleware, in one line."""
    if installed.several:
        return " or ".join(installed.several)
    if installed.server is None:
        return "not found"
    answers = "answers" if runs else "does not answer, a campaign starts one"
    return f"{installed.version or 'of an unknown version'}; {service.name} {answers}"


def _shown(fact: "Fact", absent: str = "unknown") -> str:
    """A fact in one line; values that several CPUs share are printed once."""
    values = [fact] if isinstance(fact, str) else fact or [absent]
    return ", ".join(dict.fromkeys(values))
