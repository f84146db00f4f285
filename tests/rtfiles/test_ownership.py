"""Folders that others can change: the runner's own ones, and those that its scripts work in on a target."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from rtfiles import cache, ownership
from rtfiles.errors import UsageError
from rtrun.results import run_directory
from rtrun.targets.inspection import work_folder

pytestmark = pytest.mark.root("gives folders to other users")

OTHER = 12345


def by_the_runner(path: Path) -> str:
    try:
        ownership.make_folder(path)
    except UsageError as error:
        return str(error)
    return ""


def by_script(*shell: str) -> Callable[[Path], str]:
    def asked(path: Path) -> str:
        argv = [*shell, "-s", str(path)]
        done = subprocess.run(argv, input=work_folder.SCRIPT.read_text(), capture_output=True, text=True, check=True)
        assert done.stderr == ""
        return done.stdout

    return asked


BOTH = pytest.mark.parametrize(
    "asked",
    [by_the_runner, by_script("dash"), by_script("busybox", "sh"), by_script("bash", "--posix")],
    ids=["runner", "dash", "busybox", "bash"],
)


def given(path: Path, owner: int = 0, mode: int = 0o755, group: int | None = None) -> Path:
    path.mkdir(exist_ok=True)
    os.chown(path, owner, owner if group is None else group)
    path.chmod(mode)
    return path


# What is wrong with a folder, anywhere on the way, and the message about it.
FAULTS = {
    "another user's": ({"owner": OTHER}, "12345"),
    "another user's, who lets nobody else write": ({"owner": OTHER, "mode": 0o700}, "12345"),
    "everybody writes": ({"mode": 0o777}, "can be written by every user"),
    "a group writes": ({"mode": 0o775, "group": OTHER}, "can be written by the group"),
    "another user's, sticky": ({"owner": OTHER, "mode": 0o1777}, "12345"),
}


@BOTH
@pytest.mark.parametrize("at", ["a", "a/b", "a/b/c"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_folder_that_others_can_change_is_refused_wherever_it_lies(
    asked: Callable[[Path], str], at: str, fault: str, tmp_path: Path
) -> None:
    for name in ("a", "a/b", "a/b/c"):
        given(tmp_path / name)
    arguments, reason = FAULTS[fault]
    given(tmp_path / at, **arguments)
    answer = asked(tmp_path / "a/b/c").replace("by group", "by the group")
    assert f"{tmp_path / at} " in answer and reason in answer
    # Where the last one is missing, nothing is made below.
    if at != "a/b/c":
        (tmp_path / "a/b/c").rmdir()
        assert f"{tmp_path / at} " in asked(tmp_path / "a/b/c")
        assert not (tmp_path / "a/b/c").exists()
    else:
        assert list((tmp_path / at).iterdir()) == []


@BOTH
@pytest.mark.parametrize(
    "arguments",
    [{}, {"mode": 0o700}, {"mode": 0o1777}],
    ids=["as a home folder", "closed", "as /tmp"],
)
def test_ordinary_folders_are_taken(asked: Callable[[Path], str], arguments: dict[str, int], tmp_path: Path) -> None:
    given(tmp_path / "a", **arguments)
    os.umask(0)
    try:
        for _ in ("made", "there"):
            assert asked(tmp_path / "a/b/c") == ""
    finally:
        os.umask(0o022)
    paths = [tmp_path / "a/b", *(tmp_path / "a/b").rglob("*")]
    assert all(path.stat().st_mode & 0o022 == 0 for path in paths), "whatever the umask"


@BOTH
def test_a_folder_that_the_own_group_can_write_to(
    asked: Callable[[Path], str], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The ls of busybox does not show whether a list of rights lets others do so."""
    reason = asked(given(tmp_path / "a", mode=0o775, group=0) / "b")
    expected = "can be written by group 0" if "busybox" in request.node.name else ""
    assert expected in reason and bool(reason) == bool(expected)


@BOTH
def test_the_folder_itself_must_not_be_one_where_everybody_adds_names(
    asked: Callable[[Path], str], tmp_path: Path
) -> None:
    assert "can be written by every user" in asked(given(tmp_path / "a", mode=0o1777))
    assert list((tmp_path / "a").iterdir()) == []


@BOTH
def test_what_another_user_makes_in_a_sticky_folder_is_not_taken(asked: Callable[[Path], str], tmp_path: Path) -> None:
    given(tmp_path / "a", mode=0o1777)
    given(tmp_path / "a/b", owner=OTHER)
    assert f"{tmp_path}/a/b belongs to" in asked(tmp_path / "a/b")
    assert f"{tmp_path}/a/b belongs to" in asked(tmp_path / "a/b/c")


