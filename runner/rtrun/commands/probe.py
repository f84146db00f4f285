"""``rtrun probe``: what a target is, without measuring anything."""

import argparse
from pathlib import Path

NAME = "probe"
HELP = "say what a target is and whether it is ready for a campaign"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `probe` takes."""
    parser.add_argument("--target", type=Path, required=True, metavar="TARGET.yml")
    parser.add_argument("--json", action="store_true", help="everything that was found, as JSON")


def run(args: argparse.Namespace) -> int:
    """Print what was found. 0: ready, 3: the target cannot be reached or lacks something."""
    import json
    import tempfile
    from dataclasses import asdict

    from rtfiles.output import print_line, print_note, print_text
    from rtrun.target import deploy, inspection, ros_master
    from rtrun.target.config import connect, read_target
    from rtrun.target.link import Link

    config = read_target(args.target)

    def note(text: str) -> None:
        print_note(f"rtrun: {text}")

    with (
        tempfile.TemporaryDirectory(prefix="rtrun-probe-") as work,
        connect(config, args.target.parent, Path(work) / "console.log") as target,
        Link(target, note) as link,
    ):
        equipment = inspection.inspect(link)
        state = inspection.read_state(link, deploy.deploy(link, deploy.ON_TARGET, "scripts") / "state.sh")
        answers = ros_master.ask_pid(link) is not None
    if args.json:
        print_text(
            json.dumps({"equipment": asdict(equipment), "ros_master_answers": answers, "state": state}, indent=2)
        )
        return 0
    suites = target.suites or ", ".join(sorted(equipment.programs)) or "none installed"
    banner = ", EMULATED: not a real-time statement" if target.emulated else ""
    lines = {
        "target": f"{target.name} ({target.address}){banner}",
        "kernel": f"{state['kernel_release']} {state['kernel_version']}",
        "PREEMPT_RT": "yes" if inspection.is_preempt_rt(state) else "no",
        "CPUs": f"{equipment.cpus} x {state['machine']}",
        "clocksource": state["clocksource"] or "unknown",
        "governor": state["governor"] or "none",
        "real-time threads": f"{len(state['rt_threads'])} of {state['threads']}",
        "free on disk": f"{equipment.free_bytes // 2**20} MiB in {target.work_dir}",
        "ROS": f"roscpp {state['roscpp_version']}" if equipment.master else "not found",
        "ROS master": "answers" if answers else "does not answer, a campaign starts one",
        "suites": suites,
    }
    width = max(map(len, lines))
    for name, value in lines.items():
        print_line(f"{name:{width}}  {value}")
    return 0
