"""Ask a labgrid coordinator for its places and for the resources that exporters offer, and change places there.

The coordinator is asked directly. Changes are made by labgrid's own client, in a process of its own.
"""

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rtfiles.errors import UsageError
from rtfiles.invocation import install_extra
from rtrun.targets.errors import TargetError
from rtrun.targets.labgrid.environment import Environment

COORDINATOR = "127.0.0.1:20408"
# A client starts, connects and waits for the exporter, whose power switch may pause for some seconds.
CLIENT_S = 120.0  #: a call of labgrid's client
ANSWER_S = 15.0  #: an answer of a labgrid coordinator
QUARANTINE = "quarantine"
"""The tag of a place that failed its health check twice; its value is the reason."""
# The client reads these, too.
_VARIABLES = ("LG_ENV", "LG_PLACE", "PLACE", "LG_TOKEN", "LG_STATE", "STATE", "LG_INITIAL_STATE", "LG_COORDINATOR")
# Resources that have a power driver although their names do not say so.
_ALSO_POWER = ("PDUDaemonPort", "NetworkSysfsGPIO")
# The state of a reservation that a place was allocated to (labgrid's ReservationState).
_ALLOCATED = 1
_SYNC = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class LabgridPlace:
    """A place of a coordinator, and who holds it, as ``host/user``.

    `matches` are the patterns of its resources, as ``exporter/group/class``.
    """

    name: str
    tags: Mapping[str, str]
    matches: tuple[str, ...]
    holder: str | None
    reservation: str | None

    @property
    def quarantine(self) -> str | None:
        """Why it is in quarantine; None where it is not."""
        return self.tags.get(QUARANTINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class OfferedResource:
    """A resource that an exporter offers now."""

    exporter: str
    group: str
    kind: str
    name: str
    is_available: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LabgridClient:
    """labgrid's client as a user of a coordinator."""

    coordinator: str
    user: str

    @property
    def identity(self) -> str:
        """The name under which the coordinator lists this client as holder of a place."""
        return f"{os.environ.get('LG_HOSTNAME') or socket.gethostname()}/{self.user}"

    @property
    def environment(self) -> dict[str, str]:
        """The environment of its process. labgrid's variables about places are left out: the target file decides."""
        return {name: value for name, value in os.environ.items() if name not in _VARIABLES} | {
            "LG_USERNAME": self.user
        }

    def command(self, *words: str) -> list[str]:
        """Its command line."""
        return [sys.executable, "-m", "labgrid.remote.client", "-x", self.coordinator, *words]

    def call(self, *words: str) -> str:
        """Run it and return what it printed. Raises TargetError with its last line."""
        try:
            done = subprocess.run(
                self.command(*words),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=self.environment,
                text=True,
                errors="replace",
                timeout=CLIENT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise TargetError(f"labgrid-client {' '.join(words)} did not end within {CLIENT_S:g} s") from error
        if done.returncode:
            last_line = done.stdout.strip().rpartition("\n")[2] or f"exit status {done.returncode}"
            raise TargetError(f"labgrid-client {' '.join(words)}: {last_line[:500]}")
        return done.stdout

    def set_tags(self, place: str, tags: Mapping[str, str]) -> None:
        """Set tags of a place; an empty value removes one. Raises TargetError."""
        if tags:
            self.call("-p", place, "set-tags", *(f"{key}={value}" for key, value in tags.items()))


def coordinator_of(given: str | None, environment: Environment) -> str:
    """The coordinator's address: from the target file, labgrid's environment file or variable, or labgrid's default."""
    return given or environment.coordinator or os.environ.get("LG_COORDINATOR") or COORDINATOR


def list_places(coordinator: str) -> list[LabgridPlace]:
    """Ask a coordinator for its places, by name. Raises UsageError when labgrid is not installed, TargetError."""
    with _asked(coordinator) as (stub, messages):
        reply = stub.GetPlaces(messages.GetPlacesRequest(), timeout=ANSWER_S)
    return [
        LabgridPlace(
            name=place.name,
            tags=dict(place.tags),
            matches=tuple("/".join(filter(None, (m.exporter, m.group, m.cls, m.name))) for m in place.matches),
            holder=place.acquired or None,
            reservation=place.reservation or None,
        )
        for place in sorted(reply.places, key=lambda place: str(place.name))
    ]


def find_place(coordinator: str, name: str) -> LabgridPlace | None:
    """Ask a coordinator for a place; None where it has none of that name. Raises as `list_places` does."""
    return next((place for place in list_places(coordinator) if place.name == name), None)


def matching(places: Sequence[LabgridPlace], tags: Mapping[str, str]) -> list[LabgridPlace]:
    """The places that have all of these tags. The tag `name` is the name of the place itself."""
    return [place for place in places if tags.items() <= {**place.tags, "name": place.name}.items()]


def list_resources(coordinator: str) -> list[OfferedResource]:
    """Ask a coordinator what exporters offer. Raises as `list_places` does."""
    found = []
    with _asked(coordinator) as (stub, messages):
        # Only listeners get the resources. What was asked for before the sync arrives before its answer.
        requests = (
            messages.ClientInMessage(startup=messages.StartupDone(version="rtrun", name="rtrun/rtrun")),
            messages.ClientInMessage(subscribe=messages.Subscribe(all_resources=True)),
            messages.ClientInMessage(sync=messages.Sync(id=_SYNC)),
        )
        replies = stub.ClientStream(iter(requests), timeout=ANSWER_S)
        for reply in replies:
            found += [update.resource for update in reply.updates if update.WhichOneof("kind") == "resource"]
            if reply.HasField("sync") and reply.sync.id == _SYNC:
                break
        replies.cancel()
    return [
        OfferedResource(
            exporter=resource.path.exporter_name,
            group=resource.path.group_name,
            kind=resource.cls,
            name=resource.path.resource_name,
            is_available=resource.avail,
        )
        for resource in found
    ]


def allocated(coordinator: str, token: str) -> str | None:
    """The place that a reservation has; None while it waits. Asking keeps it alive. Raises as `list_places` does."""
    with _asked(coordinator) as (stub, messages):
        reply = stub.PollReservation(messages.PollReservationRequest(token=token), timeout=ANSWER_S)
    return next(iter(reply.reservation.allocations.values()), None) if reply.reservation.state == _ALLOCATED else None


def resources_of(place: LabgridPlace, offered: Sequence[OfferedResource]) -> list[OfferedResource]:
    """The resources that are offered for a place."""
    return [resource for resource in offered if any(_fits(pattern, resource) for pattern in place.matches)]


def unoffered(place: LabgridPlace, offered: Sequence[OfferedResource]) -> list[str]:
    """The patterns of a place that no resource offered now fits."""
    return [pattern for pattern in place.matches if not any(_fits(pattern, resource) for resource in offered)]


def what_ended(coordinator: str, place: LabgridPlace) -> str:
    """The message about a place whose exporter ended; empty if all is offered. Raises as `list_places` does."""
    missing = unoffered(place, list_resources(coordinator))
    return f"place {place.name}: {nobody_offers(missing)}" if missing else ""


def nobody_offers(patterns: Sequence[str]) -> str:
    """The message when no place matches these patterns."""
    exporters = sorted({name for pattern in patterns if (name := pattern.partition("/")[0]) and "*" not in name})
    who = f"the exporter {', '.join(exporters)}" if exporters else "its exporter"
    return f"nobody offers {', '.join(patterns)}: {who} ended or was not started (labgrid-exporter)"


def has_power(kinds: Sequence[str]) -> bool:
    """Whether one of these kinds of resources is a power switch."""
    return any("Power" in kind or kind in _ALSO_POWER for kind in kinds)


def _fits(pattern: str, resource: OfferedResource) -> bool:
    from labgrid.remote.common import ResourceMatch

    path = (resource.exporter, resource.group, resource.kind, resource.name)
    return bool(ResourceMatch.fromstr(pattern).ismatch(path))


@contextlib.contextmanager
def _asked(coordinator: str) -> Iterator[tuple[Any, Any]]:
    """Yield a stub that asks a coordinator, and the types of its messages."""
    try:
        import grpc
        from labgrid.remote.generated import labgrid_coordinator_pb2 as messages
        from labgrid.remote.generated import labgrid_coordinator_pb2_grpc as services
    except ImportError as error:
        raise UsageError(f"targets of labgrid need the package labgrid: {install_extra('farm')} ({error})") from error
    address = coordinator if ":" in coordinator else f"{coordinator}:20408"
    try:
        # A separate connection: a coordinator tells listeners apart only by connection, and gRPC would share one.
        with grpc.insecure_channel(address, [("grpc.use_local_subchannel_pool", 1)]) as channel:
            yield services.CoordinatorStub(channel), messages
    except grpc.RpcError as error:
        if error.code() == grpc.StatusCode.FAILED_PRECONDITION:
            raise TargetError(f"the labgrid coordinator at {address}: {error.details()}") from error
        raise TargetError(
            f"the labgrid coordinator at {address} does not answer: {error.details() or error.code()}; "
            "is labgrid-coordinator running there, and is LG_COORDINATOR or `coordinator` in the target file right?"
        ) from error
