"""Boards of a labgrid farm: a place is acquired for as long as its context lasts, and given back whatever happens.

What changes something at the coordinator is done by labgrid's own client, in a process of its own. A shell gives the
place back when the runner closes its standard input, or when the runner is gone, however it ended.

labgrid knows who has a place by host and user alone. So each acquisition here has a user name of its own: two runners
of one user, or two targets of one campaign, never take the same place.
"""

import contextlib
import getpass
import os
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.invocation import install_extra
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.labgrid.environment import Environment, entries
from rtrun.targets.labgrid.serial_console import keeping_console

COORDINATOR = "127.0.0.1:20408"
# A client starts, connects and waits for the exporter, whose power switch may pause for some seconds.
CLIENT_S = 120.0
ANSWER_S = 15.0
POLL_S = 0.5
_SAY_AFTER_S = 3.0
# The first word of the line that `labgrid-client reserve --shell` prints.
_TOKEN = "export LG_TOKEN="
# The client reads these, too.
_VARIABLES = ("LG_ENV", "LG_PLACE", "PLACE", "LG_TOKEN", "LG_STATE", "STATE", "LG_INITIAL_STATE", "LG_COORDINATOR")
_ACQUIRED = "acquired"
# Acquires a place, says so and closes its output, waits for the end of its input, and gives the place back.
_ACQUIRE_AND_RELEASE = f"""
user=$1; shift
"$@" acquire 2>&1 && echo {_ACQUIRED}
exec >/dev/null 2>&1
cat
"$@" release-from "$user"
"""
# What the client prints when it acquires a place are some lines.
_PRINTED_MAX = 65536  # characters
# Resources with a power driver whose names do not say so.
_ALSO_POWER = ("PDUDaemonPort", "NetworkSysfsGPIO")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabgridPlace:
    """A place of a coordinator, and who holds it, as ``host/user``."""

    name: str
    tags: Mapping[str, str]
    holder: str | None
    reservation: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquiredPlace:
    """A place that is ours: where its SSH server is, and how its power is switched."""

    name: str
    host: str
    port: int
    user: str
    key: Path | None
    power_cycle: Callable[[], None] | None
    """None: the place has no power switch."""
    has_console: bool


