"""Boards of a labgrid farm: a place is acquired while its context lasts, and given back whatever happens.

Changes at the coordinator are made by labgrid's own client, in a process of its own. A shell gives the place back when
the runner closes the shell's standard input, or when the runner is gone, however it ended.

labgrid identifies the holder of a place only by host and user. So each acquisition here has its own user name: two
runners of one user, or two targets of one campaign, never take the same place.
"""

import contextlib
import getpass
import os
import secrets
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.output import listed
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.labgrid.coordinator import (
    CLIENT_S,
    LabgridClient,
    LabgridPlace,
    allocated,
    find_place,
    has_power,
    list_places,
    matching,
    what_ended,
)
from rtrun.targets.labgrid.environment import Environment
from rtrun.targets.labgrid.health import in_words
from rtrun.targets.labgrid.resources import read_resources, ssh_service
from rtrun.targets.labgrid.serial_console import keeping_console
from rtrun.targets.labgrid.watch import watching

POLL_S = 0.5
_SAY_AFTER_S = 3.0
_NAMED_MAX = 5  # places of a line
# The first word of the line that `labgrid-client reserve --shell` prints.
_TOKEN = "export LG_TOKEN="
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
_PRINTED_MAX = 65536  #: characters that labgrid's client prints
POWER_CYCLES = "power_cycles"
"""The tag that counts how often rtrun switched the power of a place off and on."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedPlace:
    """The place to ask a coordinator for: one with these tags. The tag `name` is the name of the place itself.

    Of those who wait, the one with the highest priority gets a place first. A health check also takes a place in
    quarantine, and does not wait. `preferred` is the place to take if it is free and fits.
    """

    coordinator: str
    tags: Mapping[str, str]
    environment: Environment
    priority: float = 0.0
    is_check: bool = False
    preferred: str | None = None


@contextlib.contextmanager
def acquired(
    wanted: WantedPlace, console: Path, notify: Callable[[str], None], is_over: Callable[[], bool]
) -> Iterator[AcquiredPlace]:
    """Acquire a place and yield it, its serial console kept in a file.

    If all such places are held, one is reserved and waited for until `is_over`. A place that this user has already
    acquired on this machine is taken as it is, even in quarantine, and stays acquired.
    """
    environment = wanted.environment
    client = LabgridClient(coordinator=wanted.coordinator, user=os.environ.get("LG_USERNAME") or getpass.getuser())
    all_fitting = _fitting(wanted)
    with contextlib.ExitStack() as stack:
        name = next((place.name for place in all_fitting if place.holder == client.identity), None)
        is_ours = name is None
        if name is None:
            client = replace(client, user=f"{client.user}-rtrun-{secrets.token_hex(3)}")
            name = _reserve_and_acquire(client, wanted, stack, notify, is_over)
        else:
            notify(f"place {name} is acquired by {client.identity} already, and stays so")
        resources = read_resources(client.call("-p", name, "env"), name)
        service = ssh_service(resources, name)
        if (serial := resources.get("NetworkSerialPort")) is not None:
            stack.enter_context(keeping_console(serial, console))
        stack.enter_context(watching(client, name, notify, is_ours=is_ours))
        config = ["-c", str(environment.path)] if environment.path and name in environment.keys else []

        def power_cycle() -> None:
            try:
                client.call(*config, "-p", name, "power", "cycle")
            except TargetError as error:
                raise _explained(client.coordinator, name, error) from error
            with contextlib.suppress(InfrastructureError):
                if (place := find_place(client.coordinator, name)) is not None:
                    client.set_tags(name, {POWER_CYCLES: str(power_cycles(place) + 1)})

        yield AcquiredPlace(
            name=name,
            host=service.address,
            port=service.port,
            user=service.username,
            key=environment.keys.get(name),
            power_cycle=power_cycle if name in environment.powered or has_power([*resources]) else None,
            has_console=serial is not None,
        )


def _fitting(wanted: WantedPlace) -> list[LabgridPlace]:
    """The places that fit, including those in quarantine. Raises UsageError if there are none."""
    places = list_places(wanted.coordinator)
    fitting = matching(places, wanted.tags)
    if not fitting:
        words = ", ".join(f"{key}={value}" for key, value in wanted.tags.items())
        there = ", ".join(place.name for place in places) or "none"
        raise UsageError(
            f"the labgrid coordinator at {wanted.coordinator} has no place with {words}; its places: {there}"
        )
    return fitting


def _to_be_had(wanted: WantedPlace, fitting: list[LabgridPlace]) -> list[LabgridPlace]:
    """The fitting places that may be taken. Raises TargetError if all are in quarantine."""
    return fitting if wanted.is_check else without_quarantine(fitting)[0]


def without_quarantine(places: Sequence[LabgridPlace]) -> tuple[list[LabgridPlace], str]:
    """The places that are not in quarantine, and why the others are. Raises TargetError if no place is left."""
    healthy = [place for place in places if place.quarantine is None]
    why = "; ".join(
        f"place {place.name} is in quarantine: {in_words(place.quarantine)}" for place in places if place.quarantine
    )
    if not healthy:
        raise TargetError(f"{why}; rtrun farm --check ends a quarantine once the board passes")
    return healthy, why


def power_cycles(place: LabgridPlace) -> int:
    """How often rtrun switched a place off and on; a tag that somebody else wrote may be no number."""
    text = place.tags.get(POWER_CYCLES, "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0


def _explained(coordinator: str, name: str, error: TargetError) -> TargetError:
    """An error that names the exporter if the place's exporter has ended; otherwise the error itself."""
    with contextlib.suppress(InfrastructureError):
        place = find_place(coordinator, name)
        if place and (ended := what_ended(coordinator, place)):
            return TargetError(ended)
    return error


