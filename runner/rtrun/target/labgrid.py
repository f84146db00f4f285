"""Boards of a labgrid farm: a place is acquired for as long as its context lasts, and given back whatever happens.

What changes something at the coordinator is done by labgrid's own client, in a process of its own. A shell gives the
place back when the runner closes its standard input, or when the runner is gone, however it ended.
"""

import contextlib
import functools
import getpass
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtfiles.config import read_yaml
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.target.errors import TargetError, TargetGone

COORDINATOR = "127.0.0.1:20408"
_CLIENT = (sys.executable, "-m", "labgrid.remote.client")
# A client starts, connects and waits for the exporter, whose power switch may pause for some seconds.
CLIENT_S = 120.0
ANSWER_S = 15.0
POLL_S = 0.5
CONSOLE_RETRY_S = 1.0
# The first word of the line that `labgrid-client reserve --shell` prints.
_TOKEN = "export LG_TOKEN="
# The client reads these, too; here the target file decides.
_VARIABLES = ("LG_ENV", "LG_PLACE", "PLACE", "LG_TOKEN", "LG_STATE", "STATE", "LG_INITIAL_STATE", "LG_COORDINATOR")
_ACQUIRED = "acquired"
_HOLD = f"""
own=$1; shift
"$@" acquire 2>&1 && echo {_ACQUIRED}
exec >/dev/null 2>&1
cat
"$@" release-from "$own"
"""
_POWER_WITHOUT_ITS_NAME = ("PDUDaemonPort", "NetworkSysfsGPIO")


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of a coordinator, and who holds it, as ``host/user``."""

    name: str
    tags: Mapping[str, str]
    holder: str | None
    reservation: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Environment:
    """What labgrid's own environment file says of the places it names."""

    path: Path | None = None
    coordinator: str | None = None
    keys: Mapping[str, Path | None] = field(default_factory=dict)
    """By place: the private key file of its SSHDriver."""
    powered: frozenset[str] = frozenset()
    """Places with a power driver."""


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


def coordinator_of(given: str | None, environment: Environment) -> str:
    """The coordinator's address: from the target file, labgrid's environment file or variable, or labgrid's default."""
    return given or environment.coordinator or os.environ.get("LG_COORDINATOR") or COORDINATOR


def read_environment(path: Path) -> Environment:
    """Read labgrid's environment file. Raises UsageError when it names no RemotePlace."""
    data = read_yaml(path)
    targets = data.get("targets") if isinstance(data, dict) else None
    keys: dict[str, Path | None] = {}
    powered = set()
    for target in targets.values() if isinstance(targets, dict) else ():
        drivers = dict(_entries(target, "drivers"))
        key = drivers.get("SSHDriver", {}).get("keyfile")
        for kind, values in _entries(target, "resources"):
            if kind == "RemotePlace" and isinstance(name := values.get("name"), str):
                keys[name] = path.parent / Path(key).expanduser() if isinstance(key, str) and key else None
                if any("Power" in driver for driver in drivers):
                    powered.add(name)
    if not keys:
        raise UsageError(f"{path}: names no RemotePlace under targets: it is to be an environment file of labgrid")
    options = data.get("options") if isinstance(data, dict) else None
    coordinator = options.get("coordinator_address") if isinstance(options, dict) else None
    return Environment(
        path=path,
        coordinator=coordinator if isinstance(coordinator, str) else None,
        keys=keys,
        powered=frozenset(powered),
    )