class _Service(BaseModel):
    """Where the SSH server of a place is: labgrid's resource NetworkService."""

    address: Annotated[str, Field(min_length=1, max_length=255)]
    port: Annotated[int, Field(ge=1, le=65535)] = 22
    username: Annotated[str, Field(min_length=1, max_length=255)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Client:
    """labgrid's client as a user of a coordinator."""

    coordinator: str
    user: str

    @property
    def identity(self) -> str:
        """How the coordinator names who has a place."""
        return f"{os.environ.get('LG_HOSTNAME') or socket.gethostname()}/{self.user}"

    @property
    def environment(self) -> dict[str, str]:
        """Of its process; what labgrid's variables say of places is for the target file to say."""
        return {name: value for name, value in os.environ.items() if name not in _VARIABLES} | {
            "LG_USERNAME": self.user
        }

    def command(self, *words: str) -> list[str]:
        """Its command line."""
        return [sys.executable, "-m", "labgrid.remote.client", "-x", self.coordinator, *words]

    @contextlib.contextmanager
    def started(
        self, *words: str, stdout: int = subprocess.PIPE, stderr: int = subprocess.STDOUT
    ) -> Iterator["subprocess.Popen[str]"]:
        """Run it while the context lasts."""
        process = subprocess.Popen(
            self.command(*words),
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            env=self.environment,
            text=True,
            errors="replace",
        )
        with process:
            try:
                yield process
            finally:
                process.kill()

    def call(self, *words: str) -> str:
        """Run it and return what it printed. Raises TargetError with its last line."""
        with self.started(*words) as process:
            try:
                output, _ = process.communicate(timeout=CLIENT_S)
            except subprocess.TimeoutExpired as error:
                raise TargetError(f"labgrid-client {' '.join(words)} did not end within {CLIENT_S:g} s") from error
            _check(process, " ".join(words), output)
            return output


def coordinator_of(given: str | None, environment: Environment) -> str:
    """The coordinator's address: from the target file, labgrid's environment file or variable, or labgrid's default."""
    return given or environment.coordinator or os.environ.get("LG_COORDINATOR") or COORDINATOR


def list_places(coordinator: str) -> list[LabgridPlace]:
    """Ask a coordinator for its places. Raises UsageError when labgrid is not installed, TargetError."""
    try:
        import grpc
        from labgrid.remote.generated import labgrid_coordinator_pb2 as messages
        from labgrid.remote.generated import labgrid_coordinator_pb2_grpc as services
    except ImportError as error:
        raise UsageError(f"targets of labgrid need the package labgrid: {install_extra('farm')} ({error})") from error
    address = coordinator if ":" in coordinator else f"{coordinator}:20408"
    with grpc.insecure_channel(address) as channel:
        try:
            reply = services.CoordinatorStub(channel).GetPlaces(messages.GetPlacesRequest(), timeout=ANSWER_S)
        except grpc.RpcError as error:
            raise TargetError(
                f"the labgrid coordinator at {address} does not answer: {error.details() or error.code()}; "
                "is labgrid-coordinator running there, and is LG_COORDINATOR or `coordinator` in the target file right?"
            ) from error
    return [
        LabgridPlace(
            name=place.name,
            tags=dict(place.tags),
            holder=place.acquired or None,
            reservation=place.reservation or None,
        )
        for place in reply.places
    ]


def matching(places: list[LabgridPlace], tags: Mapping[str, str]) -> list[LabgridPlace]:
    """The places that have all of these tags."""
    return [place for place in places if tags.items() <= place.tags.items()]


@contextlib.contextmanager
def acquired(
    coordinator: str,
    wanted: Mapping[str, str],
    environment: Environment,
    console: Path,
    notify: Callable[[str], None],
    is_over: Callable[[], bool],
) -> Iterator[AcquiredPlace]:
    """Acquire a place with these tags (`name` is that of the place) and yield it, its serial console kept in a file.

    Where all such places are held, one is reserved and waited for until `is_over`. A place that this user has acquired
    on this machine before is taken as it is, and stays acquired.
    """
    places = list_places(coordinator)
    fitting = [place for place in places if wanted.items() <= {**place.tags, "name": place.name}.items()]
    words = ", ".join(f"{key}={value}" for key, value in wanted.items())
    if not fitting:
        there = ", ".join(place.name for place in places) or "none"
        raise UsageError(f"the labgrid coordinator at {coordinator} has no place with {words}; its places: {there}")
    client = _Client(coordinator=coordinator, user=os.environ.get("LG_USERNAME") or getpass.getuser())
    with contextlib.ExitStack() as stack:
        name = next((place.name for place in fitting if place.holder == client.identity), None)
        if name is None:
            client = replace(client, user=f"{client.user}-rtrun-{secrets.token_hex(3)}")
            name = _reserve_and_acquire(client, wanted, fitting, stack, notify, is_over)
        else:
            notify(f"place {name} is acquired by {client.identity} already, and stays so")
        resources = _resources(client.call("-p", name, "env"), name)
        service = _service(resources, name)
        if (serial := resources.get("NetworkSerialPort")) is not None:
            stack.enter_context(keeping_console(serial, console))
        has_power = name in environment.powered or any("Power" in kind or kind in _ALSO_POWER for kind in resources)
        config = ["-c", str(environment.path)] if environment.path and name in environment.keys else []

        def power_cycle() -> None:
            client.call(*config, "-p", name, "power", "cycle")

        yield AcquiredPlace(
            name=name,
            host=service.address,
            port=service.port,
            user=service.username,
            key=environment.keys.get(name),
            power_cycle=power_cycle if has_power else None,
            has_console=serial is not None,
        )


def _reserve_and_acquire(
    client: _Client,
    wanted: Mapping[str, str],
    fitting: list[LabgridPlace],
    stack: contextlib.ExitStack,
    notify: Callable[[str], None],
    is_over: Callable[[], bool],
) -> str:
    printed = client.call("reserve", "--shell", *(f"{key}={value}" for key, value in wanted.items()))
    token = next((line.removeprefix(_TOKEN) for line in printed.splitlines() if line.startswith(_TOKEN)), "")
    try:
        is_held = all(place.holder for place in fitting)
        if is_held:
            notify(_holders(fitting))
        # Of several that ask at one time all see the place free: who waits finds out when it has waited.
        say = None if is_held else notify
        _wait(client, token, {place.name for place in fitting}, say, is_over)
        name = next((place.name for place in list_places(client.coordinator) if place.reservation == token), None)
        if name is None:
            raise TargetError(f"the coordinator at {client.coordinator} gave no place for the reservation {token}")
        stack.enter_context(_acquire(client, name))
        return name
    finally:
        # An acquired place needs no reservation, which would keep it from others for minutes after it is given back.
        with contextlib.suppress(InfrastructureError):
            client.call("cancel-reservation", token)


def _holders(places: Sequence[LabgridPlace]) -> str:
    who = [f"{each.name} is {f'held by {each.holder}' if each.holder else 'reserved'}" for each in places]
    return f"{', '.join(who)}: reserved, and waited for"


def _wait(
    client: _Client,
    token: str,
    fitting: Collection[str],
    say: Callable[[str], None] | None,
    is_over: Callable[[], bool],
) -> None:
    """Wait until a reservation is allocated to one of the fitting places; say who has them if it takes a while."""
    say_at = time.monotonic() + _SAY_AFTER_S
    # It prints the reservation every second, which nobody reads.
    with client.started("wait", token, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as waiting:
        while waiting.poll() is None:
            if is_over():
                raise TargetGone("the campaign was over before the place was free")
            if say is not None and time.monotonic() > say_at:
                say(_holders([place for place in list_places(client.coordinator) if place.name in fitting]))
                say = None
            time.sleep(POLL_S)
        _check(waiting, "wait", waiting.communicate()[1])


@contextlib.contextmanager
def _acquire(client: _Client, place: str) -> Iterator[None]:
    """Have a process acquire a place, and give it back when the context is left, or this process ends."""
    with subprocess.Popen(
        ["sh", "-c", _ACQUIRE_AND_RELEASE, "sh", client.identity, *client.command("-p", place)],
        # The runner has the other end, and nobody else does.
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=client.environment,
        # Ctrl-C on the terminal is not for it.
        start_new_session=True,
        text=True,
        errors="replace",
    ) as process:
        assert process.stdout is not None
        expired = threading.Event()

        def end() -> None:
            expired.set()
            os.killpg(process.pid, signal.SIGKILL)

        timer = threading.Timer(CLIENT_S, end)
        timer.daemon = True
        timer.start()
        try:
            last_line = process.stdout.read(_PRINTED_MAX).strip().rpartition("\n")[2]
        finally:
            timer.cancel()
        if expired.is_set():
            # What gives the place back was ended, too.
            with contextlib.suppress(InfrastructureError):
                client.call("-p", place, "release-from", client.identity)
            raise TargetError(f"place {place} was not acquired within {CLIENT_S:g} s")
        if last_line != _ACQUIRED:
            raise TargetError(f"place {place} cannot be acquired: {last_line[:500]}")
        yield


def _check(process: "subprocess.Popen[str]", words: str, output: str) -> None:
    if process.returncode:
        last_line = output.strip().rpartition("\n")[2] or f"exit status {process.returncode}"
        raise TargetError(f"labgrid-client {words}: {last_line[:500]}")


def _service(resources: Mapping[str, Mapping[str, Any]], place: str) -> _Service:
    """Where the SSH server of a place is. Raises TargetError."""
    if "NetworkService" not in resources:
        raise TargetError(
            f"place {place} has no NetworkService, which says where its SSH server is; its resources: "
            f"{', '.join(resources)[:500] or 'none, is its exporter running?'}"
        )
    try:
        return _Service.model_validate(resources["NetworkService"])
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
        raise TargetError(f"place {place}: NetworkService: {wrong}") from error


def _resources(printed: str, place: str) -> dict[str, dict[str, Any]]:
    """The resources of a place by class, from what `labgrid-client env` printed."""
    import yaml

    try:
        # Above the file it may say what it does.
        data = yaml.safe_load(printed[printed.index("targets:") :])
        return dict(entries(data["targets"][place], "resources"))
    except (ValueError, KeyError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise TargetError(
            f"place {place}: labgrid-client env printed no environment: {printed.strip()[:200]!r}"
        ) from error
