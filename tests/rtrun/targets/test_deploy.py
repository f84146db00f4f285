"""Deploying by content to a target behind a real sshd."""

import os
from pathlib import Path, PurePosixPath

import pytest

from rtfiles.errors import UsageError
from rtrun.plan.program import Program
from rtrun.targets import deploy, processes
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError

pytestmark = pytest.mark.sshd


@pytest.fixture
def tree(tmp_path, target):
    Path(target.work_dir / "objects").mkdir(parents=True)
    folder = tmp_path / "tree"
    (folder / "lib" / "deep").mkdir(parents=True)
    (folder / "lib" / "deep" / "program").write_text("#!/bin/sh\necho hello\n")
    (folder / "data").write_bytes(b"\0" * 100_000)
    return folder


@pytest.fixture
def uploads(monkeypatch):
    sent = []
    real = Connection.upload

    def counting(self, source, destination, then):
        sent.append(source.name)
        real(self, source, destination, then)

    monkeypatch.setattr(Connection, "upload", counting)
    return sent


def test_the_tree_stands_there_and_runs(link, tree):
    there = Path(deploy.deploy(link, tree, "suites"))
    assert (there / "data").read_bytes() == (tree / "data").read_bytes()
    assert link.check([str(there / "lib/deep/program")]) == "hello\n"


def test_what_is_there_is_not_sent_again(link, tree, uploads):
    first = deploy.deploy(link, tree, "suites")
    assert sorted(uploads) == ["data", "program"]
    uploads.clear()
    files = sorted(Path(first).rglob("*"))
    assert deploy.deploy(link, tree, "suites") == first
    assert uploads == [] and sorted(Path(first).rglob("*")) == files
    (tree / "lib/deep/program").write_text("#!/bin/sh\necho changed\n")
    second = deploy.deploy(link, tree, "suites")
    assert uploads == ["program"] and second != first
    assert (Path(second) / "data").samefile(Path(first) / "data")


def test_a_tree_of_which_half_the_listing_arrived_is_never_adopted(link, tree, target, monkeypatch):
    real = Connection.check

    def truncating(self, argv, **more):
        if more.get("stdin"):
            more["stdin"] = more["stdin"].splitlines(keepends=True)[0]
        return real(self, argv, **more)

    with monkeypatch.context() as patch:
        patch.setattr(Connection, "check", truncating)
        with pytest.raises(TargetError):
            deploy.deploy(link, tree, "suites")
    there = Path(deploy.deploy(link, tree, "suites"))
    assert (there / "data").exists() and (there / "lib/deep/program").exists()


def test_a_half_sent_object_is_never_adopted(link, tree, target, tmp_path, monkeypatch):
    real = Connection.upload

    def truncating(self, source, destination, then):
        half = tmp_path / "half"
        half.write_bytes(source.read_bytes()[:-1])
        real(self, half, destination, then)

    with monkeypatch.context() as patch:
        patch.setattr(Connection, "upload", truncating)
        with pytest.raises(TargetError, match=r"cannot write .*did NOT match"):
            deploy.deploy(link, tree, "suites")
    assert list(Path(target.work_dir / "objects").iterdir()) == []
    assert (Path(deploy.deploy(link, tree, "suites")) / "data").exists()


def test_a_tree_that_was_damaged_since_is_made_anew(link, tree, uploads):
    """A file of the tree is its object: there is one copy of it."""
    there = Path(deploy.deploy(link, tree, "suites"))
    with (there / "data").open("r+b") as stream:
        stream.write(b"\1")
    (there / "lib/deep/program").unlink()
    uploads.clear()
    assert Path(deploy.deploy(link, tree, "suites")) == there and uploads == ["data"]
    assert (there / "data").read_bytes() == (tree / "data").read_bytes()
    assert link.check([str(there / "lib/deep/program")]) == "hello\n"


def test_trees_that_nobody_uses_are_removed_and_their_objects_a_day_later(link, tree, target):
    there = []
    for number in range(5):
        (tree / "data").write_text(str(number))
        there.append(Path(deploy.deploy(link, tree, "suites")))
        os.utime(there[-1], (number, number))
    # To use a tree again makes it the newest.
    (tree / "data").write_text("0")
    deploy.deploy(link, tree, "suites")
    running = target.work_dir / "runs/uid/run"
    Path(running).mkdir(parents=True)
    processes.start(
        link, PurePosixPath(deploy.ON_TARGET), running, Program(name="x", argv=("sleep", "300"), deadline_s=300)
    )
    deploy.prune(link, 1)
    assert all(path.is_dir() for path in there), "a run is going on, of whichever of them"
    processes.end(link, running, "x")
    deploy.prune(link, 1)
    assert [path.is_dir() for path in there] == [True, False, False, True, True]
    objects = Path(target.work_dir / "objects")
    assert len(list(objects.iterdir())) == 6
    for path in objects.iterdir():
        os.utime(path, (0, 0))
    deploy.prune(link, 1)
    assert len(list(objects.iterdir())) == 4
    assert all((path / "data").read_text() and (path / "lib/deep/program").exists() for path in there if path.is_dir())


def test_a_tree_that_another_runner_has_made_meanwhile_stays(link, tree, monkeypatch):
    """It may be in use: its files are not put there anew, and at no time are they away."""
    send, trees = deploy._send, []

    def send_late(*args):
        send(*args)
        monkeypatch.setattr(deploy, "_send", send)
        path = Path(deploy.deploy(link, tree, "suites"))
        trees.append((path, path.stat().st_ino, sorted(path.parent.iterdir())))

    monkeypatch.setattr(deploy, "_send", send_late)
    path = Path(deploy.deploy(link, tree, "suites"))
    assert trees == [(path, path.stat().st_ino, sorted(path.parent.iterdir()))]


def test_an_empty_folder_is_an_error(link, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="the folder is empty"):
        deploy.deploy(link, tmp_path / "empty", "suites")
