"""A campaign on a target: every planned run is measured, pulled back and closed, whatever happens in between."""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Protocol

from rtfiles.errors import InfrastructureError, UsageError
from rtrun import collect, deploy, journal, launch, master, probe, rundir, suites
from rtrun.campaign import Run
from rtrun.errors import TargetError
from rtrun.link import Link, TargetRebooted
from rtrun.logfile import read_log
from rtrun.samples import read_samples
from rtrun.target import Target

TOPIC = "/communication_tests"
# A suite that needs longer than this for the time it should take hangs.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0
SUBSCRIBED_S = 60.0
# A board that restarts under every attempt will not carry this run.
ATTEMPTS = 3

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """The time now, for records only: nothing is measured with it."""
    return datetime.now(UTC)


class Observer(Protocol):
    """Whoever shows the user how far a campaign is."""

    def began(self, number: int, run: Run) -> None: ...
    def ended(self, number: int, run: Run, status: str, reason: str | None) -> None: ...
    def note(self, text: str) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A target with everything in place for runs."""

    link: Link
    equipment: probe.Equipment
    scripts: PurePosixPath
    programs: dict[str, str]
    kernel_config: bytes
    own_master: bool


def run_campaign(
    target: Target,
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    now: Clock = utc_now,
) -> dict[str, str]:
    """Measure every run that is not finished yet and return run name to status: ``ok``, ``failed``, ``incomplete``.

    Raises UsageError when the folder holds another campaign, TargetError when the target cannot go on. What was
    finished before is kept in either case, and another call goes on behind it.
    """
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InfrastructureError(f"{results}: cannot keep the results: {error.strerror}") from error
    digest = hashlib.sha256(json.dumps([asdict(run) for run in runs], sort_keys=True).encode()).hexdigest()
    log = journal.open_journal(results, name=name, plan=digest, target=target.name)
    with contextlib.closing(log):
        if (log.plan, log.target) != (digest, target.name):
            raise UsageError(
                f"{results}: holds another campaign (its file or target has changed since): "
                "give another folder with --results, or --fresh"
            )
        statuses = {run.name: found for run in runs if (found := rundir.status(results / run.name)) == "ok"}
        todo = [(number, run) for number, run in enumerate(runs) if run.name not in statuses]
        if statuses and todo:
            observer.note(f"going on in {results}: {len(statuses)} of {len(runs)} runs are finished")
        if not todo:
            return statuses
        with contextlib.ExitStack() as stack:
            link = stack.enter_context(Link(target, observer.note))
            preparation = stack.enter_context(contextlib.ExitStack())
            prepared = preparation.enter_context(prepare(link, log.uid, [run for _, run in todo]))
            for number, run in todo:
                observer.began(number, run)
                for attempt in range(1, ATTEMPTS + 1):
                    log.note(now().isoformat(), run.name, "began")
                    try:
                        status, reason = _run(prepared, log.uid, name, run, results / run.name, now)
                    except TargetRebooted as error:
                        log.note(now().isoformat(), run.name, "cut off", str(error))
                        observer.note(f"{run.name}: {error}")
                        if attempt == ATTEMPTS:
                            raise
                        preparation.close()
                        prepared = preparation.enter_context(prepare(link, log.uid, [run for _, run in todo]))
                    except BaseException as error:
                        log.note(now().isoformat(), run.name, "stopped", str(error) or type(error).__name__)
                        raise
                    else:
                        log.note(now().isoformat(), run.name, status, reason)
                        statuses[run.name] = status
                        observer.ended(number, run, status, reason)
                        break
        return statuses


@contextlib.contextmanager
def prepare(link: Link, owner: str, runs: Sequence[Run]) -> Iterator[Prepared]:
    """Put scripts and suites on the target and see to it that a ROS master answers while the context lasts."""
    target = link.target
    equipment = probe.find(link, (deploy.ON_TARGET / "find.sh").read_text(encoding="utf-8"))
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    programs = equipment.programs
    if target.suites is not None:
        tree = deploy.deploy(link, target.suites, "suites")
        programs = {
            program: str(tree / "lib" / suite / program)
            for suite, described in suites.suites().suites.items()
            for program in described.programs
        }
    for run in runs:
        for program in suites.suite(run.suite).programs:
            if program not in programs:
                raise TargetError(
                    f"{target.address}: {program} is not installed on the target: "
                    "name a folder of `rtgen suites build` as suites in the target file"
                )
    priorities = [int(run.parameters["priority"] or 0) for run in runs if run.parameters["policy"] != "0"]
    with master.running(link, scripts, equipment, owner, max(priorities) + 1 if priorities else None) as own_master:
        yield Prepared(
            link=link,
            equipment=equipment,
            scripts=scripts,
            programs=programs,
            kernel_config=probe.kernel_config(link),
            own_master=own_master,
        )


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


def _run(prepared: Prepared, uid: str, campaign: str, run: Run, folder: Path, now: Clock) -> tuple[str, str | None]:
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
    except (KeyboardInterrupt, SystemExit, InfrastructureError) as error:
        if not isinstance(error, TargetRebooted):
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
    """End what runs and leave nothing of it; a target that cannot be reached any more keeps it for the next call."""
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


def judge(
    folder: Path,
    programs: Sequence[launch.Program],
    exits: Sequence[launch.Exit],
    outputs: Sequence[str],
    refused: Mapping[str, str],
) -> tuple[str, str | None]:
    """Say what became of a run from what was pulled back, and why: the first thing that went wrong.

    `refused` are files that were not taken, name to reason.
    """
    for program, exit_ in zip(programs, exits, strict=True):
        if exit_.expired:
            return "failed", f"{program.name} did not end within {program.deadline_s:.0f} s and was ended"
        if exit_.status is None:
            return "failed", f"{program.name} was killed from outside"
        if exit_.status != 0:
            return "failed", f"{program.name} ended with exit status {exit_.status}: {_last_word(folder, program.name)}"
    for output in outputs:
        names = (f"{output}.json", f"{output}.npy")
        if found := [refused[name] for name in names if name in refused]:
            return "failed", found[0]
        missing = [name for name in names if not (folder / name).exists()]
        try:
            # The programs of 2014 write logs and nothing else.
            logs = [path for path in folder.glob("*.log") if path.name.startswith(output)] if len(missing) == 2 else []
            if missing and not logs:
                return "failed", f"{missing[0]} is missing though its program ended with exit status 0"
            for log in logs:
                read_log(log)
            record = None if logs else read_samples(folder / names[0]).record
        except UsageError as error:
            return "failed", str(error).replace(f"{folder}/", "")
        if record is not None and not record.complete:
            return "incomplete", f"{output}: {record.incomplete_reason or 'ended before all was measured'}"
    return "ok", None


def _last_word(folder: Path, program: str) -> str:
    path = folder / f"{program}.stderr"
    said = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    return next((line.strip()[:500] for line in reversed(said.splitlines()) if line.strip()), "it said nothing")


def finished(results: Path, runs: Sequence[Run]) -> int:
    """Return how many runs of a plan are finished in a results folder."""
    return sum(rundir.status(results / run.name) == "ok" for run in runs)
