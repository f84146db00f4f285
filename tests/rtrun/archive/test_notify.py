"""Somebody hears, once, of what got worse and of boards in quarantine: a real command, HTTP server and mail server."""

import contextlib
import http.server
import json
import threading
from dataclasses import dataclass, field
from email import message_from_bytes, policy
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import yaml
from aiosmtpd.controller import Controller
from archive.archived import write_build, write_course

from ports import free_port
from rtrun.archive import alarms as alarms_module
from rtrun.archive.alarms import board_alarms
from rtrun.archive.fleet import Farm, boards_of
from rtrun.archive.notes import Notes
from rtrun.archive.receivers import CommandReceiver, HookReceiver, MailReceiver, as_text, tell
from rtrun.cli import main
from rtrun.targets.labgrid.coordinator import LabgridPlace

SITE = "https://lab.example.org/history"
FACTS = [{"commit": "c0", "kernel": "6.1" if day < 8 else "6.6"} for day in range(30)]
WORSE = [100.0] * 8 + [120.0] * 8


@dataclass
class Received:
    """What arrived, and whether it is refused."""

    posts: list[tuple[str, Any]] = field(default_factory=list)
    mails: list[Any] = field(default_factory=list)
    status: int = 200
    refuses_mail: bool = False

    async def handle_DATA(self, _server, _session, envelope):
        if self.refuses_mail:
            return "451 try again later"
        mail = message_from_bytes(envelope.content, policy=policy.default)
        self.mails.append((envelope.mail_from, envelope.rcpt_tos, mail))
        return "250 OK"


@pytest.fixture
def lab(tmp_path):
    """Receivers of each kind, in a file, and an archive in which one of two scenarios got worse."""
    received = Received()

    class Hook(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            received.posts.append((self.headers["Content-Type"], json.loads(body)))
            self.send_response(received.status)
            self.send_header("Location", "/elsewhere")
            self.end_headers()

        def do_GET(self):
            raise AssertionError("a POST became a GET")

        def log_message(self, *_):
            pass

    with contextlib.ExitStack() as stack:
        hook = stack.enter_context(http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hook))
        threading.Thread(target=hook.serve_forever, daemon=True).start()
        stack.callback(hook.shutdown)
        mail = Controller(received, hostname="127.0.0.1", port=free_port())
        mail.start()
        stack.callback(mail.stop)
        received.commands = tmp_path / "read"
        received.url = f"http://127.0.0.1:{hook.server_port}/hook"
        received.server = f"127.0.0.1:{mail.port}"
        receivers = [
            {"name": "log", "kind": "command", "command": ["sh", "-c", 'cat >>"$0"', str(received.commands)]},
            {"name": "chat", "kind": "hook", "url": received.url},
            {
                "name": "on call", "kind": "mail", "server": received.server,
                "from": "rtrun@lab.example.org", "to": ["a@example.org", "b@example.org"],
            },
        ]  # fmt: skip
        config = {"schema": 1, "site": f"{SITE}/", "receivers": receivers}
        (tmp_path / "lab.yml").write_text(yaml.safe_dump(config))
        with mock.patch("os.fsync"):
            write_course(tmp_path / "archive", [100.0] * 16, machine="steady", seed=2)
            write_course(tmp_path / "archive", WORSE, facts=FACTS)
        received.words = ["notify", str(tmp_path / "lab.yml"), str(tmp_path / "archive")]
        received.archive = tmp_path / "archive"
        yield received


def notify(capsys, lab, *words, status=0):
    assert main([*lab.words, *map(str, words)]) == status
    printed = capsys.readouterr()
    return printed.out + printed.err


def annotate(lab, *words):
    assert main(["archive", "annotate", str(lab.archive), *words, "--reason", "ticket 7", "--who", "E. Noether"]) == 0


