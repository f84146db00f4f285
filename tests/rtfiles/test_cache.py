"""Entries appear whole or not at all, and what killed builds leave is removed."""

import fcntl
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rtfiles import cache


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "cache"))
    return cache.root()


def write(folder: Path) -> None:
    (folder / "file").write_text("content")


def test_an_entry_is_built_once() -> None:
    folder = cache.entry("kind", "key", write)
    assert (folder / "file").read_text() == "content" and folder.stat().st_mode & 0o777 == 0o755
    assert cache.entry("kind", "key", lambda _: pytest.fail("built again")) == folder


def test_a_build_that_fails_leaves_nothing(root: Path) -> None:
    def fail(folder: Path) -> None:
        write(folder)
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        cache.entry("kind", "key", fail)
    assert [path.name for path in (root / "kind").iterdir()] == [".key.lock"]


def test_the_next_build_removes_what_killed_builds_left(root: Path) -> None:
    for kind in ("kind", "other"):
        write_to = root / kind / ".old.tmp-abc"
        write_to.mkdir(parents=True)
        write(write_to)
    running = root / "other" / ".running.tmp-abc"
    running.mkdir()
    with (root / "other" / ".running.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        cache.entry("kind", "key", write)
    assert sorted(path.parent.name for path in root.glob("*/.*.tmp-*")) == ["other"] and running.is_dir()
    cache.entry("kind", "key2", write)
    assert not running.exists()


def test_the_digest_sees_every_part(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    file = folder / "sub" / "file"
    file.write_text("a")
    digests = [cache.digest([folder])]
    file.write_text("b")
    digests.append(cache.digest([folder]))
    file.chmod(0o755)
    digests.append(cache.digest([folder]))
    file.rename(folder / "sub" / "other")
    digests.append(cache.digest([folder]))
    file.symlink_to("other")
    digests.append(cache.digest([folder]))
    file.unlink()
    file.symlink_to("elsewhere")
    digests.append(cache.digest([folder]))
    (folder / "__pycache__").mkdir()
    assert cache.digest([folder]) == digests[-1], "byte code is no input"
    digests += [cache.digest(["ab", "c"]), cache.digest(["a", "bc"]), cache.digest(["c", "ab"])]
    assert len(set(digests)) == len(digests)
    assert all(len(digest) == 16 for digest in digests)


def test_two_that_want_the_same_entry_build_it_once(root: Path) -> None:
    builds: list[Path] = []

    def build(folder: Path) -> None:
        builds.append(folder)
        started.set()
        finish.wait()
        write(folder)

    started, finish = threading.Event(), threading.Event()
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(cache.entry, "kind", "key", build)
        started.wait()
        second = pool.submit(cache.entry, "kind", "key", build)
        # The second one has opened the lock file that the first one holds.
        lock = str(root / "kind" / ".key.lock")
        while sum(os.path.realpath(file) == lock for file in Path("/proc/self/fd").iterdir()) < 2 and len(builds) < 2:
            time.sleep(0.01)
        finish.set()
        assert first.result() == second.result()
    assert len(builds) == 1
