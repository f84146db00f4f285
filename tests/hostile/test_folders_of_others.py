"""Folders that look safe: lists of rights (ACL), and ways that end in a folder where everybody may add names."""

import contextlib
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import seeing
from rtfiles import atomic, cache, ownership
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.archive import store
from rtrun.targets.inspection import work_folder

OTHER = 65534
pytestmark = pytest.mark.root("gives folders to other users")


def acl(permissions):
    entries = [(1, 7, -1), (2, permissions, OTHER), (4, 5, -1), (16, 7, -1), (32, 5, -1)]
    packed = [struct.pack("<HHI", tag, bits, who & 0xFFFFFFFF) for tag, bits, who in entries]
    return struct.pack("<I", 2) + b"".join(packed)


def by_script(path, *shell):
    done = subprocess.run(
        [*shell, "-s", str(path)], input=work_folder.SCRIPT.read_text(), capture_output=True, text=True, check=True
    )
    return done.stdout


def by_runner(path):
    try:
        ownership.make_folder(path)
    except UsageError as error:
        return str(error)
    return ""


def other_writes(path):
    code = f"import os; os.setgroups([]); os.setgid({OTHER}); os.setuid({OTHER}); open({str(path)!r}, 'w')"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


@pytest.fixture
def place(tmp_path):
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o755)
    return tmp_path


def test_a_default_acl_that_the_remedy_leaves(place):
    folder = place / "work"
    folder.mkdir()
    os.chown(folder, OTHER, OTHER)
    os.setxattr(folder, "system.posix_acl_default", acl(7))
    subprocess.run(["chown", "-R", "root:root", folder], check=True)
    subprocess.run(["chmod", "-R", "go-w", folder], check=True)
    refusal = by_script(folder, "sh")
    assert refusal or not other_writes(folder / "objects/evil")


def test_a_default_acl_of_a_folder_of_results(place):
    os.setxattr(place, "system.posix_acl_default", acl(7))
    refusal = by_runner(place / "results")
    if not refusal:
        (place / "results/001").mkdir()
    assert refusal or not other_writes(place / "results/001/evil")


def test_an_acl_by_the_runner(place):
    folder = place / "results"
    folder.mkdir()
    os.setxattr(folder, "system.posix_acl_access", acl(7))
    assert by_runner(folder) or not other_writes(folder / "evil")


def test_an_acl_where_ls_is_that_of_busybox(place):
    folder, tools = place / "work", place / "tools"
    folder.mkdir()
    tools.mkdir()
    os.setxattr(folder, "system.posix_acl_access", acl(7))
    for name in ("ls", "sh"):
        (tools / name).symlink_to("/usr/bin/busybox")
    refusal = by_script(folder, "env", f"PATH={tools}:/usr/bin:/bin", "sh")
    assert refusal or not other_writes(folder / "evil")


@pytest.mark.parametrize(
    ("asked", "way"),
    [
        (by_runner, "new/.."),
        (by_runner, "link to ."),
        (lambda path: by_script(path, "sh"), "new/.."),
        (lambda path: by_script(path, "sh"), "link to a folder/"),
    ],
    ids=["runner-up", "runner-dot", "script-up", "script-slash"],
)
def test_a_sticky_folder_at_the_end(place, asked, way):
    sticky = place / "sticky"
    sticky.mkdir()
    sticky.chmod(0o1777)
    path = sticky / way
    if way == "link to a folder/":
        path = place / "link"
        path.symlink_to(f"{sticky}/")
    elif way == "link to .":
        # In the sticky folder's parent it would be another folder.
        path = sticky / ".rt-tests-link"
        path.symlink_to(".")
    elif way == "new/..":
        (sticky / "runs").mkdir()
        path = sticky / "runs/.."
    refusal = asked(path)
    assert "can be written by every user" in refusal, refusal or "accepted"


def test_a_list_of_rights_to_read_is_no_objection(place):
    folder = place / "work"
    folder.mkdir(0o755)
    os.setxattr(folder, "system.posix_acl_access", acl(5))
    folder.chmod(0o755)
    assert by_script(folder, "sh") == by_runner(folder) == ""


@pytest.mark.parametrize("second", ["", "wheel:x:0:mallory\n"])
def test_a_group_that_stands_in_two_lines(place, tmp_path, second):
    """The number is what counts, and each line has members of its own."""
    (tmp_path / "group").write_text(f"root:x:0:\nother:x:7:a,b\n{second}")
    folder = place / "shared"
    folder.mkdir(mode=0o775)
    folder.chmod(0o775)
    with_groups = seeing({"/etc/group": tmp_path / "group"})
    code = (
        "import sys\nfrom pathlib import Path\nfrom rtfiles import ownership\nownership.make_folder(Path(sys.argv[1]))"
    )
    runner = subprocess.run(
        [*with_groups, sys.executable, "-c", code, str(folder / "results")], capture_output=True, text=True, check=False
    )
    refusal = "can be written by the group 0"
    assert (refusal in runner.stderr) == bool(second)
    assert (refusal.replace("the ", "") in by_script(folder / "work", *with_groups, "sh")) == bool(second)


