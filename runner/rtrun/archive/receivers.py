"""Who is notified of alarms, and how: a command, a web hook, a mail.

Anybody may choose the names of boards and scenarios. So no text of an alarm becomes part of a command line, an address
or a header: a command receives it on standard input, a hook as JSON, a mail as its body.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from rtfiles.config import Config, matching
from rtfiles.errors import InfrastructureError
from rtfiles.output import counted, printable
from rtrun.archive.alarms import Alarm, Kind
from rtrun.targets.address import check_server

RECEIVE_S = 60.0  #: telling one receiver, the look-up of its name included
STDERR_BYTES_MAX = 4096  #: the end of a command's standard error that is kept
_STDERR_S = 5.0  # for its end, where a background process keeps it open
SHOWN_MAX = 50  # alarms that a text spells out
_TITLES: dict[Kind, tuple[str, str, str]] = {
    "worse": ("WORSE", "scenario", "got worse"),
    "worse build": ("WORSE", "case", "of a build worse than its history"),
    "failed": ("FAILED", "scenario", "failed"),
    "offline": ("OFFLINE", "board", "offline"),
    "quarantine": ("QUARANTINE", "board", "in quarantine"),
    "new": ("NEW", "board", "new"),
}
"""By the kind of an alarm: its word, and what a title counts."""
_Name = Annotated[str, matching(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}", "a name of letters, digits and . _ - and spaces")]
_Address = Annotated[str, matching(r"[^\s<>,;:\"()\[\]@]{1,64}@[^\s<>,;:\"()\[\]@]{1,255}", "an address, as a@b.org")]


def _check_url(text: str) -> str:
    check_server(urlsplit(text).netloc)
    return text


_Url = Annotated[
    str,
    matching(r"https?://[!-~]+", "an address that begins with https:// or http://"),
    AfterValidator(_check_url),
]
_Server = Annotated[str, Field(min_length=1), AfterValidator(check_server)]
_Word = Annotated[str, matching(r"[^\0]+", "a word without a NUL")]


class CommandReceiver(Config):
    """A command line, run without a shell, that reads the text."""

    name: _Name
    kind: Literal["command"]
    command: Annotated[list[_Word], Field(min_length=1)]


class HookReceiver(Config):
    """An address that accepts a POST of JSON."""

    name: _Name
    kind: Literal["hook"]
    url: _Url


class MailReceiver(Config):
    """A mail server that accepts mail without a login, and the recipients."""

    name: _Name
    kind: Literal["mail"]
    server: Annotated[_Server, matching(r".+:[0-9]+", "HOST:PORT")]
    sender: _Address = Field(alias="from")
    to: Annotated[list[_Address], Field(min_length=1, max_length=100)]


AnyReceiver = Annotated[CommandReceiver | HookReceiver | MailReceiver, Field(discriminator="kind")]


class Receivers(Config):
    """A file that states who is notified of what.

    `site` is where the pages of `rtrun site` are served, for links. `coordinator` belongs to a labgrid farm; its boards
    in quarantine are reported too.
    """

    schema_number: Literal[1] = Field(alias="schema")
    site: _Url | None = None
    coordinator: _Server | None = None
    receivers: Annotated[list[AnyReceiver], Field(min_length=1, max_length=100)]


def tell(receiver: CommandReceiver | HookReceiver | MailReceiver, alarms: Sequence[Alarm], site: str | None) -> None:
    """Notify a receiver of alarms, at least one, within RECEIVE_S.

    Raises InfrastructureError where the receiver does not accept them, whatever the reason.
    """
    try:
        match receiver:
            case CommandReceiver():
                text = as_text(alarms, site, most=len(alarms))
                _run(receiver.command, text.encode(), of_user=True)
            case HookReceiver():
                _deliver(kind="hook", url=receiver.url, data=as_data(alarms, site))
            case MailReceiver():
                host, _, port = receiver.server.rpartition(":")
                _deliver(
                    kind="mail",
                    host=host.strip("[]"),
                    port=int(port),
                    sender=receiver.sender,
                    to=receiver.to,
                    subject=title(alarms),
                    text=as_text(alarms, site, most=len(alarms)),
                )
    except Exception as error:  # of this receiver only: the others are notified
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InfrastructureError(f"{receiver.name}: not told: {printable(str(reason))[:300]}") from error


def title(alarms: Sequence[Alarm]) -> str:
    """How many alarms there are, without names."""
    counts = Counter(str(alarm.kind) for alarm in alarms)
    parts = [f"{counted(counts[kind], noun)} {rest}" for kind, (_, noun, rest) in _TITLES.items() if counts[kind]]
    return f"rtrun: {', '.join(parts)}"


def as_text(alarms: Sequence[Alarm], site: str | None, *, most: int) -> str:
    """The alarms for people, some lines each, at most `most` alarms."""
    lines = [title(alarms).removeprefix("rtrun: "), ""]
    for alarm in alarms[:most]:
        shown = _shown(alarm, site)
        lines += [f"{_TITLES[alarm.kind][0]}  {shown['about']}", f"  {shown['size']}", f"  since: {shown['since']}"]
        lines += [f"  suspected: {shown['suspected']}", *([f"  {shown['link']}"] if shown["link"] else []), ""]
    if (more := len(alarms) - most) > 0:
        lines.append(f"and {more} more")
    return "\n".join(lines).rstrip() + "\n"


def as_data(alarms: Sequence[Alarm], site: str | None) -> dict[str, Any]:
    """The alarms as plain data; `text` is what chat hooks show, limited to the first alarms."""
    return {
        "schema": 1,
        "text": as_text(alarms, site, most=SHOWN_MAX),
        "alarms": [_shown(alarm, site) for alarm in alarms],
    }


def _shown(alarm: Alarm, site: str | None) -> dict[str, str | None]:
    """The parts of an alarm that are sent, each text one line that can be encoded."""
    texts = {name: printable(getattr(alarm, name)) for name in ("kind", "about", "size", "since", "suspected")}
    return {**texts, "link": f"{site.rstrip('/')}/{alarm.page}" if site and alarm.page else None}


def _deliver(**message: Any) -> None:
    program = Path(__file__).with_name("delivering.py")
    _run([sys.executable, "-I", str(program)], json.dumps({**message, "timeout_s": RECEIVE_S}).encode())


def _run(command: Sequence[str], content: bytes, *, of_user: bool = False) -> None:
    """Run a command that reads `content`, and wait until it ends, but not for its background processes.

    Raises OSError where it cannot be started, and SubprocessError where it fails, or takes longer than RECEIVE_S; then
    its whole process group is killed. Only a command `of_user` is named: ours prints the whole error.
    """
    with tempfile.TemporaryFile() as source:  # it would have to read all of a pipe
        source.write(content)
        source.seek(0)
        process = subprocess.Popen(
            command, stdin=source, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
    end = _End(process)
    end.start()
    try:
        process.wait(RECEIVE_S)
    except BaseException as error:
        os.killpg(process.pid, signal.SIGKILL)  # it was not waited for, so the number is still its own
        process.wait()
        if isinstance(error, subprocess.TimeoutExpired):
            raise subprocess.SubprocessError(f"not done within {RECEIVE_S:g} s") from None
        raise
    if process.returncode:
        end.join(_STDERR_S)
        ended = f"{command[0]} ended with {process.returncode}: " if of_user else ""
        raise subprocess.SubprocessError(f"{ended}{end.last_line()}")


class _End(threading.Thread):
    """Reads a program's standard error, however long, and keeps the end of it.

    Background processes of the program may also write there, for as long as this process lives.
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        super().__init__(daemon=True)
        assert process.stderr is not None
        self._stream = process.stderr
        self._kept = b""

    def run(self) -> None:
        while chunk := os.read(self._stream.fileno(), 1 << 16):
            self._kept = (self._kept + chunk)[-STDERR_BYTES_MAX:]

    def last_line(self) -> str:
        """The last line that is not empty."""
        return self._kept.decode(errors="replace").strip().rpartition("\n")[2]