def test_each_receiver_is_told_once_with_what_it_needs_to_know(capsys, lab):
    notify(capsys, lab)
    ((content_type, posted),) = lab.posts
    (alarm,) = posted["alarms"]
    assert content_type == "application/json" and posted["schema"] == 1
    assert alarm["about"] == "oneshot_timer RR 1000 us on board" and alarm["kind"] == "worse"
    assert "p50 1" in alarm["size"] and "p99 1" in alarm["size"] and "CI of the shift +" in alarm["size"]
    assert alarm["suspected"].startswith("kernel: 6.1 -> 6.6") and "between 2026-01-08" in alarm["since"]
    assert alarm["link"].startswith(f"{SITE}/") and alarm["link"].endswith(".html")
    assert main(["site", str(lab.archive), "--output", str(lab.archive.parent / "site")]) == 0
    assert (lab.archive.parent / "site" / alarm["link"].rpartition("/")[2]).is_file(), "the link leads to its page"
    ((sender, to, mail),) = lab.mails
    assert (sender, to) == ("rtrun@lab.example.org", ["a@example.org", "b@example.org"])
    assert mail["Subject"] == "rtrun: 1 scenario got worse"
    for text in (posted["text"], mail.get_content(), lab.commands.read_text()):
        assert "WORSE  oneshot_timer RR 1000 us on board" in text and "suspected: kernel: 6.1 -> 6.6" in text
        assert alarm["link"] in text and "steady" not in text
    printed = notify(capsys, lab)
    assert "\n1 thing wrong\n" in printed and "was told" not in printed and len(lab.posts) == len(lab.mails) == 1
    # A day more of the same is nothing new; a further step is.
    write_course(lab.archive, [*WORSE, 120.0], facts=FACTS)
    notify(capsys, lab)
    assert len(lab.posts) == 1
    write_course(lab.archive, [*WORSE, 120.0, *[150.0] * 8], facts=FACTS)
    notify(capsys, lab)
    assert len(lab.posts) == len(lab.mails) == 2 and lab.commands.read_text().count("WORSE") == 2


def test_who_could_not_be_told_is_told_the_next_time_and_the_others_are_not(capsys, lab):
    lab.status, lab.refuses_mail = 302, True
    printed = notify(capsys, lab, status=3)
    assert "chat: not told: HTTP Error 302" in printed and "on call: not told: " in printed and "451" in printed
    assert lab.commands.read_text().count("WORSE") == 1
    lab.status, lab.refuses_mail = 204, False
    notify(capsys, lab)
    notify(capsys, lab)
    assert (len(lab.posts), len(lab.mails), lab.commands.read_text().count("WORSE")) == (2, 1, 1)


def test_what_is_known_calls_nobody_until_it_gets_worse_again(capsys, lab):
    annotate(lab, "--known", "--machine", "bo*", "--scenario", "oneshot*")
    printed = notify(capsys, lab)
    assert "known: oneshot_timer RR 1000 us on board: ticket 7 (E. Noether, " in printed and not lab.posts
    assert main(["trends", str(lab.archive)]) == 0
    printed = capsys.readouterr().out
    assert "WORSE  oneshot_timer" in printed and "known: ticket 7" in printed
    assert main(["site", str(lab.archive), "--output", str(lab.archive.parent / "site")]) == 0
    page = (lab.archive.parent / "site" / "index.html").read_text()
    assert "1 got worse, which is known" in page and "✗&nbsp;WORSE, known: p50, p99" in page
    # What began after the note: the note is put back to the time between two steps.
    (path,) = (lab.archive / "notes").iterdir()
    path.write_text(json.dumps({**json.loads(path.read_text()), "at": "2026-01-12T00:00:00"}))
    write_course(lab.archive, [*WORSE, *[150.0] * 14], facts=FACTS)
    printed = notify(capsys, lab)
    assert len(lab.posts) == 1 and "known: " not in printed, printed


def test_a_build_that_is_worse_than_its_history(capsys, lab, tmp_path):
    build = write_build(tmp_path / "build", 140.0, 140.0)
    notify(capsys, lab, "--results", build)
    notify(capsys, lab, "--results", build)
    ((_, posted),) = lab.posts
    (alarm,) = posted["alarms"]
    assert alarm["kind"] == "worse build" and alarm["about"].endswith(" on board") and "limit" in alarm["size"]
    assert alarm["suspected"].startswith("commit: c0 -> not known")
    assert main(["gate", str(build), "--against", str(lab.archive)]) == 1
    assert "changed since its last boot: commit: c0 -> not known" in capsys.readouterr().out
    annotate(lab, "--known", "--machine", "board")
    printed = notify(capsys, lab, "--results", write_build(tmp_path / "next", 140.0, 140.0, seed=98))
    assert len(lab.posts) == 1 and "known: " in printed


