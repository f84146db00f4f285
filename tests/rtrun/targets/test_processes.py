"""Programs that run detached on a target behind a real sshd."""

import contextlib
import os
import signal
import subprocess
import threading
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest

from conftest import apart, serve, without_groups
from rtrun.plan.program import Exit, Program
from rtrun.targets import deploy, processes
from rtrun.targets.errors import DeadlineExpired, TargetError, TargetGone
from rtrun.targets.link import Link

pytestmark = pytest.mark.sshd


def deploy_scripts(link):
    for name in ("objects", "scripts"):
        Path(link.target.work_dir / name).mkdir(parents=True)
    return deploy.deploy(link, deploy.ON_TARGET, "scripts")


@pytest.fixture
def scripts(link):
    return deploy_scripts(link)


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    return folder


def sh(text, **more):
    return Program(name="p", argv=("sh", "-c", text), **more)


def start_and_wait(link, scripts, folder, program):
    processes.start(link, scripts, PurePosixPath(folder), program)
    return processes.wait(link, PurePosixPath(folder), program.name, deadline_s=60)


def test_status_streams_and_environment(link, scripts, folder):
    program = sh('echo "out $GREETING"; echo err >&2; exit 3', environment=(("GREETING", "it's $me"),))
    assert start_and_wait(link, scripts, folder, program) == Exit(status=3, expired=False)
    assert (folder / "p.stdout").read_text() == "out it's $me\n"
    assert (folder / "p.stderr").read_text() == "err\n"
    assert (folder / "p.boot_id").read_text() == Path("/proc/sys/kernel/random/boot_id").read_text()


def test_setup_file_is_read_first(link, scripts, folder):
    (folder / "setup.sh").write_text("export GREETING=$NOT_SET_ANYWHERE-hello\n")
    processes.start(link, scripts, PurePosixPath(folder), sh("echo $GREETING"), setup=str(folder / "setup.sh"))
    processes.wait(link, PurePosixPath(folder), "p", deadline_s=60)
    assert (folder / "p.stdout").read_text() == "-hello\n"


def test_it_is_in_a_session_of_its_own(link, scripts, folder):
    start_and_wait(link, scripts, folder, sh("ps -o pgid= -o sid= -p $$"))
    group, session = (folder / "p.stdout").read_text().split()
    assert group == session == (folder / "p.pid").read_text().strip()


