"""Target files. A board over SSH, a board in QEMU and this machine become the same `Target`."""

import contextlib
import functools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from rtfiles.config import Config, Place, UserPath, matching, parse, read_yaml_with_place
from rtfiles.errors import UsageError
from rtfiles.output import print_note
from rtfiles.wording import unknown
from rtrun.plan.run import KernelName
from rtrun.targets.address import Address, ThisMachine, check_host, read_login
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost, TargetGone
from rtrun.targets.inspection.platform import KnownPlatform, Platform
from rtrun.targets.labgrid import environment as labgrid_environment
from rtrun.targets.labgrid import places as labgrid
from rtrun.targets.labgrid.coordinator import coordinator_of
from rtrun.targets.qemu import emulator as qemu
from rtrun.targets.ssh.ssh_config import address_of

Word = Annotated[str, Field(min_length=1)]
Command = Annotated[list[Word], Field(min_length=1)]
RECONNECT_MAX_S = 604_800  #: waiting for a lost target (`reconnect_s`), a week
BOOT_MAX_S = 86_400  #: waiting for a board of a farm to boot (`boot_s`), a day
# A kernel of 30 MiB is copied on a slow stick, and compared.
CHOOSE_KERNEL_S = 120.0  #: choosing the kernel that a restart boots


# No part of the path may be . or .., since folders in it are removed.
WorkDir = Annotated[
    str,
    matching(
        r"(/\.?[A-Za-z0-9_-][A-Za-z0-9._-]*)+/?",
        "a whole path of letters, digits and . _ -, as /var/lib/rt-tests, without . and ..",
    ),
]


def _host_key(text: str) -> str:
    from rtrun.targets.ssh.host_keys import read_host_key

    read_host_key(text)
    return text


class _Common(Config):
    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[
        str, matching(r"[A-Za-z0-9][A-Za-z0-9._-]*", "a name of letters, digits and . _ -, a letter or digit first")
    ]
    suites: UserPath | None = None
    """Folder of `rtgen suites build` to deploy, relative to this file; none: the suites installed on the target."""
    work_dir: WorkDir = "/var/lib/rt-tests"
    """Folder on the target for deployed suites and running measurements."""
    ros_setup: str | None = None
    """Shell file on the target that sets up ROS; none: /opt/ros/<distro>/setup.sh when there is exactly one."""
    ros_master_port: Annotated[int, Field(ge=1, le=65535)] = 11311
    reconnect_s: Annotated[int, Field(ge=0, le=RECONNECT_MAX_S)] = 120
    """How long a lost target is waited for, in seconds."""


class _Ssh(_Common):
    """What a board with an SSH server has. Values that are None come from ~/.ssh/config, or else from `Address`."""

    key: UserPath | None = None
    host_key: Annotated[str, AfterValidator(_host_key)] | None = None
    known_hosts: UserPath | None = None
    emulated: bool = False
    """True for an emulated machine that looks like a real one. A machine that looks virtual is found without it."""
    restart: Command | None = None
    """Command line on the target that restarts it, for campaigns that ask for several boots or kernels."""
    boot_kernel: dict[KernelName, Command] = Field(default_factory=dict)
    """By kernel: command line on the target after which `restart` starts that kernel."""


class SshConfig(_Ssh):
    """Any board that runs an SSH server."""

    kind: Literal["ssh"]
    host: Annotated[str, AfterValidator(check_host)]
    """A name, an address, or an alias of ~/.ssh/config."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    user: Word | None = None

    @model_validator(mode="after")
    def _restarts_into_kernels(self) -> "SshConfig":
        if self.boot_kernel and self.restart is None:
            raise ValueError("boot_kernel chooses what restart starts: add restart: [systemctl, reboot] or the like")
        return self


class LabgridConfig(_Ssh):
    """A board of a labgrid farm: a place of its coordinator, or any place with these tags."""

    kind: Literal["labgrid"]
    place: Word | None = None
    filter: dict[Word, Word] = Field(default_factory=dict)
    """Tags that the place has."""
    coordinator: Word | None = None
    """HOST or HOST:PORT; none: as labgrid's environment file, LG_COORDINATOR, or labgrid's default."""
    environment: UserPath | None = None
    """labgrid's own environment file, relative to this file, for what a place needs in addition to its resources."""
    priority: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] = 0.0
    """Of those who wait for a place, the one with the highest priority gets it first."""
    boot_s: Annotated[int, Field(ge=1, le=BOOT_MAX_S)] = 180
    """How long the board may take until SSH answers after its power was switched, in seconds."""

    @model_validator(mode="after")
    def _names_places(self) -> "LabgridConfig":
        if (self.place is None) == (not self.filter):
            raise ValueError("give either place: NAME, or filter: with tags of the place")
        return self