@pytest.mark.parametrize(
    "put",
    ["a\n-rw-r--r-- 1 0 0 0 x", "\n", "-R", " 1 0 0 0", ".hidden", "deep/er/x", "pipe", "link", "a\n\n/etc:\ntotal 0"],
)
def test_nothing_of_another_user_hides_in_the_work_folder(place, put):
    """He put it there while he could; the names of files are lines, options and listings of other folders."""
    work = place / "work"
    (work / "runs").mkdir(parents=True)
    (work / ".rt-tests").touch()
    his = work / f"runs/{put}"
    his.parent.mkdir(parents=True, exist_ok=True)
    if put == "pipe":
        os.mkfifo(his)
    elif put == "link":
        his.symlink_to("/etc/shadow")
    else:
        his.touch()
    assert by_script(work, "sh") == ""
    os.lchown(his, OTHER, OTHER)
    assert by_script(work, "sh") == f"unsafe {work} holds something that belongs to user {OTHER}\n"


@pytest.mark.parametrize("kind", ["kind", "another"])
@pytest.mark.parametrize("left", ["lock", "lock of a leftover", "pipe", "second name"])
def test_what_was_put_into_a_cache_while_others_could(place, monkeypatch, kind, left):
    """The rights have been put right since: the folder is ours alone, and what is in it is not."""
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(place / "cache"))
    precious = place / "shadow"
    precious.write_text("root:secret")
    (place / f"cache/{kind}").mkdir(parents=True)
    key = "of-another" if left == "lock of a leftover" else "key"
    lock = place / f"cache/{kind}/.{key}.lock"
    if left == "second name":
        lock.hardlink_to(precious)
    elif left == "pipe":
        os.mkfifo(lock)
    else:
        lock.symlink_to(precious)
    if left == "lock of a leftover":
        (place / f"cache/{kind}/.{key}.tmp-1").mkdir()
    with contextlib.suppress(UsageError):
        cache.entry("kind", "key", lambda folder: None)
    assert precious.read_text() == "root:secret"


@pytest.mark.parametrize("name", ["report.html", "folder/report.html", "archive/runs/x.parquet"])
def test_a_link_of_another_user_leads_nowhere(place, name):
    """Where everybody may add names, he was there first. What the kernel does against that (fs.protected_symlinks) is
    not everywhere, and does not see a path that was resolved before."""
    precious = place / "etc"
    precious.mkdir()
    (precious / "report.html").write_text("root:secret")
    (precious / "x.parquet").write_text("root:secret")
    shared = place / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    link = shared / name
    if name.startswith("archive/"):
        link = shared / "archive/runs"
        link.parent.mkdir()
        os.chown(link.parent, OTHER, OTHER)
    elif name.startswith("folder/"):
        link = shared / "folder"
    link.symlink_to(precious / "report.html" if link.name == "report.html" else precious)
    os.lchown(link, OTHER, OTHER)
    with pytest.raises(OSError, match=f"{link} is a link that belongs to nobody") as caught:
        atomic.write_bytes(shared / name, b"new")
    assert caught.value.filename == str(shared / name)
    assert {path.read_text() for path in precious.iterdir()} == {"root:secret"}
    # Root's own, and the user's, are followed.
    os.lchown(link, 0, 0)
    atomic.write_bytes(shared / name, b"new")
    assert (precious / Path(name).name).read_text() == "new"


def test_a_link_in_an_archive_leads_nowhere(place):
    """Neither is a folder made behind it, nor a file removed."""
    elsewhere = place / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "a.parquet").touch()
    archive = store.make_archive(str(place / "archive"))
    (place / "archive/runs").symlink_to(elsewhere)
    os.lchown(place / "archive/runs", OTHER, OTHER)
    with pytest.raises(InfrastructureError, match="is a link that belongs to nobody"):
        store.write_file(archive, "runs/new/b.parquet", b"PAR1")
    with pytest.raises(InfrastructureError, match="a file cannot be removed"):
        store.remove_files(archive, store.find_files(archive, "runs"))
    assert [path.name for path in elsewhere.rglob("*")] == ["a.parquet"]


def test_rights_are_given_to_the_file_that_was_written(place, monkeypatch):
    """In a folder of his another user puts a link in the place of the file before it gets its rights."""
    precious = place / "shadow"
    precious.touch(mode=0o600)

    def swap(_):
        for temporary in place.glob(".out.*"):
            temporary.unlink()
            temporary.symlink_to(precious)

    monkeypatch.setattr(os, "fsync", swap)
    with contextlib.suppress(OSError):
        atomic.write_bytes(place / "out", b"new")
    assert precious.stat().st_mode & 0o777 == 0o600


@contextlib.contextmanager
def served(folder, user):
    """A file system of FUSE that nobody answers for: whoever looks into it waits for ever."""
    handle = os.open("/dev/fuse", os.O_RDWR)
    try:
        options = f"fd={handle},rootmode=40000,user_id={user},group_id={user},allow_other"
        mount = ["mount", "-i", "-t", "fuse", "-o", options, "user_id=0", folder]
        if subprocess.run(mount, pass_fds=[handle], check=False, capture_output=True).returncode:
            pytest.skip("this kernel has no FUSE")
        try:
            yield
        finally:
            subprocess.run(["umount", "-l", folder], check=True)
    finally:
        os.close(handle)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["mine", "with blank"])
@pytest.mark.parametrize("below", ["", "/down/below"])
def test_a_file_system_of_another_user_is_not_looked_into(place, name, below):
    folder = place / name
    folder.mkdir()
    with served(folder, OTHER):
        reason = f"{folder} is a file system (FUSE) of another user"
        assert reason in by_runner(Path(f"{folder}{below}"))
        assert by_script(f"{folder}{below}", "timeout", "20", "sh") == f"unsafe {reason}\n"