def _entries(target: Any, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the resources or drivers of a target, which labgrid takes as a mapping or as a list of mappings."""
    entries = target.get(section) if isinstance(target, dict) else None
    for mapping in entries if isinstance(entries, list) else [entries]:
        for kind, values in mapping.items() if isinstance(mapping, dict) else ():
            yield str(kind), values if isinstance(values, dict) else {}


def list_places(coordinator: str) -> list[Place]:
    """Ask a coordinator for its places. Raises UsageError when labgrid is not installed, TargetError."""
    try:
        import grpc
        from labgrid.remote.generated import labgrid_coordinator_pb2 as messages
        from labgrid.remote.generated import labgrid_coordinator_pb2_grpc as services
    except ImportError as error:
        raise UsageError(
            f"targets of labgrid need the package labgrid: pip install 'meta-rt-tests[farm]' ({error})"
        ) from error
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
        Place(
            name=place.name,
            tags=dict(place.tags),
            holder=place.acquired or None,
            reservation=place.reservation or None,
        )
        for place in reply.places
    ]


def matching(places: list[Place], tags: Mapping[str, str]) -> list[Place]:
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
    own = (
        f"{os.environ.get('LG_HOSTNAME') or socket.gethostname()}/{os.environ.get('LG_USERNAME') or getpass.getuser()}"
    )
    client = functools.partial(_call, coordinator)
    with contextlib.ExitStack() as stack:
        mine = next((place.name for place in fitting if place.holder == own), None)
        if mine is None:
            mine = _reserve_and_acquire(coordinator, wanted, fitting, own, stack, notify, is_over)
        else:
            notify(f"place {mine} is acquired by {own} already, and stays so")
        resources = _resources(client("-p", mine, "env"), mine)
        service = resources.get("NetworkService")
        if service is None:
            raise TargetError(
                f"place {mine} has no NetworkService, which says where its SSH server is; its resources: "
                f"{', '.join(resources) or 'none, is its exporter running?'}"
            )
        if (serial := resources.get("NetworkSerialPort")) is not None:
            stack.enter_context(_keeping_console(serial, console))
        has_power = mine in environment.powered or any(
            "Power" in kind or kind in _POWER_WITHOUT_ITS_NAME for kind in resources
        )
        config = ["-c", str(environment.path)] if environment.path and mine in environment.keys else []

        def power_cycle() -> None:
            client(*config, "-p", mine, "power", "cycle")

        yield AcquiredPlace(
            name=mine,
            host=str(service["address"]),
            port=int(service.get("port", 22)),
            user=str(service["username"]),
            key=environment.keys.get(mine),
            power_cycle=power_cycle if has_power else None,
            has_console=serial is not None,
        )


def _reserve_and_acquire(
    coordinator: str,
    wanted: Mapping[str, str],
    fitting: list[Place],
    own: str,
    stack: contextlib.ExitStack,
    notify: Callable[[str], None],
    is_over: Callable[[], bool],
) -> str:
    printed = _call(coordinator, "reserve", "--shell", *(f"{key}={value}" for key, value in wanted.items()))
    token = next((line.removeprefix(_TOKEN) for line in printed.splitlines() if line.startswith(_TOKEN)), "")
    try:
        if all(place.holder for place in fitting):
            holders = ", ".join(f"{place.name} is held by {place.holder}" for place in fitting)
            notify(f"{holders}: reserved, and waited for")
        _wait(coordinator, token, is_over)
        name = next((place.name for place in list_places(coordinator) if place.reservation == token), None)
        if name is None:
            raise TargetError(f"the coordinator at {coordinator} gave no place for the reservation {token}")
        stack.enter_context(_holding(coordinator, name, own))
        return name
    finally:
        # An acquired place needs no reservation, which would keep it from others for minutes after it is given back.
        with contextlib.suppress(InfrastructureError):
            _call(coordinator, "cancel-reservation", token)


def _wait(coordinator: str, token: str, is_over: Callable[[], bool]) -> None:
    """Wait until a reservation is allocated to a place."""
    # It prints the reservation every second, which nobody reads.
    with _started(coordinator, "wait", token, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as waiting:
        while waiting.poll() is None:
            if is_over():
                raise TargetGone("the campaign was over before the place was free")
            time.sleep(POLL_S)
        _check(waiting, "wait", waiting.communicate()[1])


@contextlib.contextmanager
def _holding(coordinator: str, place: str, own: str) -> Iterator[None]:
    """Have a process acquire a place, and give it back when the context is left, or this process ends."""
    with subprocess.Popen(
        ["sh", "-c", _HOLD, "sh", own, *_CLIENT, "-x", coordinator, "-p", place],
        # The runner has the other end, and nobody else does.
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=_environment(),
        # Ctrl-C on the terminal is not for it.
        start_new_session=True,
        text=True,
        errors="replace",
    ) as process:
        assert process.stdout is not None
        last_line = process.stdout.read().strip().rpartition("\n")[2]
        if last_line != _ACQUIRED:
            raise TargetError(f"place {place} cannot be acquired: {last_line[:500]}")
        yield


@contextlib.contextmanager
def _started(
    coordinator: str, *words: str, stdout: int = subprocess.PIPE, stderr: int = subprocess.STDOUT
) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen(
        [*_CLIENT, "-x", coordinator, *words],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        env=_environment(),
        text=True,
        errors="replace",
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def _call(coordinator: str, *words: str) -> str:
    """Run labgrid's client and return what it printed. Raises TargetError with its last line."""
    with _started(coordinator, *words) as process:
        try:
            output, _ = process.communicate(timeout=CLIENT_S)
        except subprocess.TimeoutExpired as error:
            raise TargetError(f"labgrid-client {' '.join(words)} did not end within {CLIENT_S:g} s") from error
        _check(process, " ".join(words), output)
        return output


def _check(process: "subprocess.Popen[str]", words: str, output: str) -> None:
    if process.returncode:
        last_line = output.strip().rpartition("\n")[2] or f"exit status {process.returncode}"
        raise TargetError(f"labgrid-client {words}: {last_line[:500]}")


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in _VARIABLES}


def _resources(printed: str, place: str) -> dict[str, dict[str, Any]]:
    """The resources of a place by class, from what `labgrid-client env` printed."""
    import yaml

    try:
        # Above the file it may say what it does.
        data = yaml.safe_load(printed[printed.index("targets:") :])
        return dict(_entries(data["targets"][place], "resources"))
    except (ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise TargetError(
            f"place {place}: labgrid-client env printed no environment: {printed.strip()[:200]!r}"
        ) from error


@contextlib.contextmanager
def _keeping_console(port: Mapping[str, Any], path: Path) -> Iterator[None]:
    """Append what a serial port prints to a file while the context lasts."""
    scheme = "socket" if port.get("protocol") == "raw" else "rfc2217"
    url = f"{scheme}://{port['host']}:{port['port']}"
    ended = threading.Event()

    def keep() -> None:
        import serial

        while not ended.is_set():
            # The exporter, or the power switch of the board, may take the port away for a time.
            with (
                contextlib.suppress(OSError, serial.SerialException),
                serial.serial_for_url(url, baudrate=int(port.get("speed") or 115200), timeout=POLL_S) as stream,
            ):
                while not ended.is_set():
                    if data := stream.read(max(1, stream.in_waiting)):
                        with path.open("ab") as log:
                            log.write(data)
            ended.wait(CONSOLE_RETRY_S)

    path.touch()
    reader = threading.Thread(target=keep, daemon=True)
    reader.start()
    try:
        yield
    finally:
        ended.set()
        reader.join(2 * POLL_S + CONSOLE_RETRY_S)
