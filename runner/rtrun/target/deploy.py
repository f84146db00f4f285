"""Putting files on the target by content: what is there already is not sent again."""

import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from rtfiles.errors import UsageError
from rtrun.target.connection import Connection
from rtrun.target.errors import TargetError
from rtrun.target.link import Link

ON_TARGET = Path(__file__).parents[1] / "on_target"

_MISSING = 'cd "$1" && shift && for object; do [ -e "$object" ] || echo "$object"; done'
# The file is its name's word: checked where it lies, then renamed, so that a power cut leaves no half of it.
_ADOPT = 'cd "$1" && echo "$3  $2" | sha256sum -c - >/dev/null && chmod 755 "$2" && sync "$2" && mv "$2" "$3"'
_LINK = """
set -e
[ -d "$1" ] && exit 0
mkdir -p "$1.$3"; cd "$1.$3"
while read -r digest path; do
    case $path in */*) mkdir -p "${path%/*}";; esac
    ln "$2/$digest" "$path"
done
# The listing ends early when the link does: what is not whole gets no name.
[ "$(find . -type f | wc -l)" -eq "$4" ]
cd ..; mv "$1.$3" "$1"
"""


def deploy(link: Link, folder: Path, kind: str) -> PurePosixPath:
    """Make a local folder stand on the target as ``<work_dir>/<kind>/<hash of its contents>`` and return that path.

    Raises TargetError when the target cannot hold it. May be repeated after anything went wrong.
    """
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    if not files:
        raise UsageError(f"{folder}: nothing to deploy, the folder is empty")
    digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    listing = "".join(f"{digest} {name}\n" for name, digest in digests.items())
    tree = link.target.work_dir / kind / hashlib.sha256(listing.encode()).hexdigest()[:16]
    by_digest = {digest: files[name] for name, digest in digests.items()}
    link.do(lambda connection: _send(connection, link.target.work_dir / "objects", by_digest))
    objects = str(link.target.work_dir / "objects")
    command = ["sh", "-c", _LINK, "sh", str(tree), objects]
    # Drawn anew at each attempt: a lost link may have left half of one.
    link.check([*command, secrets.token_hex(4), str(len(files))], stdin=listing)
    return tree


def _send(connection: Connection, objects: PurePosixPath, by_digest: Mapping[str, Path]) -> None:
    missing = connection.check(["sh", "-c", _MISSING, "sh", str(objects), *by_digest]).split()
    for digest in missing:
        if digest not in by_digest:
            raise TargetError(f"{connection.address}: asked for an object that was not offered: {digest[:80]!r}")
        temporary = f".{digest}.{secrets.token_hex(4)}"
        try:
            adopt = ["sh", "-c", _ADOPT, "sh", str(objects), temporary, digest]
            connection.upload(by_digest[digest], objects / temporary, adopt)
        except TargetError:
            # Best effort: on a full disk the half that was sent is in the way of everything else.
            connection.run(["rm", "-f", str(objects / temporary)])
            raise
