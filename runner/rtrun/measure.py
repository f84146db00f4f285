"""One run on a prepared target: started, waited for, pulled back, judged, closed."""

import contextlib
import json
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path, PurePosixPath

from rtfiles.errors import InfrastructureError
from rtrun import clock, collect, launch, master, probe, rundir, suites
from rtrun.campaign import Run
from rtrun.errors import ConnectionLost, TargetError, TargetGone
from rtrun.judge import judge
from rtrun.link import Link, TargetRebooted
from rtrun.prepare import Prepared

TOPIC = "/communication_tests"
# A suite that needs longer than this for the time it should take hangs.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0
SUBSCRIBED_S = 60.0

Clock = Callable[[], datetime]


def programs_of(prepared: Prepared, run: Run) -> tuple[list[launch.Program], list[launch.Program], list[str]]:
    """Return the programs that wait for messages, those that start after them, and the outputs they write."""
    suite = suites.suite(run.suite)
    deadline_s = DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S
    port = prepared.link.target.ros_master_port
    environment = (("ROS_MASTER_URI", f"http://127.0.0.1:{port}"), ("ROS_IP", "127.0.0.1"))
    count = int(run.parameters.get("subscribers") or 1)
    waiting: list[launch.Program] = []
    others: list[launch.Program] = []
    outputs: list[str] = []
    for executable in suite.programs:
        repeated = executable == suite.repeated
        for number in range(count if repeated else 1):
            prefix = {"prefix": str(number)} if repeated and count > 1 else {}
            parameters = dict(run.parameters) | prefix
            name = f"{executable}-{number}" if prefix else executable
            argv = suites.argv(run.suite, executable, parameters)
            # Several nodes of one name would throw each other out of the ROS graph.
            node = (f"__name:=ct_subscriber{number}",) if repeated else ()
            program = launch.Program(
                name=name,
                argv=(prepared.programs[executable], *argv[1:], *node),
                environment=environment,
                deadline_s=deadline_s,
            )
            (waiting if repeated else others).append(program)
            if repeated or suite.repeated is None:
                outputs.append(suites.output_name(run.suite, parameters))
    return waiting, others, outputs


def measure(prepared: Prepared, uid: str, campaign: str, run: Run, folder: Path, now: Clock) -> tuple[str, str | None]:
    """Measure one run, or pick it up where it is still going on; return its status and the reason for it.

    The run directory `folder` is closed afterwards. Raises TargetError when the target cannot go on, TargetRebooted
    when this run was cut off by a restart.
    """
    link = prepared.link
    remote = link.target.work_dir / "runs" / uid / run.name
    waiting, others, outputs = programs_of(prepared, run)
    programs = [*waiting, *others]
    limits = collect.expected_files(
        run.suite, [program.name for program in programs], outputs, int(run.parameters["repetitions"] or 0)
    )
    _clear_of_other_boots(link, remote, folder, limits)
    if not master.answers(link):
        raise TargetError(f"{link.target.address}: the ROS master died")
    start_time = now()
    before = probe.state(link, prepared.scripts / "state.sh")
    try:
        _start(prepared, remote, waiting, others)
        exits = [
            launch.wait(link, remote, program.name, deadline_s=program.deadline_s + 60.0)
            for program in (*others, *waiting)
        ]
    except (TargetRebooted, TargetGone, ConnectionLost):
        # Out of reach: what still runs there is picked up, or kept as incomplete, by the next call.
        raise
    except (KeyboardInterrupt, InfrastructureError):
        _give_up(link, remote, programs)
        raise
    after = probe.state(link, prepared.scripts / "state.sh")
    with rundir.filling(folder) as partial:
        refused = collect.pull(link, remote, partial, limits)
        if prepared.kernel_config:
            (partial / "kernel.config.gz").write_bytes(prepared.kernel_config)
        states = {"schema": 1, "before": before, "after": after, "own_ros_master": prepared.own_master}
        (partial / "target.json").write_text(json.dumps(states, indent=2) + "\n", encoding="utf-8")
        if link.target.console is not None and link.target.console.exists():
            (partial / "console.log").write_bytes(link.target.console.read_bytes())
        status, reason = judge(partial, [*others, *waiting], exits, outputs, refused)
        if not master.answers(link):
            status, reason = "failed", "the ROS master died during the run" + (f"; {reason}" if reason else "")
        record = {
            "run": run.name,
            "campaign": campaign,
            "suite": run.suite,
            "parameters": dict(run.parameters),
            "emulated": link.target.emulated,
            "status": status,
            "reason": reason,
            "start_time": start_time.isoformat(),
            "end_time": now().isoformat(),
            "programs": [
                {"name": program.name, "argv": list(program.argv), "exit_status": exit_.status}
                for program, exit_ in zip([*others, *waiting], exits, strict=True)
            ],
            "outputs": outputs,
            "target": {
                "name": link.target.name,
                "address": str(link.target.address),
                "preempt_rt": probe.is_preempt_rt(before),
                "cpus": prepared.equipment.cpus,
                **{key: before.get(key) for key in ("kernel_release", "kernel_version", "machine", "boot_id")},
                **{key: before.get(key) for key in ("clocksource", "governor", "roscpp_version")},
                "clock": clock.record(before, clock.steps_seen(partial, outputs)),
            },
        }
        rundir.close(partial, folder, record)
    link.do(lambda connection: connection.check(["rm", "-rf", str(remote)]))
    return status, reason


def _start(
    prepared: Prepared, remote: PurePosixPath, waiting: Sequence[launch.Program], others: Sequence[launch.Program]
) -> None:
    link = prepared.link
    link.do(lambda connection: connection.check(["mkdir", "-p", str(remote)]))
    for program in waiting:
        launch.start(link, prepared.scripts, remote, program, prepared.equipment.setup)
    if waiting:
        launch.until(
            lambda: master.subscribers(link, TOPIC) >= len(waiting) or launch.ended(link, remote, waiting[0].name),
            deadline_s=SUBSCRIBED_S,
            what=f"{link.target.address}: {len(waiting)} subscribers to register with the ROS master",
        )
    for program in others:
        launch.start(link, prepared.scripts, remote, program, prepared.equipment.setup)


def _give_up(link: Link, remote: PurePosixPath, programs: Sequence[launch.Program]) -> None:
    """End what runs and leave nothing of it."""
    with contextlib.suppress(TargetError):
        for program in programs:
            launch.end(link, remote, program.name)
        link.do(lambda connection: connection.run(["rm", "-rf", str(remote)]))


def _clear_of_other_boots(link: Link, remote: PurePosixPath, folder: Path, limits: dict[str, int]) -> None:
    """Keep what a run left that a reboot cut off, as incomplete, and make room for its repetition."""
    script = 'cat "$1"/*.boot_id 2>/dev/null; exit 0'
    boots = set(link.do(lambda connection: connection.check(["sh", "-c", script, "sh", str(remote)])).split())
    if boots <= {link.boot_id}:
        return
    kept = rundir.unused(folder, "incomplete")
    with rundir.filling(kept) as partial:
        collect.pull(link, remote, partial, limits)
        rundir.rename(partial, kept)
    link.do(lambda connection: connection.check(["rm", "-rf", str(remote)]))
