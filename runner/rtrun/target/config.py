"""Target files. A board over SSH, a board in QEMU and this machine become the same `Target`."""

import contextlib
import functools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from rtfiles.config import Config, UserPath, parse, read_yaml
from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtrun.plan.run import KernelName
from rtrun.target import qemu
from rtrun.target.address import Address, ThisMachine, check_host
from rtrun.target.connection import Connection
from rtrun.target.errors import ConnectionLost, TargetGone
from rtrun.target.platform import KnownPlatform, Platform
from rtrun.target.ssh_config import address_of

Word = Annotated[str, Field(min_length=1)]
Command = Annotated[list[Word], Field(min_length=1)]


# No part of it is . or ..: folders in it are removed.
WorkDir = Annotated[str, Field(pattern=r"^(/\.?[A-Za-z0-9_-][A-Za-z0-9._-]*)+/?$")]


class _Common(Config):
    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    suites: UserPath | None = None
    """Folder of `rtgen suites build` to deploy, relative to this file; none: those installed on the target."""
    work_dir: WorkDir = "/var/lib/rt-tests"
    """Folder on the target for deployed suites and running measurements."""
    ros_setup: str | None = None
    """Shell file on the target that sets up ROS; none: /opt/ros/<distro>/setup.sh when there is exactly one."""
    ros_master_port: Annotated[int, Field(ge=1, le=65535)] = 11311
    reconnect_s: Annotated[int, Field(ge=0)] = 120
    """How long a lost target is waited for, in seconds."""


class SshConfig(_Common):
    """Any board that runs an SSH server. What is None here is as ~/.ssh/config says, or else as `Address` has it."""

    kind: Literal["ssh"]
    host: Annotated[str, AfterValidator(check_host)]
    """A name, an address, or an alias of ~/.ssh/config."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    user: Word | None = None
    key: UserPath | None = None
    host_key: str | None = None
    known_hosts: UserPath | None = None
    emulated: bool = False
    """True for an emulated machine that looks like a real one. What looks virtual is found without it."""
    restart: Command | None = None
    """Command line on the target that restarts it, for campaigns that ask for several boots or kernels."""
    boot_kernel: dict[KernelName, Command] = Field(default_factory=dict)
    """By kernel: command line on the target after which `restart` starts that kernel."""

    @model_validator(mode="after")
    def _restarts_into_kernels(self) -> "SshConfig":
        if self.boot_kernel and self.restart is None:
            raise ValueError("boot_kernel chooses what restart starts: add restart: [systemctl, reboot] or the like")
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


TargetConfig = SshConfig | QemuConfig | LocalConfig
_KINDS: dict[str, type[TargetConfig]] = {"ssh": SshConfig, "qemu": QemuConfig, "local": LocalConfig}


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A target that is switched on."""

    name: str
    known_platform: KnownPlatform | None = None
    """What is known without asking the target, and not to be asked then."""
    address: Address | ThisMachine
    suites: Path | None
    work_dir: PurePosixPath
    ros_setup: str | None
    ros_master_port: int
    reconnect_s: float
    boot_s: float
    """How long it may take until SSH answers for the first time, in seconds."""
    console: Path | None
    restart: Callable[[Connection], None] | None = None
    """Asks the target to restart, and returns before it does; None: nobody has said how."""
    boot_kernel: Mapping[KernelName, Callable[[Connection], None]] = field(default_factory=dict)
    """By kernel: chooses it as the one that `restart` starts."""
    failure: Callable[[], TargetGone | None]
    """Why the target is gone for good, as far as can be known without a connection to it; None while it may answer."""


def read_target(path: Path) -> TargetConfig:
    """Read a target file. Raises UsageError with every mistake found."""
    return parse_target(read_yaml(path), str(path))


def parse_target(data: object, origin: str) -> TargetConfig:
    """Read what a target file holds. Raises UsageError with every mistake found."""
    kind = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in _KINDS:
        raise UsageError(f"{origin}: kind: missing or unknown, allowed: {', '.join(_KINDS)}")
    return parse(data, _KINDS[kind], origin)


@contextlib.contextmanager
def connect(config: TargetConfig, folder: Path, console: Path) -> Iterator[Target]:
    """Yield the target; a board in QEMU is booted, and ended when the context is left.

    Relative paths of the config are relative to `folder`. The serial console of a board in QEMU goes to `console`.
    """
    suites = _resolve(folder, config.suites) if config.suites is not None else None
    if suites is not None and not suites.is_dir():
        raise UsageError(f"{suites}: no such folder; suites are built with: {as_called('rtgen')} suites build")
    if suites is not None and not (suites / "build.json").is_file():
        raise UsageError(f"{suites}: has no build.json: name the folder that {as_called('rtgen')} suites build printed")
    address: Address | ThisMachine
    failure: Callable[[], TargetGone | None] = _no_failure
    restart: Callable[[Connection], None] | None = None
    boot_kernel: dict[KernelName, Callable[[Connection], None]] = {}
    console_log, boot_s = None, 0.0
    known_platform = None
    if not isinstance(config, QemuConfig) and config.emulated:
        known_platform = KnownPlatform(platform=Platform.EMULATED, evidence="stated in the target file")
    with contextlib.ExitStack() as stack:
        if isinstance(config, QemuConfig):
            board = _resolve(folder, config.board)
            machine = stack.enter_context(qemu.boot(board, console))
            known_platform = machine.platform
            address, failure, console_log = machine.address, machine.failure, machine.console
            restart = machine.reset
            boot_kernel = {kernel: functools.partial(machine.choose, kernel) for kernel in machine.board.kernels}
            boot_s = 300.0
        elif isinstance(config, LocalConfig):
            address = ThisMachine()
        else:
            address = address_of(
                config.host,
                port=config.port,
                user=config.user,
                key=_resolve(folder, config.key) if config.key is not None else None,
                host_key=config.host_key,
                known_hosts=_resolve(folder, config.known_hosts) if config.known_hosts is not None else None,
            )
            restart = functools.partial(_restart_by_command, config.restart) if config.restart else None
            boot_kernel = {
                kernel: functools.partial(_choose_by_command, command) for kernel, command in config.boot_kernel.items()
            }
        yield Target(
            name=config.name,
            known_platform=known_platform,
            address=address,
            suites=suites,
            work_dir=PurePosixPath(config.work_dir),
            ros_setup=config.ros_setup,
            ros_master_port=config.ros_master_port,
            reconnect_s=config.reconnect_s,
            boot_s=boot_s,
            console=console_log,
            restart=restart,
            boot_kernel=boot_kernel,
            failure=failure,
        )


def _state_folder() -> Path:
    """Where programs keep state of this user (XDG base directory specification); it survives a restart."""
    return Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser()


def _resolve(folder: Path, path: str) -> Path:
    return folder / Path(path).expanduser()


def _restart_by_command(argv: Sequence[str], connection: Connection) -> None:
    # The board may be gone before it answers; asked a second time, it would restart once more.
    with contextlib.suppress(ConnectionLost):
        connection.check(argv)


def _choose_by_command(argv: Sequence[str], connection: Connection) -> None:
    connection.check(argv)


def _no_failure() -> None:
    return None
