"""Files and links are written whole or not at all."""

import os
from pathlib import Path

import pytest

from rtfiles import atomic


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    atomic.write_text(path, "before", mode=0o600)
    assert path.stat().st_mode & 0o777 == 0o600

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            atomic.write_text(path, "after")
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("there", ["file", "nothing"])
def test_a_link_is_followed(tmp_path: Path, there: str) -> None:
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "file", tmp_path / "link"
    link.symlink_to("folder/file")
    if there == "file":
        target.write_bytes(b"before, and longer")
    atomic.write_text(link, "after")
    assert str(link.readlink()) == "folder/file" and target.read_text() == "after"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("kind", ["fifo", "descriptor", "device"])
def test_what_is_no_regular_file_is_written_to(tmp_path: Path, kind: str) -> None:
    if kind == "fifo":
        os.mkfifo(tmp_path / "fifo")
        path, reader = tmp_path / "fifo", os.open(tmp_path / "fifo", os.O_RDONLY | os.O_NONBLOCK)
        writer = os.open(path, os.O_WRONLY)
    else:
        reader, writer = os.pipe() if kind == "descriptor" else os.openpty()
        # As /dev/stdout: a link whose text is the path of no file.
        path = Path(f"/dev/fd/{writer}" if kind == "descriptor" else os.ttyname(writer))
    before = path.stat()
    atomic.write_text(path, "after")
    assert os.read(reader, 100) == b"after" and path.stat().st_ino == before.st_ino
    assert list(tmp_path.iterdir()) == ([path] if kind == "fifo" else [])
    os.close(reader)
    os.close(writer)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        atomic.write_bytes(tmp_path / "no" / "file", b"")
    assert raised.value.filename == str(tmp_path / "no" / "file")


def test_a_link_is_replaced_in_one_step(tmp_path: Path) -> None:
    link = tmp_path / "folder" / "link"
    atomic.replace_link(link, tmp_path / "a")
    number = link.lstat().st_ino
    atomic.replace_link(link, tmp_path / "a")
    assert link.lstat().st_ino == number, "what is right stays"
    atomic.replace_link(link, "../b")
    assert str(link.readlink()) == "../b" and list(link.parent.iterdir()) == [link]


def test_a_folder_is_not_replaced_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "folder" / "sub").mkdir(parents=True)
    with pytest.raises(OSError) as raised:
        atomic.replace_link(tmp_path / "folder", "elsewhere")
    assert raised.value.filename == str(tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
