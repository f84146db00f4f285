"""Folders that nobody else can change: every folder on the path is checked before anything is written.

A folder is safe if it belongs to a trusted user and nobody else may write to it. One check is enough, because its
result stays true: from the root down, only trusted users can change what a name in a safe folder refers to. In a folder
with the sticky bit, such as /tmp, others may add names, but cannot rename or remove what belongs to somebody else, so
the next folder or link must belong to a trusted user. Another user may create a missing folder there at the same
moment: `mkdir` never reuses an existing folder, and the owner is checked afterwards.

Trusted are root, the user who runs the program, and the owner of the program: whoever can change the program gains
nothing by changing what it writes. For the same reason the folders that contain the program are not checked. So root
can measure in somebody else's checkout, as in a CI container.
"""

import contextlib
import errno
import grp
import os
import pwd
import re
import stat
from pathlib import Path

from rtfiles.errors import UsageError

# The kernel's own limit (path_resolution(7)).
LINKS_MAX = 40  #: links on the way to a folder of results, or to the cache
_PROGRAM = Path(__file__)


def make_folder(path: Path) -> bool:
    """Make a folder and its missing parents, unless they exist. Returns whether this call made the last one.

    Raises UsageError, with the remedy, where somebody else may change a folder on the path; OSError where a folder
    cannot be made.
    """
    remedy = f"name a new folder that is yours alone, or take that right away: chown {_name(os.geteuid())}, chmod go-w"
    return _walk(path, remedy, makes=True)


def check_folder(path: Path, remedy: str) -> None:
    """Check a folder, or a link to one, that nobody named on the command line; `remedy` is what to do otherwise.

    Raises UsageError where somebody else may change it, OSError where there is no such folder.
    """
    _walk(path, remedy, makes=False)


def _walk(path: Path, remedy: str, *, makes: bool) -> bool:
    """Check each folder and link on a path, and make those that are missing. Returns whether the last one was made."""
    trusted = _trusted()
    above_program = {str(folder) for folder in _PROGRAM.resolve().parents}
    served = _served_by_others(trusted)
    seen, links = "", 0
    waiting = ["", *path.absolute().parts[1:]]
    while waiting:
        name = waiting.pop(0)
        is_new = False
        if name == "..":
            seen = os.path.dirname(seen)  # noqa: PTH120 - of a path without links, whose root is empty
            continue
        place = f"{seen}/{name}" if name else "/"
        if place in served:
            raise _unsafe(path, place, "is a file system (FUSE) of another user", remedy)
        with contextlib.suppress(FileExistsError):
            if makes and not os.path.lexists(place):
                Path(place).mkdir(0o755)
                is_new = True
        found = os.lstat(place)
        if stat.S_ISLNK(found.st_mode):
            links += 1
            if links > LINKS_MAX:
                raise UsageError(f"{path}: more than {LINKS_MAX} links lead there")
            if found.st_uid not in trusted:
                raise _unsafe(path, place, f"is a link that belongs to {_name(found.st_uid)}", remedy)
            target = Path(place).readlink()
            if target.is_absolute():
                seen = ""
            waiting = [*(target.parts[1:] if target.is_absolute() else target.parts), *waiting]
            continue
        if not stat.S_ISDIR(found.st_mode):
            raise UsageError(f"{path}: {place} is no folder")
        if place not in above_program and (why := _objection(place, found, trusted, is_last=False)):
            raise _unsafe(path, place, why, remedy)
        seen = place.rstrip("/")
    # Where the path ends, after all links and `..`.
    end = seen or "/"
    if end not in above_program and (why := _objection(end, os.lstat(end), trusted, is_last=True)):
        raise _unsafe(path, end, why, remedy)
    return is_new


