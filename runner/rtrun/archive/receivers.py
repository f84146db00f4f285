"""Who is told of alarms, and how: a command, a web hook, a mail.

Names of boards and scenarios may be anybody's. So no text of an alarm is part of a command line, of an address or of a
header: a command has it as standard input, a hook as JSON, a mail as its body.
"""

import contextlib
import smtplib
import subprocess
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Sequence
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from typing import Annotated, Any, Literal

from pydantic import Field

from rtfiles.config import Config, matching
from rtfiles.errors import InfrastructureError
from rtfiles.output import counted, printable
from rtrun.archive.alarms import Alarm

RECEIVE_S = 60.0
SHOWN_MAX = 50
"""Alarms that a text spells out."""
_TITLES = {
    "worse": ("scenario", "got worse"),
    "worse build": ("case", "of a build worse than its history"),
    "quarantine": ("board", "in quarantine"),
}
_Name = Annotated[str, matching(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}", "a name of letters, digits and . _ - and spaces")]
_Address = Annotated[str, matching(r"[^\s<>,;:\"()\[\]@]{1,64}@[^\s<>,;:\"()\[\]@]{1,255}", "an address, as a@b.org")]
_Word = Annotated[str, Field(min_length=1)]


class CommandReceiver(Config):
    """A command line, not of a shell, that reads the text."""

    name: _Name
    kind: Literal["command"]
    command: Annotated[list[_Word], Field(min_length=1)]


class HookReceiver(Config):
    """An address that takes a POST of JSON."""

    name: _Name
    kind: Literal["hook"]
    url: Annotated[str, matching(r"https?://[!-~]+", "an address that begins with https:// or http://")]


class MailReceiver(Config):
    """A mail server that takes mail without a login, and for whom."""

    name: _Name
    kind: Literal["mail"]
    server: Annotated[str, matching(r"[A-Za-z0-9.:\[\]-]+:[0-9]{1,5}", "HOST:PORT")]
    sender: _Address = Field(alias="from")
    to: Annotated[list[_Address], Field(min_length=1, max_length=100)]


AnyReceiver = Annotated[CommandReceiver | HookReceiver | MailReceiver, Field(discriminator="kind")]


class Receivers(Config):
    """A file of who is told what.

    `site` is where the pages of `rtrun site` are served, for links. `coordinator` is that of a labgrid farm, whose
    boards in quarantine are told, too.
    """

    schema_number: Literal[1] = Field(alias="schema")
    site: Annotated[str, matching(r"https?://[!-~]+", "an address that begins with https:// or http://")] | None = None
    coordinator: _Word | None = None
    receivers: Annotated[list[AnyReceiver], Field(min_length=1, max_length=100)]


def tell(receiver: CommandReceiver | HookReceiver | MailReceiver, alarms: Sequence[Alarm], site: str | None) -> None:
    """Tell a receiver of alarms, of which there is one at least. Raises InfrastructureError where it does not take
    them."""
    try:
        match receiver:
            case CommandReceiver():
                _call(receiver, as_text(alarms, site, most=len(alarms)))
            case HookReceiver():
                _post(receiver, as_data(alarms, site))
            case MailReceiver():
                _send(receiver, title(alarms), as_text(alarms, site, most=len(alarms)))
    except (OSError, urllib.error.URLError, smtplib.SMTPException, subprocess.SubprocessError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InfrastructureError(f"{receiver.name}: not told: {printable(str(reason))[:300]}") from error


def title(alarms: Sequence[Alarm]) -> str:
    """How many there are, without a name."""
    counts = Counter(str(alarm.kind) for alarm in alarms)
    parts = [f"{counted(counts[kind], noun)} {rest}" for kind, (noun, rest) in _TITLES.items() if counts[kind]]
    return f"rtrun: {', '.join(parts)}"


def as_text(alarms: Sequence[Alarm], site: str | None, *, most: int) -> str:
    """The alarms for people, some lines each, of so many at most."""
    lines = [title(alarms).removeprefix("rtrun: "), ""]
    for alarm in alarms[:most]:
        shown = _shown(alarm, site)
        word = "QUARANTINE" if alarm.kind == "quarantine" else "WORSE"
        lines += [f"{word}  {shown['about']}", f"  {shown['size']}", f"  since: {shown['since']}"]
        lines += [f"  suspected: {shown['suspected']}", *([f"  {shown['link']}"] if shown["link"] else []), ""]
    if (more := len(alarms) - most) > 0:
        lines.append(f"and {more} more")
    return "\n".join(lines).rstrip() + "\n"


def as_data(alarms: Sequence[Alarm], site: str | None) -> dict[str, Any]:
    """The alarms as plain data; `text` is what hooks of chats show: of many the first ones."""
    return {
        "schema": 1,
        "text": as_text(alarms, site, most=SHOWN_MAX),
        "alarms": [_shown(alarm, site) for alarm in alarms],
    }


def _shown(alarm: Alarm, site: str | None) -> dict[str, str | None]:
    """What of an alarm is told, each text one line that can be encoded."""
    texts = {name: printable(getattr(alarm, name)) for name in ("kind", "about", "size", "since", "suspected")}
    return {**texts, "link": f"{site.rstrip('/')}/{alarm.page}" if site and alarm.page else None}


def _call(receiver: CommandReceiver, text: str) -> None:
    done = subprocess.run(
        receiver.command,
        input=text.encode(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        timeout=RECEIVE_S,
        check=False,
    )
    if done.returncode:
        last_line = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise subprocess.SubprocessError(f"{receiver.command[0]} ended with {done.returncode}: {last_line}")


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A POST that is led elsewhere would become a GET."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _post(receiver: HookReceiver, data: dict[str, Any]) -> None:
    import json

    body = json.dumps(data).encode()
    request = urllib.request.Request(receiver.url, body, {"Content-Type": "application/json"}, method="POST")
    with contextlib.closing(urllib.request.build_opener(_NoRedirect).open(request, timeout=RECEIVE_S)):
        return


def _send(receiver: MailReceiver, subject: str, text: str) -> None:
    mail = EmailMessage()
    mail["Subject"], mail["From"], mail["To"] = subject, receiver.sender, ", ".join(receiver.to)
    mail["Date"], mail["Message-ID"] = formatdate(), make_msgid(domain="rtrun")
    mail.set_content(text)
    host, _, port = receiver.server.rpartition(":")
    with smtplib.SMTP(host.strip("[]"), int(port), timeout=RECEIVE_S) as server:
        server.send_message(mail)