class QemuConfig(_Common):
    """A board that the runner boots and ends itself."""

    kind: Literal["qemu"]
    board: UserPath
    """Folder of `rtgen board build`, relative to this file."""


class LocalConfig(_Common):
    """This machine itself, without SSH."""

    kind: Literal["local"]
    work_dir: WorkDir = Field(default_factory=lambda: str(_state_folder() / "rt-tests"))
    emulated: bool = False
    """As for a board behind SSH."""


TargetConfig = SshConfig | QemuConfig | LocalConfig | LabgridConfig
_KINDS: dict[str, type[TargetConfig]] = {
    "ssh": SshConfig,
    "qemu": QemuConfig,
    "local": LocalConfig,
    "labgrid": LabgridConfig,
}


Restart = Callable[[Connection], object]
"""Restarts a target, or chooses what a restart starts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Power:
    """The power switch of a target: `cycle` switches it off and on; the target then boots within `boot_s` seconds."""

    cycle: Callable[[], None]
    boot_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A target that is switched on. Fields with a default exist only for some kinds of targets."""

    name: str
    address: Address | ThisMachine
    suites: Path | None
    work_dir: PurePosixPath
    setup: str | None
    """The shell file that sets up what its middlewares need; None: the one that is found on the target."""
    master_port: int
    reconnect_s: float
    place: str | None = None
    """The place of a labgrid farm that was acquired for it: the board's name if the target is any of several."""
    known_platform: KnownPlatform | None = None
    """The platform if it is known without asking the target; then the target is not asked."""
    boot_s: float = 0.0
    """How long it may take until SSH answers for the first time, in seconds."""
    console: Path | None = None
    restart: Restart | None = None
    """Asks the target to restart, and returns before it restarts; None: the target file does not say how."""
    boot_kernel: Mapping[KernelName, Restart] = field(default_factory=dict)
    """By kernel: chooses the kernel that `restart` starts."""
    power: Power | None = None
    """None: its power cannot be switched."""
    failure: Callable[[], TargetGone | None] = lambda: None
    """Why the target is gone forever, as far as is known without a connection; None while it may answer."""


