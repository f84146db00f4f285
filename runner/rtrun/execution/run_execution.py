"""One run on a prepared target: started, waited for, pulled back, judged, closed."""

import contextlib
import json
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePosixPath

from rtfiles.errors import InfrastructureError
from rtrun.execution import clock_record, download, resumption
from rtrun.execution.preparation import Prepared
from rtrun.execution.resumption import Attempt
from rtrun.plan import conditions, suites
from rtrun.plan.campaign import Run
from rtrun.plan.program import Program
from rtrun.results import run_directory
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus, TargetFacts
from rtrun.target import inspection, processes, ros_master
from rtrun.target.errors import DeadlineExpired, StillMeasuring, TargetError
from rtrun.target.link import OUT_OF_REACH, Link
from rtrun.validity import baselines, in_effect
from rtrun.validity.outcome import judge

TOPIC = "/communication_tests"
SUBSCRIBER = "ct_subscriber"
# A suite that needs longer than this for the time it should take hangs.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0
SUBSCRIBED_S = 60.0
# What a load needs to be one: it starts its workers and takes its memory meanwhile.
LOADED_S = 1.0
SAMPLER = "sampler"
# Facts of a target that its state tells under the same names.
STATED = ("kernel_release", "kernel_version", "machine", "boot_id", "clocksource", "governor", "roscpp_version")

Clock = Callable[[], datetime]


def programs_of(prepared: Prepared, run: Run, token: str) -> tuple[list[Program], list[Program], list[str]]:
    """Return the programs that wait for messages, those that start after them, and the outputs they write.

    `token` makes the names of their nodes those of one attempt: a master remembers nodes that were killed.
    """
    suite = suites.suite(run.suite)
    deadline_s = DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S
    environment = _environment(prepared)
    count = int(run.parameters.get("subscribers") or 1)
    waiting: list[Program] = []
    others: list[Program] = []
    outputs: list[str] = []
    for executable in suite.programs:
        repeated = executable == suite.repeated
        for number in range(count if repeated else 1):
            prefix = {"prefix": str(number)} if repeated and count > 1 else {}
            parameters = dict(run.parameters) | prefix
            name = f"{executable}-{number}" if prefix else executable
            argv = suites.argv(run.suite, executable, parameters)
            # Several nodes of one name would throw each other out of the ROS graph.
            node = (f"__name:={SUBSCRIBER}{number}_{token}",) if repeated else ()
            program = Program(
                name=name,
                argv=(prepared.programs[executable], *argv[1:], *node),
                environment=environment,
                deadline_s=deadline_s,
            )
            (waiting if repeated else others).append(program)
            if suite.always is None and (repeated or suite.repeated is None):
                outputs.append(suites.output_name(run.suite, parameters))
    return waiting, others, outputs


def _environment(prepared: Prepared) -> tuple[tuple[str, str], ...]:
    port = prepared.link.target.ros_master_port
    return (("ROS_MASTER_URI", f"http://127.0.0.1:{port}"), ("ROS_IP", "127.0.0.1"))


def _beside(prepared: Prepared, run: Run) -> list[conditions.Background]:
    """What runs beside the suite to make the run's condition so."""
    return conditions.background(
        run.condition,
        run.settings,
        cpus=prepared.equipment.cpus,
        programs=prepared.programs,
        scripts=prepared.scripts,
        environment=_environment(prepared),
        expected_s=run.expected_s,
        deadline_s=DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S,
    )


def _sampler(prepared: Prepared, run: Run, remote: PurePosixPath, beside: Sequence[str]) -> Program:
    script = str(prepared.scripts / "sample.sh")
    priority = str(run.parameters.get("priority") or 1)
    return Program(
        name=SAMPLER,
        argv=(script, str(remote), priority, " ".join(beside)),
        deadline_s=DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S + conditions.OUTLIVE_S,
    )


