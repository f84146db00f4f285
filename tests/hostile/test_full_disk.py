"""A place that the user names cannot take a file: each command that writes one says so, and never that it has."""

import argparse
import contextlib
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from archive.archived import write_course
from report.campaigns import latencies, oneshot_run
from traced import specimen, write_traced_run

from rtfiles import atomic
from rtfiles.command import parser_of
from rtfiles.errors import UsageError
from rtfiles.start import commands_of
from rtrun.cli import COMMANDS, GROUPS, main
from rtrun.targets.inspection import facts
from rtrun.targets.ssh.host_keys import _key_blob, fingerprint

FULL = "/dev/full"
FULL_SAID = f"rtrun: {FULL}: cannot be written: No space left on device"


@pytest.fixture
def results(tmp_path):
    oneshot_run(tmp_path / "results", "001-oneshot", latencies(300, 1))
    return tmp_path / "results"


def report(results):
    return ["report", str(results), "--format", "json", "--output", FULL]


def gate(results):
    return ["gate", str(results), "--junit", FULL, "--deadline", "1s", "--probability", "0.5"]


def why(results):
    folder = write_traced_run(results.parent / "traced", {1558: specimen(1558)}, [23166, 23175])
    return ["why", str(folder), "--perfetto", FULL]


@pytest.mark.parametrize("call", [report, gate, why])
def test_a_full_disk_is_an_error(capsys, results, call):
    assert main(call(results)) == 2
    printed = capsys.readouterr()
    assert FULL_SAID in printed.err and "written for" not in printed.out and f"{FULL}\n" not in printed.out


def test_why_without_a_trace_writes_no_empty_file(capsys, results, tmp_path):
    """/dev/full takes nothing, too: it is no sign of success."""
    for place in (FULL, str(tmp_path / "none.pftrace")):
        assert main(["why", str(results), "--perfetto", place]) == 2
        printed = capsys.readouterr()
        assert (
            f"{place}: not written: no value of {results} has a trace" in printed.err
            and "written for" not in printed.out
        )
    assert not (tmp_path / "none.pftrace").exists()


def test_observe_refuses_before_it_observes(capsys, tmp_path):
    target = tmp_path / "target.yml"
    target.write_text("schema: 1\nname: here\nkind: local\n")
    words = ["observe", "--target", str(target), "--results", str(tmp_path / "results"), "--for", "1s"]
    assert main([*words, "--perfetto", FULL]) == 2
    assert FULL_SAID in capsys.readouterr().err


@pytest.mark.sshd
def test_what_a_target_says_cannot_be_kept(capsys, sshd, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    kind, encoded = sshd.host_key.split()
    key = fingerprint(_key_blob(kind.encode(), encoded.encode()))
    login = ["--host", "127.0.0.1", "--port", str(sshd.port), "--user", sshd.user, "--key", str(sshd.key)]
    assert main(["new-target", *login, "--host-key", key, "--name", "x", "--output", FULL]) == 2
    assert f"{FULL}: " in capsys.readouterr().err
    keep = ["check-rt", "--target", "x.yml", "--save-config", FULL]
    with contextlib.chdir(tmp_path):
        assert main(["new-target", *login, "--host-key", key, "--name", "x"]) == 0
        monkeypatch.setattr(facts, "read_kernel_config", lambda link: b"some kernels keep none")
        assert main(keep) == 2
    assert FULL_SAID in capsys.readouterr().err


def test_the_pages_of_a_site_on_a_full_disk(tmp_path):
    """No file may grow beyond a kilobyte, as where that much is left; the message names the page."""
    archive = write_course(tmp_path / "archive", [100.0] * 2)
    done = subprocess.run(
        [sys.executable, "-m", "rtrun.cli", "site", str(archive), "--output", str(tmp_path / "pages")],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3 and done.stdout == ""
    assert done.stderr.splitlines()[-1] == f"rtrun: {tmp_path}/pages/index.html: File too large"
    assert [*(tmp_path / "pages").iterdir()] == []


def written_by(parser):
    """The options of a command that name a file or folder to write, sub-commands included."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, subparser in action.choices.items():
                yield from ((name, *rest) for rest in written_by(subparser))
        elif action.type is Path and any(word in (action.help or "") for word in ("write", "keep", "made", "pages")):
            yield (action.option_strings[0] if action.option_strings else action.dest,)


def test_no_place_is_left_out():
    parser = parser_of("rtrun", "x", commands_of("rtrun", COMMANDS), GROUPS)
    assert {*written_by(parser)} == {
        ("report", "--output"),
        ("gate", "--junit"),
        ("why", "--perfetto"),
        ("observe", "--perfetto"),
        ("new-target", "--output"),
        ("check-rt", "--save-config"),
        ("site", "--output"),
    }


@pytest.mark.parametrize("place", [FULL, "/nowhere/file", "a\0b", "/dev", "x" * 300])
def test_write_named_names_the_place(place):
    with pytest.raises(UsageError, match="cannot be written: ") as refused:
        atomic.write_named(Path(place), b"x")
    assert str(refused.value).startswith(place)


def test_nothing_is_no_file(tmp_path):
    with pytest.raises(UsageError, match="there is nothing to write"):
        atomic.write_named(tmp_path / "x", b"")
    assert not (tmp_path / "x").exists()