def target_name(host: str) -> str:
    """A name for the target of a host; empty if no character of the host is allowed in a name."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", host).strip("-._")


def read_target(path: Path) -> TargetConfig:
    """Read a target file, or [USER@]HOST[:PORT] of a board. Raises UsageError with every mistake found."""
    if names_file(path):
        return parse_target(*read_yaml_with_place(path))
    return parse_target(data_of_login(str(path)), str(path))


def names_file(path: Path) -> bool:
    """Whether the name of a target is that of a file, not the login of a board."""
    return path.suffix in (".yml", ".yaml") or path.name != str(path) or path.is_file()


def data_of_login(text: str) -> dict[str, object]:
    """The data of a target file for [USER@]HOST[:PORT]. Raises UsageError."""
    try:
        login = read_login(text)
    except ValueError as error:
        raise UsageError(f"--target {text}: {error}; a target file ends in .yml") from error
    port = f"-{login['port']}" if "port" in login else ""
    return {"schema": 1, "name": f"{target_name(str(login['host'])) or 'board'}{port}", "kind": "ssh"} | login


def parse_target(data: object, origin: Place | str) -> TargetConfig:
    """Read what a target file holds. Raises UsageError with every mistake found."""
    top = Place(origin) if isinstance(origin, str) else origin
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind is None:
        raise UsageError(f"{top / 'kind'}: is missing, allowed: {', '.join(_KINDS)}")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise UsageError(f"{top / 'kind'}: {unknown('kind', kind, known=_KINDS, label='allowed')}")
    return parse(data, _KINDS[kind], top)


@contextlib.contextmanager
def connect(
    config: TargetConfig,
    folder: Path,
    console: Path,
    *,
    notify: Callable[[str], None] = print_note,
    is_over: Callable[[], bool] = lambda: False,
    is_check: bool = False,
    preferred: str | None = None,
) -> Iterator[Target]:
    """Yield the target; a board in QEMU is booted, a place of a farm acquired, until the context is left.

    Relative paths of the config are relative to `folder`. The serial console of such a board goes to `console`. If all
    places are held, `notify` reports that, and the wait lasts until `is_over`. A health check may take a place in
    quarantine, but does not wait: it raises TargetGone. `preferred` is the place to take if it is free.
    """
    target = functools.partial(
        Target,
        name=config.name,
        suites=_resolve(folder, config.suites) if config.suites is not None else None,
        work_dir=PurePosixPath(config.work_dir),
        setup=config.ros_setup,
        master_port=config.ros_master_port,
        reconnect_s=config.reconnect_s,
    )
    if isinstance(config, QemuConfig):
        with qemu.boot(_resolve(folder, config.board), console) as machine:
            yield target(
                address=machine.address,
                known_platform=machine.platform,
                failure=machine.failure,
                console=machine.console,
                restart=machine.reset,
                boot_kernel={kernel: functools.partial(machine.choose, kernel) for kernel in machine.board.kernels},
                boot_s=300.0,
            )
        return
    stated = KnownPlatform(platform=Platform.EMULATED, evidence="stated in the target file")
    known_platform = stated if config.emulated else None
    if isinstance(config, LocalConfig):
        yield target(address=ThisMachine(), known_platform=known_platform)
        return
    restart, boot_kernel = _restarting(config)
    target = functools.partial(target, known_platform=known_platform, boot_kernel=boot_kernel)
    if isinstance(config, SshConfig):
        yield target(address=_address(config, folder, config.host, config.port, config.user), restart=restart)
        return
    wanted = replace(wanted_place(config, folder), is_check=is_check, preferred=preferred)
    with labgrid.acquired(wanted, console, notify, is_over) as place:
        cycle = place.power_cycle
        yield target(
            address=_address(config, folder, place.host, place.port, place.user, place.key),
            place=place.name,
            console=console if place.has_console else None,
            power=None if cycle is None else Power(cycle=cycle, boot_s=config.boot_s),
            restart=restart if restart or cycle is None else lambda _: cycle(),
        )


def wanted_place(config: LabgridConfig, folder: Path) -> labgrid.WantedPlace:
    """The place that a target file asks for, and at which coordinator. Raises UsageError for a bad environment file."""
    environment = labgrid_environment.Environment()
    if config.environment is not None:
        environment = labgrid_environment.read_environment(_resolve(folder, config.environment))
    return labgrid.WantedPlace(
        coordinator=coordinator_of(config.coordinator, environment),
        tags={"name": config.place} if config.place is not None else config.filter,
        environment=environment,
        priority=config.priority,
    )


def _address(
    config: SshConfig | LabgridConfig,
    folder: Path,
    host: str,
    port: int | None,
    user: str | None,
    key: Path | None = None,
) -> Address:
    from rtrun.targets.ssh.login import check_key_file

    key = _resolve(folder, config.key) if config.key is not None else key
    if key is not None:
        check_key_file(key)
    known_hosts = _resolve(folder, config.known_hosts) if config.known_hosts is not None else None
    if known_hosts is not None and not known_hosts.is_file():
        raise UsageError(f"{known_hosts}: no such file: name one of host keys as 'known_hosts', or leave it out")
    return address_of(
        host,
        port=port,
        user=user,
        key=key,
        host_key=config.host_key,
        known_hosts=known_hosts,
    )


def _restarting(config: SshConfig | LabgridConfig) -> tuple[Restart | None, dict[KernelName, Restart]]:
    """From the target file: the function that restarts the target, and by kernel the one that chooses it before."""
    restart = functools.partial(_restart_by_command, config.restart) if config.restart else None
    return restart, {
        kernel: functools.partial(Connection.check, argv=command, deadline_s=CHOOSE_KERNEL_S)
        for kernel, command in config.boot_kernel.items()
    }


def _state_folder() -> Path:
    """Where programs keep state of this user (XDG base directory specification); it survives a restart."""
    return Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser()


def _resolve(folder: Path, path: str) -> Path:
    return folder / Path(path).expanduser()


def _restart_by_command(argv: Sequence[str], connection: Connection) -> None:
    # The board may be gone before it answers. If asked a second time, it would restart once more.
    with contextlib.suppress(ConnectionLost):
        connection.check(argv)