def _reserve_and_acquire(
    client: LabgridClient,
    wanted: WantedPlace,
    stack: contextlib.ExitStack,
    notify: Callable[[str], None],
    is_over: Callable[[], bool],
) -> str:
    tokens: list[str] = []
    say_at: float | None = time.monotonic() + _SAY_AFTER_S
    try:
        while True:
            all_fitting = _fitting(wanted)
            fitting = _to_be_had(wanted, all_fitting)
            is_held = all(place.holder for place in fitting)
            if is_held and wanted.is_check:
                raise TargetGone(", ".join(f"held by {place.holder}" for place in fitting))
            # If several ask at the same time, all of them see a free place. Only waiting shows who has to wait.
            if is_held and say_at is not None:
                notify(_holders(fitting))
                say_at = None
            name = _reserve(client, wanted, fitting, tokens, is_any=len(fitting) == len(all_fitting))
            while name is None:
                if is_over():
                    raise TargetGone("the campaign was over before the place was free")
                if say_at is not None and time.monotonic() > say_at:
                    if wanted.is_check:
                        raise TargetGone("reserved by somebody else")
                    names = {place.name for place in fitting}
                    notify(_holders([place for place in list_places(client.coordinator) if place.name in names]))
                    say_at = None
                time.sleep(POLL_S)
                name = _allocated(client.coordinator, tokens)
            # The place may have been put into quarantine meanwhile.
            if any(place.name == name for place in _to_be_had(wanted, _fitting(wanted))):
                stack.enter_context(_acquire(client, name))
                return name
            _cancel(client, tokens)
    finally:
        # An acquired place needs no reservation, which would keep it from others for minutes after it is given back.
        _cancel(client, tokens)


def _reserve(
    client: LabgridClient, wanted: WantedPlace, fitting: Sequence[LabgridPlace], tokens: list[str], *, is_any: bool
) -> str | None:
    """Reserve a place, and add the tokens of the reservations to `tokens`; return a place that was free, or None.

    The preferred place comes first if it is free. labgrid cannot filter by a tag that a place must not have. So if some
    of the fitting places are in quarantine (not `is_any`), the others are reserved by name, free ones first, until one
    is allocated.
    """
    filters = [wanted.tags]
    if any(place.name == wanted.preferred and not place.holder and not place.reservation for place in fitting):
        filters = [{"name": str(wanted.preferred)}]
    elif not is_any:
        free_first = sorted(fitting, key=lambda place: bool(place.holder or place.reservation))
        filters = [{"name": place.name} for place in free_first]
    for tags in filters:
        words = [f"{key}={value}" for key, value in tags.items()]
        printed = client.call("reserve", "--shell", "--prio", f"{wanted.priority:g}", *words)
        token = next((line.removeprefix(_TOKEN) for line in printed.splitlines() if line.startswith(_TOKEN)), None)
        if token is None:
            raise TargetError(f"labgrid-client reserve printed no token: {printed.strip()[:200]!r}")
        tokens.append(token)
        if (name := allocated(client.coordinator, token)) is not None:
            return name
    return None


def _allocated(coordinator: str, tokens: Sequence[str]) -> str | None:
    """The place that one of the reservations has. Asking for all of them keeps them alive."""
    names = [allocated(coordinator, token) for token in tokens]
    return next((name for name in names if name is not None), None)


def _cancel(client: LabgridClient, tokens: list[str]) -> None:
    while tokens:
        with contextlib.suppress(InfrastructureError):
            client.call("cancel-reservation", tokens.pop())


def _holders(places: Sequence[LabgridPlace]) -> str:
    who = [f"{place.name} is {f'held by {place.holder}' if place.holder else 'reserved'}" for place in places]
    return f"{listed(who, _NAMED_MAX)}: reserved, and waited for"


@contextlib.contextmanager
def _acquire(client: LabgridClient, place: str) -> Iterator[None]:
    """Have a process acquire a place, and give it back when the context is left, or this process ends."""
    with subprocess.Popen(
        ["sh", "-c", _ACQUIRE_AND_RELEASE, "sh", client.identity, *client.command("-p", place)],
        # Only the runner has the other end.
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=client.environment,
        # Ctrl-C on the terminal must not reach this process.
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
            # The process that gives the place back was ended, too.
            with contextlib.suppress(InfrastructureError):
                client.call("-p", place, "release-from", client.identity)
            raise TargetError(f"place {place} was not acquired within {CLIENT_S:g} s")
        if last_line != _ACQUIRED:
            raise _explained(
                client.coordinator, place, TargetError(f"place {place} cannot be acquired: {last_line[:500]}")
            )
        yield