@pytest.mark.root
def test_what_has_no_room_for_its_files_is_not_started(link, scripts, folder):
    """Nobody could end it."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k,mode=755", "tmpfs", folder], check=True)
    try:
        (folder / "ballast").write_bytes(bytes(2 * 4096))
        with pytest.raises(TargetError, match=r"No space left|is the disk full"):
            processes.start(link, scripts, PurePosixPath(folder), sh("sleep 300"))
        assert not (folder / "p.pid").exists()
        (folder / "ballast").unlink()
        processes.start(link, scripts, PurePosixPath(folder), sh("sleep 300"))
        processes.end(link, PurePosixPath(folder), "p")
        assert processes.list_ended(link, PurePosixPath(folder), ["p"]) == ["p"]
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_starting_again_starts_nothing(link, scripts, folder):
    program = sh(f"echo once >>{folder}/count; sleep 0.3")
    processes.start(link, scripts, PurePosixPath(folder), program)
    processes.start(link, scripts, PurePosixPath(folder), program)
    processes.wait(link, PurePosixPath(folder), "p", deadline_s=60)
    processes.start(link, scripts, PurePosixPath(folder), program)
    assert processes.wait(link, PurePosixPath(folder), "p", deadline_s=60).status == 0
    assert (folder / "count").read_text() == "once\n"


def test_it_survives_a_lost_link_and_is_found_again(link, scripts, folder, remarks):
    processes.start(link, scripts, PurePosixPath(folder), sh("sleep 1.5; exit 5"))
    cut = threading.Timer(0.4, lambda: link._connection.shell.stream.shut_down())
    cut.start()
    assert processes.wait(link, PurePosixPath(folder), "p", deadline_s=60).status == 5
    assert any("connection broke" in remark for remark in remarks)


def test_the_target_ends_what_takes_too_long(link, scripts, folder):
    program = sh(f"echo $$ >{folder}/child; exec sleep 300", deadline_s=5)
    ended = start_and_wait(link, scripts, folder, program)
    assert ended.expired
    assert ended.status == 128 + signal.SIGTERM
    assert not Path(f"/proc/{(folder / 'child').read_text().strip()}").exists()


def test_waiting_has_a_deadline_of_its_own(link, scripts, folder):
    processes.start(link, scripts, PurePosixPath(folder), sh("sleep 300"))
    with pytest.raises(DeadlineExpired):
        processes.wait(link, PurePosixPath(folder), "p", deadline_s=0.5)
    processes.end(link, PurePosixPath(folder), "p")
    assert processes.wait(link, PurePosixPath(folder), "p", deadline_s=20).status is None


def test_a_program_is_waited_for_in_many_short_waits(link, scripts, folder, monkeypatch):
    monkeypatch.setattr(processes, "WAIT_S", 0.2)
    monkeypatch.setattr(processes, "SLICE_S", 0.2)
    assert start_and_wait(link, scripts, folder, sh("sleep 1; exit 6")).status == 6


def test_files_are_followed_while_a_program_is_waited_for(link, scripts, folder, monkeypatch):
    """The program ends when its own last line, and nothing before it, has come."""
    monkeypatch.setattr(processes, "FOLLOW_S", "0.1")
    folder_there, seen = PurePosixPath(folder), []
    (folder / "b.live").write_text("other words")

    def take(file, line):
        seen.append((file, line))
        if ("a.live", "7  8") in seen:
            (folder / "go").touch()

    body = "echo '7  8' >a.live; until [ -e go ]; do sleep 0.05; done; exit 3"
    processes.start(link, scripts, folder_there, sh(f"cd {folder} && {body}"))
    following = processes.Following(files=["a.live", "b.live", "none.live"], take=take)
    ended = processes.wait(link, folder_there, "p", deadline_s=60, needed=[], following=following)
    assert ended == Exit(status=3, expired=False)
    assert {line for file, line in seen if file == "b.live"} == {"other words"}
    assert {file for file, _ in seen} == {"a.live", "b.live"}


def test_without_a_follower_nothing_is_read(link, scripts, folder):
    (folder / "a.live").write_text("failed p\n")
    assert start_and_wait(link, scripts, folder, sh("exit 3")).status == 3


def test_what_never_becomes_true_is_an_error():
    with pytest.raises(TargetError, match="waited 0 s for the moon"):
        processes.wait_until(lambda: False, deadline_s=0, what="the moon")


def test_a_target_that_is_gone_is_not_waited_for(link, scripts, folder, monkeypatch):
    monkeypatch.setattr(processes, "WAIT_S", 0.2)
    monkeypatch.setattr(processes, "SLICE_S", 0.2)
    processes.start(link, scripts, PurePosixPath(folder), sh("sleep 300"))
    target = link.target
    link.target = replace(target, failure=lambda: TargetGone("QEMU ended"))
    with pytest.raises(TargetGone, match="QEMU ended"):
        processes.wait(link, PurePosixPath(folder), "p", deadline_s=60)
    link.target = target
    processes.end(link, PurePosixPath(folder), "p")


def test_the_last_line_of_a_file_is_short(link, folder):
    (folder / "p.stderr").write_text("first\n" + "x" * 10_000 + "\n")
    assert processes.read_last_line(link, PurePosixPath(folder / "p.stderr")) == "x" * 500
    assert processes.read_last_line(link, PurePosixPath(folder / "none")) == ""


def end_background(link, folder, loads=(), others=(), service="17"):
    folder = PurePosixPath(folder)
    return processes.end_background(link, folder, ["suite"], loads, others, service=service, then=[["echo", "x"]])


def test_the_master_that_was_seen_first_counts(link, folder):
    ends = [end_background(link, folder, service=word) for word in ("17", "18")]
    assert [(end.service, end.early, end.output) for end in ends] == [("17", {}, "x\n")] * 2
    # /proc takes no new files, as a full disk does.
    assert end_background(link, "/proc", service="19").service == "19"


def test_end_takes_the_whole_group_even_the_stubborn(link, scripts, folder):
    text = f"trap '' TERM; (trap '' TERM; echo $$ >{folder}/child; sleep 300; sleep 300) & wait; sleep 300"
    processes.start(link, scripts, PurePosixPath(folder), sh(text))
    while not (folder / "child").exists():
        time.sleep(0.02)
    processes.end(link, PurePosixPath(folder), "p")
    group = int((folder / "p.pid").read_text())
    deadline = time.monotonic() + 20
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            break
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_end_waits_for_what_has_just_been_started(link, folder):
    secret = f"RTRUN_PROGRAM={uuid.uuid4()}"
    starting = "exec 9>p.lock; flock 9; : >begun; sleep 0.3; echo $RTRUN >p.known_by; echo $$ >p.pid; exec sleep 300"
    environment = os.environ | {"RTRUN": secret, "RTRUN_PROGRAM": secret.partition("=")[2]}
    process = subprocess.Popen(["setsid", "sh", "-c", starting], cwd=folder, env=environment)
    while not (folder / "begun").exists():
        time.sleep(0.01)
    processes.end(link, PurePosixPath(folder), "p")
    try:
        assert process.wait(60) == -signal.SIGTERM
    finally:
        process.kill()


# What the file may say by which a program is known; {own} is what it said.
WRONG = ("", "\n", "/\n", "/sys/fs/cgroup/unified\n", "RTRUN_PROGRAM=\n", "PATH=/\n", "{own}/..")


@pytest.mark.parametrize("how", [apart, without_groups])
def test_end_kills_nothing_that_a_wrong_file_names(target, tmp_path, how, remarks):
    """As root, it could end everything on the board. A pid file counts for nothing.

    All wrong files at once, a link for each: to give up waits for what a file may still come to name.
    """
    for folder in (folders := [tmp_path / name for name in (*map(str, range(len(WRONG))), "other", "sshd")]):
        folder.mkdir()
    with serve(folders.pop(), how()) as server, contextlib.ExitStack() as stack:
        stack.callback(server.process.kill)
        there = replace(target, address=server.address)
        link, *links = [stack.enter_context(Link(there, remarks.append)) for _ in range(1 + len(WRONG))]
        scripts = deploy_scripts(link)
        for folder in folders:
            processes.start(link, scripts, PurePosixPath(folder), sh("exec sleep 300"))
            while not (folder / "p.stderr").exists():
                time.sleep(0.01)
        *known_by, _ = [(folder / "p.known_by").read_text() for folder in folders]
        assert all(own.startswith("RTRUN_PROGRAM=" if how is without_groups else "/") for own in known_by)
        *folders, other = folders
        for folder, content, own in zip(folders, WRONG, known_by, strict=True):
            (folder / "p.known_by").write_text(content.format(own=own.strip()))
            (folder / "p.pid").write_text((other / "p.pid").read_text())

        def give_up_in_vain(link, folder):
            with pytest.raises(TargetError, match=r"could not be ended: [0-9]+ \(\S+\) of p, .*[0-9]+ \(sleep\) of p"):
                processes.give_up(link, PurePosixPath(folder), ["p"])

        with ThreadPoolExecutor(len(WRONG)) as threads:
            list(threads.map(give_up_in_vain, links, folders))
        for folder in (*folders, other):
            assert processes.list_ended(link, PurePosixPath(folder), ["p"]) == [] and folder.exists()
        assert not remarks
        for folder, own in zip(folders, known_by, strict=True):
            (folder / "p.known_by").write_text(own)
            processes.give_up(link, PurePosixPath(folder), ["p"])
            assert not folder.exists() and not processes.list_ended(link, PurePosixPath(other), ["p"])


def test_killed_supervisor_leaves_no_status(link, scripts, folder):
    processes.start(link, scripts, PurePosixPath(folder), sh("sleep 300"))
    deadline = time.monotonic() + 20
    while not (folder / "p.pid").exists() or not (folder / "p.pid").read_text().strip():
        assert time.monotonic() < deadline
    os.killpg(int((folder / "p.pid").read_text()), signal.SIGKILL)
    assert processes.wait(link, PurePosixPath(folder), "p", deadline_s=20) == Exit(status=None, expired=False)


def test_a_folder_that_is_not_there(link, scripts, tmp_path):
    with pytest.raises(TargetError, match=r"failed with exit status \d+: .*can't cd to .*gone"):
        processes.start(link, scripts, PurePosixPath(tmp_path / "gone"), sh("true"))


def test_what_was_given_up_is_not_started_any_more(link, scripts, folder, monkeypatch):
    """A start under way goes on when its connection is closed: its second program must not be left running."""
    stubborn = Program(name="stubborn", argv=("sh", "-c", f"trap '' TERM; echo $$ >{folder}.first; sleep 60; sleep 60"))
    late = Program(name="late", argv=("sh", "-c", f"echo $$ >{folder}.second; sleep 60"))
    with monkeypatch.context() as patch:
        real = processes.join_commands
        patch.setattr(
            processes, "join_commands", lambda commands: real([*commands[:1], ["sleep", "0.5"], *commands[1:]])
        )
        starting = threading.Thread(target=processes.start, args=(link, scripts, PurePosixPath(folder), stubborn, late))
        starting.start()
        while not Path(f"{folder}.first").exists():
            time.sleep(0.02)
    processes.give_up(link, PurePosixPath(folder), ["stubborn", "late"])
    starting.join()
    assert not folder.exists()
    time.sleep(0.5)
    assert not Path(f"{folder}.second").exists()


def test_the_clock_on_the_wall_does_not_tell_who_died(link, folder):
    for name, uptime in (("sampler", "100.07"), ("suite", "100.08"), ("other", "100.08"), ("load", "100.10")):
        (folder / f"{name}.exit").write_text(f"0 {uptime}\n")
        os.utime(folder / f"{name}.exit", (1e9, 1e9 - float(uptime)))

    def ended_early():
        return end_background(link, folder, ["load", "other"], ["sampler"]).early

    assert ended_early() == {"sampler": "0"}
    (folder / "load.exit").write_text("0 1.00\n")
    assert ended_early() == {"sampler": "0"}, "the first answer counts: by now the runner has ended them itself"


@pytest.mark.parametrize("word", ["²", "9" * 6000, "-1", "256", "0x0", ""])
def test_an_exit_status_that_is_none(link, scripts, folder, word):
    """The file lies on the target, where anybody may have written it."""
    (folder / "p.exit").write_text(f"{word} 12.34\n")
    assert processes.wait(link, PurePosixPath(folder), "p", deadline_s=60).status is None