def test_a_quarantine_is_told_once_and_the_next_one_again(capsys, lab, monkeypatch):
    """The coordinator's answer is made up here; tests/rtrun/targets/labgrid asks a real one."""
    tags = {"quarantine": "2026-11-24_10.0.0.7_22_connection_refused"}
    place = LabgridPlace(name="panda-2", tags=tags, matches=(), holder=None, reservation=None)

    def quarantine_of(place):
        alarms = board_alarms(boards_of([], Farm(places=[place], offered=[])), Notes(held={}))
        (alarm,) = (alarm for alarm in alarms if alarm.kind == "quarantine")
        return alarm

    alarm = quarantine_of(place)
    assert alarm.size == "10.0.0.7 22 connection refused (since 2026-11-24)"
    again = LabgridPlace(name="panda-2", tags={"quarantine": "2026-12-01_x"}, matches=(), holder=None, reservation=None)
    assert quarantine_of(again).key != alarm.key
    places = [place]
    monkeypatch.setattr("rtrun.archive.fleet.list_places", lambda coordinator: places)
    monkeypatch.setattr("rtrun.archive.fleet.list_resources", lambda coordinator: [])
    path = Path(lab.words[1])
    path.write_text(f"{path.read_text()}coordinator: 127.0.0.1:1\n")
    annotate(lab, "--known", "--machine", "board")
    for expected in (1, 1):
        notify(capsys, lab)
        assert len(lab.posts) == expected
    assert lab.posts[0][1]["alarms"][0]["link"] == f"{SITE}/boards.html"
    places[:] = [again]
    notify(capsys, lab)
    assert len(lab.posts) == 2
    annotate(lab, "--known", "--machine", "panda-*")
    places[:] = [LabgridPlace(name="panda-3", tags=tags, matches=(), holder=None, reservation=None)]
    assert "known: panda-3: ticket 7" in notify(capsys, lab) and len(lab.posts) == 2
    later = {"quarantine": "2999-01-01_x"}
    places[:] = [LabgridPlace(name="panda-3", tags=later, matches=(), holder=None, reservation=None)]
    notify(capsys, lab)
    assert [alarm["kind"] for alarm in lab.posts[2][1]["alarms"]] == ["quarantine"]


def test_names_that_are_hostile_are_text_and_nothing_else(lab, tmp_path):
    evil = "a\r\nBcc: c@example.org\r\n\r\n$(touch pwned) `touch pwned`; touch pwned\x1b[2J\ud800 --x"
    alarms = [
        alarms_module.Alarm(kind="worse", about=evil, size=evil, since=evil, suspected=evil, page=None, key="0" * 64)
        for _ in range(60)
    ]
    with contextlib.chdir(tmp_path):
        echo = ["sh", "-c", 'cat >text; echo "$#" >count']
        tell(CommandReceiver(name="x", kind="command", command=echo), alarms, None)
        tell(HookReceiver(name="x", kind="hook", url=lab.url), alarms, None)
        mail = {"name": "x", "kind": "mail", "server": lab.server, "from": "a@example.org", "to": ["b@example.org"]}
        tell(MailReceiver.model_validate(mail), alarms, None)
        assert (tmp_path / "count").read_text() == "0\n" and not (tmp_path / "pwned").exists()
    ((_, to, mail),) = lab.mails
    assert to == ["b@example.org"] and mail["Bcc"] is None and mail["Subject"] == "rtrun: 60 scenarios got worse"
    assert "\x1b" not in (tmp_path / "text").read_text() and "and 10 more" in as_text(alarms, None, most=50)
    # Whoever is notified gets all of it.
    assert len(lab.posts[0][1]["alarms"]) == (tmp_path / "text").read_text().count("\nWORSE  ") == 60
    assert mail.get_content().count("\nWORSE  ") == 60 and lab.posts[0][1]["text"].count("\nWORSE  ") == 50


@pytest.mark.parametrize(
    ("receiver", "message"),
    [
        ({"kind": "hook", "url": "file:///etc/passwd"}, "begins with https:// or http://"),
        ({"kind": "mail", "server": "localhost", "from": "a@b", "to": ["a@b"]}, "HOST:PORT"),
        ({"kind": "mail", "server": "l:25", "from": "a@b\nBcc: c@d", "to": ["a@b"]}, "an address, as a@b.org"),
        ({"kind": "mail", "server": "l:25", "from": "a@b", "to": ["a@b, c@d"]}, "an address, as a@b.org"),
        ({"kind": "command", "command": "echo"}, "command"),
        ({"kind": "pager"}, "kind"),
    ],
)
def test_receivers_that_are_none(capsys, tmp_path, receiver, message):
    (tmp_path / "lab.yml").write_text(yaml.safe_dump({"schema": 1, "receivers": [{"name": "x", **receiver}]}))
    assert main(["notify", str(tmp_path / "lab.yml"), "archive"]) == 2
    assert message in capsys.readouterr().err


def test_a_file_that_is_no_message_is_named(capsys, lab):
    (lab.archive / "told").mkdir()
    (lab.archive / "told" / "n.json").write_text('{"schema": 1}')
    assert "told/n.json: at: Field required" in notify(capsys, lab, status=2)