def resolve(path: Path) -> Path:
    """The path without links: nobody else can redirect it to make a writer overwrite the writer's own file.

    Raises OSError where a link on the path belongs to a user who is not trusted, or where there are too many links.
    """
    trusted, links = _trusted(), 0
    seen, waiting = "/", list(path.absolute().parts[1:])
    while waiting:
        place = os.path.join(seen, waiting.pop(0))  # noqa: PTH118
        if place.endswith("/.."):
            seen = os.path.dirname(seen)  # noqa: PTH120
            continue
        try:
            target = os.readlink(place)  # noqa: PTH115 - to a folder of the text's own, with . and .. as they are
        except OSError:  # it is not a link, or missing
            seen = place
            continue
        links += 1
        if links > LINKS_MAX:
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
        if (owner := os.lstat(place).st_uid) not in trusted:
            raise OSError(errno.EACCES, f"{place} is a link that belongs to {_name(owner)}", str(path))
        waiting = [part for part in target.split("/") if part not in ("", ".")] + waiting
        seen = "/" if target.startswith("/") else seen
    return Path(seen)


def _served_by_others(trusted: set[int]) -> set[str]:
    """Mount points of FUSE file systems of untrusted users, who choose what is reported about their files."""
    served = set()
    for line in Path("/proc/self/mountinfo").read_bytes().splitlines():
        mount, _, system = line.partition(b" - ")
        kind, _, options = system.split(b" ", 2)
        users = [int(option[8:]) for option in options.split(b",") if option.startswith(b"user_id=")]
        if kind.startswith(b"fuse") and not trusted.issuperset(users):
            place = re.sub(rb"\\([0-7]{3})", lambda octal: bytes([int(octal[1], 8)]), mount.split(b" ")[4])
            served.add(os.fsdecode(place))
    return served


def _trusted() -> set[int]:
    """The numbers of the users who may change a folder."""
    trusted = {0, os.geteuid(), _PROGRAM.stat().st_uid}
    if os.geteuid() == 0 and (caller := os.environ.get("SUDO_UID", "")).isascii() and caller.isdigit():
        trusted.add(int(caller))  # set by sudo: a user who may run this as root can do all that root can
    return trusted


def _objection(place: str, found: os.stat_result, trusted: set[int], *, is_last: bool) -> str | None:
    """Why a folder is not safe; None: it is. In the last folder, others must not even add names.

    An access control list (ACL) lets others write where the mode grants the group write access. A default ACL, which
    chmod does not change, gives others access to new files in a folder, whatever the umask is.
    """
    if found.st_uid not in trusted:
        return f"belongs to {_name(found.st_uid)}"
    if found.st_mode & stat.S_ISVTX and not is_last:
        return None
    if found.st_mode & stat.S_IWOTH:
        return "can be written by every user"
    lists = _lists_of_rights(place)
    if found.st_mode & stat.S_IWGRP and ("access" in lists or not _is_private(found)):
        return f"can be written by the group {found.st_gid}" + (", or others (getfacl)" if "access" in lists else "")
    if is_last and "default" in lists:
        return "gives others rights to what is made there (getfacl)"
    return None


def _lists_of_rights(place: str) -> set[str]:
    """The ACLs of a folder: "access", "default", both or none; none on a file system without ACLs."""
    with contextlib.suppress(OSError):
        prefix = "system.posix_acl_"
        return {name.removeprefix(prefix) for name in os.listxattr(place) if name.startswith(prefix)}
    return set()


def _is_private(found: os.stat_result) -> bool:
    """Whether the owner is the only member of a folder's group, as in the personal groups that users get."""
    if found.st_uid != found.st_gid:
        return False
    with contextlib.suppress(KeyError):
        owner = pwd.getpwuid(found.st_uid).pw_name
        # A number may occur in several lines, each with its own members.
        groups = [group.gr_mem for group in grp.getgrall() if group.gr_gid == found.st_gid]
        others = any(user.pw_gid == found.st_gid and user.pw_uid != found.st_uid for user in pwd.getpwall())
        return bool(groups) and not others and {name for names in groups for name in names} <= {owner}
    return False


def _unsafe(path: Path, place: str, why: str, remedy: str) -> UsageError:
    return UsageError(f"{path}: others could change what is kept there: {place} {why}: {remedy}")


def _name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"the user {uid}"