@BOTH
@pytest.mark.parametrize("target", ["{}/there", "../there", "./../a/../there", "{}/chain"])
def test_links_are_followed_as_the_kernel_follows_them(
    asked: Callable[[Path], str], target: str, tmp_path: Path
) -> None:
    given(tmp_path / "a")
    given(tmp_path / "there")
    (tmp_path / "chain").symlink_to("there")
    (tmp_path / "a/link").symlink_to(target.format(tmp_path))
    assert asked(tmp_path / "a/link/work") == "" and (tmp_path / "there/work").is_dir()
    given(tmp_path / "there", mode=0o777)
    assert f"{tmp_path}/there can be written" in asked(tmp_path / "a/link/work")
    given(tmp_path / "there")
    # Whose it is may give it another meaning, though what it means now is ours.
    os.lchown(tmp_path / ("chain" if "chain" in target else "a/link"), OTHER, OTHER)
    assert "is a link that belongs to" in asked(tmp_path / "a/link/work")


@BOTH
def test_links_in_a_circle(asked: Callable[[Path], str], tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    assert "more than 40 links lead there" in asked(tmp_path / "a/c")


@BOTH
def test_a_file_on_the_way(asked: Callable[[Path], str], tmp_path: Path) -> None:
    (tmp_path / "a").touch()
    assert f"{tmp_path}/a is no folder" in asked(tmp_path / "a/b")


@pytest.mark.parametrize("shell", [("dash",), ("busybox", "sh")], ids=["dash", "busybox"])
@pytest.mark.parametrize("name", ["scripts", "scripts/0123", "objects/.hidden", "scripts/0123/system.sh"])
def test_what_was_put_into_the_work_folder_while_others_could(
    shell: tuple[str, ...], name: str, tmp_path: Path
) -> None:
    asked, work = by_script(*shell), tmp_path / "work"
    assert asked(work) == ""
    path = work / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    assert asked(work) == ""
    os.chown(path, OTHER, OTHER)
    assert asked(work) == f"unsafe {work} holds something that belongs to user {OTHER}\n"
    os.chown(path, 0, 0)
    path.chmod(0o666)
    assert asked(work) == f"unsafe {work} holds something that can be written by every user\n"


def test_results_and_cache_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given(tmp_path / "a", mode=0o777)
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "a/cache"))
    message = (
        f"{tmp_path}/a can be written by every user: name a new folder that is yours alone, or take that right away"
    )

    def fill() -> None:
        with run_directory.filling(tmp_path / "a/run"):
            pass

    def lock() -> None:
        with cache.locked("kind", "name"):
            pass

    for use in (
        lambda: run_directory.make_results(tmp_path / "a/results"),
        lambda: run_directory.make_new_results(tmp_path / "a/results"),
        lambda: cache.entry("kind", "key", lambda _: None),
        fill,
        lock,
    ):
        with pytest.raises(UsageError, match=message):
            use()
    assert list((tmp_path / "a").iterdir()) == []


def test_new_results_are_ours_whatever_the_umask(tmp_path: Path) -> None:
    """With 002, as many users have it, their group could write what mkdir makes."""
    given(tmp_path / "a", mode=0o755)
    folder = tmp_path / "a/results/quick"
    before = os.umask(0)
    try:
        folders = [run_directory.make_new_results(folder) for _ in range(2)]
    finally:
        os.umask(before)
    assert folders == [folder, folder.with_name("quick-2")]
    assert {path.stat().st_mode & 0o777 for path in (folder.parent, *folders)} == {0o755}


def test_what_is_in_the_cache_must_be_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path))
    os.chown(cache.entry("kind", "key", lambda _: None), OTHER, OTHER)
    with pytest.raises(UsageError, match=f"{tmp_path}/kind/key belongs to the user {OTHER}"):
        cache.entry("kind", "key", lambda _: None)


def test_who_owns_the_program_or_called_sudo_is_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a CI, where root measures in a checkout of another user's whose umask was 0, and with sudo."""
    checkout = given(tmp_path / "checkout", owner=OTHER, mode=0o777)
    program = checkout / "program.py"
    program.touch()
    assert "belongs to the user 12345" in by_the_runner(checkout / "results")
    monkeypatch.setattr(ownership, "_PROGRAM", program)
    assert by_the_runner(checkout / "results") == ""
    assert "belongs to" in by_the_runner(given(tmp_path / "elsewhere", owner=OTHER))
    os.chown(program, OTHER, OTHER)
    assert by_the_runner(tmp_path / "elsewhere/results") == ""
    os.chown(program, 0, 0)
    monkeypatch.setenv("SUDO_UID", str(OTHER))
    assert by_the_runner(tmp_path / "elsewhere/results") == ""
    # Beside the program nothing is taken that others can write to.
    given(checkout / "open", mode=0o777)
    assert "can be written by every user" in by_the_runner(checkout / "open")