def measure(prepared: Prepared, uid: str, campaign: str, run: Run, folder: Path, now: Clock) -> RunRecord:
    """Measure one run, or pick it up where it is still going on; return its record.

    The run directory `folder` is closed afterwards. Raises TargetError when the target cannot go on, TargetRebooted
    when this run was cut off by a restart.
    """
    link = prepared.link
    remote = link.target.work_dir / "runs" / uid / run.name
    token = secrets.token_hex(4)
    waiting, others, outputs = programs_of(prepared, run, token)
    beside = _beside(prepared, run)
    loads = [each.program for each in beside]
    sampler = _sampler(prepared, run, remote, [load.name for load in loads])
    names = [program.name for program in (*others, *waiting)]
    helpers = [*(load.name for load in loads), SAMPLER]
    limits = download.expected_files(
        run.suite, [*names, *helpers], outputs, int(run.parameters.get("repetitions") or 0)
    )
    everything = [*names, *helpers]
    begun = _left_to_pick_up(link, remote, folder, [program.name for program in others], everything, limits)
    if begun is None:
        try:
            begun = _begin(prepared, remote, [*others, *waiting], now)
            if loads:
                _load(prepared, remote, run, loads)
            _start(prepared, remote, [sampler, *waiting], others, token)
        except OUT_OF_REACH:
            # Out of reach: what runs there is picked up, or kept as incomplete, by the next call.
            raise
        except (KeyboardInterrupt, InfrastructureError):
            _give_up(link, remote, everything)
            raise
    try:
        exits = [
            processes.wait(link, remote, program.name, deadline_s=program.deadline_s + 60.0)
            for program in (*others, *waiting)
        ]
        # Asked before anything is ended, our own master with the rest, and told to whoever reads the run later.
        master_pid = processes.write_if_absent(link, remote, "master_pid", str(ros_master.ask_pid(link)))
    except OUT_OF_REACH:
        raise
    except (KeyboardInterrupt, DeadlineExpired):
        # The target should have ended it long ago: nothing good can come of it any more.
        _give_up(link, remote, everything)
        raise
    except InfrastructureError as error:
        raise StillMeasuring(f"{error}; the run goes on and is picked up by the next call") from error
    state = ["sh", str(prepared.scripts / "state.sh")]
    ended_early, output = processes.end_background(link, remote, names, helpers, state)
    after = inspection.parse_state(output)
    with run_directory.filling(folder) as partial:
        refused = download.pull(link, remote, partial, limits)
        if prepared.kernel_config:
            (partial / "kernel.config.gz").write_bytes(prepared.kernel_config)
        states = {"schema": 1, "before": begun.before, "after": after, "own_ros_master": begun.own_master}
        (partial / "target.json").write_text(json.dumps(states, indent=2) + "\n", encoding="utf-8")
        if link.target.console is not None and link.target.console.exists():
            (partial / "console.log").write_bytes(link.target.console.read_bytes())
        verdict = judge(
            partial, run, [*others, *waiting], exits, outputs, refused=refused, beside=beside, ended_early=ended_early
        )
        if master_pid != str(begun.master_pid):
            reason = "the ROS master died during the run" + (f"; {verdict.reason}" if verdict.reason else "")
            verdict = replace(verdict, status=RunStatus.FAILED, reason=reason)
        if suites.suite(run.suite).always is not None and verdict.status is RunStatus.OK:
            outputs = baselines.keep_histograms(partial, run, suites.output_name(run.suite, run.parameters))
        record = RunRecord(
            schema=1,
            run=run.name,
            campaign=campaign,
            attempt=begun.uid,
            suite=run.suite,
            parameters=dict(run.parameters),
            condition=run.condition,
            settings=dict(run.settings),
            repeat=run.repeat,
            seed=run.seed,
            emulated=link.target.emulated,
            status=verdict.status,
            reason=verdict.reason,
            requested=in_effect.requested(run, beside),
            in_effect=verdict.in_effect,
            start_time=begun.start_time,
            end_time=now().isoformat(),
            programs=[
                ProgramRecord(name=program.name, argv=begun.argv[program.name], exit_status=exit_.status)
                for program, exit_ in zip([*others, *waiting], exits, strict=True)
            ],
            outputs=outputs,
            refused=refused,
            target=TargetFacts(
                name=link.target.name,
                address=str(link.target.address),
                preempt_rt=inspection.is_preempt_rt(begun.before),
                cpus=prepared.equipment.cpus,
                clock=clock_record.record(begun.before, clock_record.steps_seen(partial, outputs)),
                **{name: begun.before.get(name) for name in STATED},
            ),
            files={},
        )
        run_directory.close(partial, folder, record)
    link.check(["rm", "-rf", str(remote)])
    return record


