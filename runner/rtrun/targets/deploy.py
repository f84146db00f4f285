"""Put files on the target by content: files that are already there are not sent again."""

import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from rtfiles.errors import UsageError
from rtrun.targets import groups
from rtrun.targets.errors import TargetError

if TYPE_CHECKING:
    from rtrun.targets.connection import Connection
    from rtrun.targets.link import Link

ON_TARGET = Path(__file__).parents[1] / "on_target"

# Trees of each kind that stay in addition to those of a campaign: going back to the last build costs no transfer, and
# another runner may be about to use its own.
KEPT = 2
# A slow board checks the suites, some MiB, in a second.
CHECK_S = 120.0  #: checking what was deployed on the target
# Whether the tree exists with these checksums. If so, it counts as used now.
_IS_WHOLE = 'cd "$1" 2>/dev/null && sha256sum -c - >/dev/null 2>&1 && touch .'
# Prints "<object>: OK" for each object that is there and whole.
_WHOLE = 'cd "$1" && LC_ALL=C sha256sum -c - 2>/dev/null; exit 0'
# A file has the name of its checksum. It is checked first, then renamed, so that a power cut leaves no partial file.
_ADOPT = 'cd "$1" && echo "$3  $2" | sha256sum -c - >/dev/null && chmod 755 "$2" && sync "$2" && mv "$2" "$3"'
_LINK = """
set -e
listing=$(cat)
mkdir -p "$1.$3"; cd "$1.$3"
echo "$listing" | while read -r digest path; do
    case $path in */*) mkdir -p "${path%/*}";; esac
    ln "$2/$digest" "$path"
done
# The listing ends early when the link does: what is not whole gets no name.
[ "$(find . -type f | wc -l)" -eq "$4" ]
cd ..
if (cd "$1" && echo "$listing" | sha256sum -c -) >/dev/null 2>&1; then
    # Another runner was faster, and may use it already.
    rm -rf "$1.$3"
    exit
fi
[ ! -e "$1" ] || mv "$1" "$1.$3.damaged"
mv "$1.$3" "$1"
# Into it, where it has come in between.
rm -rf "$1/${1##*/}.$3" "$1.$3.damaged"
"""
# Removes nothing while a program of any run lives: it may have been started from any of the trees.
_PRUNE = (
    groups.FUNCTIONS
    + """
cd "$1" || exit 1
[ -z "$(living runs)" ] || exit 0
for kind in scripts suites sources; do
    ls -t "$kind" 2>/dev/null | tail -n "+$(($2 + 1))" | while read -r tree; do rm -rf "$kind/$tree"; done
done
# Of no tree. One of today may be that of another runner, which is about to make a tree of it.
find objects -type f -links 1 -mtime +0 -exec rm -f {} +
"""
)


def deploy(link: "Link", folder: Path, kind: str) -> PurePosixPath:
    """Put a local folder on the target as ``<work_dir>/<kind>/<hash of its contents>`` and return that path.

    An existing copy is used only if its checksums are right. Raises TargetError when the target cannot hold the folder.
    May be repeated after any failure.
    """
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    if not files:
        raise UsageError(f"{folder}: nothing to deploy, the folder is empty")
    digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    listing = "".join(f"{digest}  {name}\n" for name, digest in digests.items())
    tree = link.target.work_dir / kind / hashlib.sha256(listing.encode()).hexdigest()[:16]
    if link.run(["sh", "-c", _IS_WHOLE, "sh", str(tree)], deadline_s=CHECK_S, stdin=listing).status == 0:
        return tree
    by_digest = {digest: files[name] for name, digest in digests.items()}
    link.do(lambda connection: _send(connection, link.target.work_dir / "objects", by_digest))
    objects = str(link.target.work_dir / "objects")
    command = ["sh", "-c", _LINK, "sh", str(tree), objects]
    # The random name is new at each attempt: a lost link may have left part of a tree.
    link.check([*command, secrets.token_hex(4), str(len(files))], stdin=listing)
    return tree


def prune(link: "Link", used: int) -> None:
    """Remove all deployed trees but the `used` newest and KEPT others, unless a run is going on."""
    link.check(["sh", "-c", _PRUNE, "sh", str(link.target.work_dir), str(used + KEPT)], deadline_s=CHECK_S)


def _send(connection: "Connection", objects: PurePosixPath, by_digest: Mapping[str, Path]) -> None:
    listing = "".join(f"{digest}  {digest}\n" for digest in by_digest)
    whole = connection.check(["sh", "-c", _WHOLE, "sh", str(objects)], deadline_s=CHECK_S, stdin=listing).splitlines()
    for digest in (digest for digest in by_digest if f"{digest}: OK" not in whole):
        temporary = f".{digest}.{secrets.token_hex(4)}"
        try:
            adopt = ["sh", "-c", _ADOPT, "sh", str(objects), temporary, digest]
            connection.upload(by_digest[digest], objects / temporary, adopt)
        except TargetError:
            # Best effort: on a full disk the part that was sent is in the way of everything else.
            connection.run(["rm", "-f", str(objects / temporary)])
            raise
