"""Commands, files and ports of a target, over SSH or on this machine.

Commands are argument lists; they are quoted only where they are sent. The target is not trusted: every operation has a
total deadline, and the output of a command is limited.
"""

import contextlib
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from rtfiles import untrusted
from rtrun.targets.address import Address, ThisMachine
from rtrun.targets.errors import ConnectionLost, DeadlineExpired, TargetError
from rtrun.targets.local import LocalShell
from rtrun.targets.receiving import LARGE_BYTES, Receiver, is_faster_compressed, local_file, reading
from rtrun.targets.shell import CHUNK_BYTES, OUTPUT_BYTES_MAX, Collector, Shell

COMMAND_S = 30.0  #: a command on the target, unless its caller sets another time
# A transfer that is slower than this has failed. The time includes the work on a file after its arrival.
TRANSFER_S = 120.0  #: a transfer and its check, besides the time for its bytes
TRANSFER_BYTES_PER_S = 50_000  #: the slowest transfer that is accepted
# Uses find, which prints while it reads. ls and the shell would sort the whole folder first.
_LIST = """
cd "$1" || exit 1
matches_max=$2
shift 2
find . ! -name . -prune | wc -l
names=$(for name; do
    case $name in
        *[*]*) find . ! -name . -prune -name "$name" | head -n "$matches_max" | sed 's,^[.]/,,' ;;
        *) echo "$name" ;;
    esac
done)
set -f
IFS='
'
# shellcheck disable=SC2086 # each line is a name
LC_ALL=C ls -lnd -- . $names 2>/dev/null
exit 0
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Completed:
    """A remote command that ended: its exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