def _begin(prepared: Prepared, remote: PurePosixPath, programs: Sequence[Program], now: Clock) -> Attempt:
    """Write down what the run begins with. Raises TargetError when nothing can be measured."""
    link = prepared.link
    start_time = now()
    master_pid = ros_master.ask_pid(link)
    if master_pid is None:
        raise TargetError(f"{link.target.address}: the ROS master died")
    return resumption.begin(
        link,
        remote,
        start_time=start_time.isoformat(),
        master_pid=master_pid,
        own_master=prepared.own_master,
        argv={program.name: program.argv for program in programs},
        before=inspection.read_state(link, prepared.scripts / "state.sh"),
    )


def _load(prepared: Prepared, remote: PurePosixPath, run: Run, loads: Sequence[Program]) -> None:
    """Make the condition so. Raises TargetError when a load does not stay."""
    link = prepared.link
    processes.start(link, prepared.scripts, remote, *loads, setup=prepared.equipment.setup)
    time.sleep(LOADED_S)
    for name in processes.list_ended(link, remote, [load.name for load in loads]):
        said = processes.read_last_line(link, remote / f"{name}.stderr") or "it said nothing"
        raise TargetError(f"{link.target.address}: condition {run.condition}: {name} does not run: {said}")


def _start(
    prepared: Prepared,
    remote: PurePosixPath,
    first: Sequence[Program],
    others: Sequence[Program],
    token: str,
) -> None:
    """Start the sampler and the programs that wait for messages, `first`, and, when these do wait, the others."""
    link, setup = prepared.link, prepared.equipment.setup
    waiting = [program.name for program in first[1:]]
    if not waiting:
        processes.start(link, prepared.scripts, remote, *first, *others, setup=setup)
        return
    processes.start(link, prepared.scripts, remote, *first, setup=setup)
    processes.wait_until(
        lambda: (
            ros_master.count_subscribers(link, TOPIC, token) >= len(waiting)
            or bool(processes.list_ended(link, remote, waiting))
        ),
        deadline_s=SUBSCRIBED_S,
        what=f"{link.target.address}: {len(waiting)} subscribers to register with the ROS master",
    )
    processes.start(link, prepared.scripts, remote, *others, setup=setup)


def _attempt(folder: Path) -> str | None:
    closed = run_directory.closing_record(folder)
    return closed.attempt if closed else None


def _give_up(link: Link, remote: PurePosixPath, names: Sequence[str]) -> None:
    with contextlib.suppress(TargetError):
        processes.give_up(link, remote, names)


def _left_to_pick_up(
    link: Link,
    remote: PurePosixPath,
    folder: Path,
    last: Sequence[str],
    names: Sequence[str],
    limits: dict[str, int],
) -> Attempt | None:
    """Return the attempt of an earlier call that goes on, or has ended and waits for us; all else makes room.

    `last` are the programs that are started last: before them nothing is measured. What a reboot cut off is kept as
    incomplete; what was given up, or is closed and only to be repeated, is removed.
    """
    left = resumption.left(link, remote)
    measuring = not left.started.isdisjoint(last) and not left.given_up
    if left.attempt and measuring and left.attempt.uid != _attempt(folder):
        return left.attempt
    if left.cut_off:
        kept = run_directory.unused(folder, "incomplete")
        with run_directory.filling(kept) as partial:
            download.pull(link, remote, partial, limits)
            run_directory.rename(partial, kept)
    processes.give_up(link, remote, names)
    return None