class Connection:
    """A target that answers. Every call has a deadline; every transport failure is a `ConnectionLost`."""

    def __init__(self, address: Address | ThisMachine, *, timeout_s: float = 15.0) -> None:
        self.address = address
        self.shell: Shell
        if isinstance(address, ThisMachine):
            self.shell = LocalShell(address)
        else:
            # Code that only reads results imports this module, too, and paramiko takes long to load.
            from rtrun.targets.ssh.ssh_shell import SshShell

            self.shell = SshShell(address, timeout_s=timeout_s)
        # Whether large files are sent compressed; the first one decides by measurement.
        self._is_compressing: bool | None = None

    def close(self) -> None:
        """Close the connection; what runs detached on the target goes on."""
        self.shell.close()

    def interrupt(self) -> None:
        """Break the connection, so that a thread that waits for it gets ConnectionLost."""
        self.shell.interrupt()

    def run(
        self,
        argv: Sequence[str],
        *,
        deadline_s: float = COMMAND_S,
        stdin: str = "",
        on_line: Callable[[str], None] | None = None,
    ) -> Completed:
        """Run a command and wait for its end; `on_line` gets each line of its output when it arrives.

        Raises DeadlineExpired after `deadline_s` seconds, once what was started has been killed; TargetError when it
        prints more than 2 MiB; ConnectionLost.
        """
        stdout = Collector(OUTPUT_BYTES_MAX, on_line)
        status, stderr = self.shell.execute(argv, [stdin.encode()] if stdin else [], stdout, deadline_s)
        return Completed(status=status, stdout=stdout.text(), stderr=stderr)

    def check(
        self,
        argv: Sequence[str],
        *,
        deadline_s: float = COMMAND_S,
        stdin: str = "",
        on_line: Callable[[str], None] | None = None,
    ) -> str:
        """`run`, and return the output; a nonzero exit status is a TargetError with the last line of output."""
        result = self.run(argv, deadline_s=deadline_s, stdin=stdin, on_line=on_line)
        if result.status != 0:
            last_line = _last_line(result.stderr) or _last_line(result.stdout) or "it printed nothing"
            raise TargetError(f"{self.address}: {argv[0]} failed with exit status {result.status}: {last_line}")
        return result.stdout

    def check_promptly(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S) -> str:
        """`check` of a command that any target answers at once: no answer in time is a ConnectionLost."""
        try:
            return self.check(argv, deadline_s=deadline_s)
        except DeadlineExpired as error:
            raise ConnectionLost(f"{self.address}: does not answer: {error}") from error

    def upload(self, source: Path, destination: PurePosixPath, then: Sequence[str] = ("true",)) -> None:
        """Copy a local file to the target, and run a command there on the copy.

        Raises TargetError when the target cannot hold the file or the command fails, ConnectionLost. If the connection
        is lost, the file ends early, and the command runs on the part that has arrived.
        """
        argv = ["sh", "-c", 'cat >"$1" && shift && exec "$@"', "sh", str(destination), *then]
        with local_file(source), source.open("rb") as stream:
            chunks = iter(lambda: _read_local(source, stream), b"")
            size = source.stat().st_size
            status, stderr = self.shell.execute(argv, chunks, Collector(OUTPUT_BYTES_MAX), _transfer_s(size))
        if status != 0:
            full = "; the target's disk is full (df -h)" if "No space left" in stderr else ""
            raise TargetError(f"{self.address}: cannot write {destination}: {_last_line(stderr)}{full}")

    def download(self, folder: PurePosixPath, sizes: Mapping[str, int], destination: Path) -> None:
        """Copy files of a folder of the target into a folder here, all at once, compressed if that takes less time.

        `sizes` are the sizes that the target has reported, by name. Raises TargetError when more arrives, or a file
        cannot be read or arrives with another checksum than it has on the target; ConnectionLost; InfrastructureError
        when a copy cannot be written.
        """
        # The largest file comes first: its first pieces are used to measure.
        sizes = dict(sorted(sizes.items(), key=lambda item: item[1], reverse=True))
        first, size_bytes = next(iter(sizes.items()))
        receiver = Receiver(self.address, folder, sizes, destination)
        is_large = size_bytes >= LARGE_BYTES
        if is_large and self._is_compressing is None:
            self._is_compressing = is_faster_compressed(self.shell, folder / first, receiver)
        is_compressed = is_large and bool(self._is_compressing)
        status, stderr = self.shell.execute(
            reading(folder, sizes, skip_bytes=receiver.received_bytes, is_compressed=is_compressed),
            [],
            receiver.take_compressed if is_compressed else receiver.take,
            _transfer_s(sum(sizes.values())),
        )
        if status != 0:
            raise TargetError(f"{self.address}: cannot read {folder}: {_last_line(stderr)}")
        receiver.check(stderr)

    def open_port(self, port: int, *, deadline_s: float) -> AbstractContextManager[Any]:
        """Yield a stream to a port of the target's own loopback, which is closed after `deadline_s` seconds.

        Raises ConnectionRefusedError when nobody listens.
        """
        return self.shell.open_port(port, deadline_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """Files in a folder of the target."""

    sizes: Mapping[str, int]
    """Name to size in bytes, of the regular files that were asked for; links are not followed."""
    total: int
    """How many files and folders there are, with any name."""


def listing(folder: PurePosixPath, names: Iterable[str], *, matches_max: int) -> list[str]:
    """The command that lists files of a folder by their names, for `parse_listing`.

    A name with ``*`` is a pattern that matches at most `matches_max` files. So the length of the answer does not depend
    on how much others have put into the folder.
    """
    return ["sh", "-c", _LIST, "sh", str(folder), str(matches_max), *names]


def parse_listing(text: str) -> Listing:
    """Read the output of `listing`. Other lines are ignored."""
    total, *lines = text.splitlines() or [""]
    sizes = {}
    for line in lines:
        # Mode, links, user, group, size, three words of the time, name.
        words = line.split(None, 8)
        if len(words) < 9 or not line.startswith("-"):
            continue
        with contextlib.suppress(ValueError):
            sizes[words[8]] = untrusted.whole_number(words[4], lowest=0)
    try:
        return Listing(sizes=sizes, total=untrusted.whole_number(total.strip(), lowest=0))
    except ValueError:
        return Listing(sizes=sizes, total=len(sizes))


def join_commands(commands: Iterable[Sequence[str]]) -> list[str]:
    """One command that runs these one after the other until one fails: one round trip, not many."""
    return ["sh", "-c", " && ".join(map(shlex.join, commands))]


def _read_local(path: Path, stream: IO[bytes]) -> bytes:
    with local_file(path):
        return stream.read(CHUNK_BYTES)


def _transfer_s(size_bytes: int) -> float:
    return TRANSFER_S + size_bytes / TRANSFER_BYTES_PER_S


def _last_line(text: str) -> str:
    return text.strip().rpartition("\n")[2][:500]
