"""``results/latest``: the link to the newest folder of results, for commands that are called without one.

Only `results` in the working directory has it, and it leads only to folders directly in there. It is checked before it
is followed, because nobody named the folder that it leads to: another user may have placed it.
"""

from pathlib import Path

from rtfiles import atomic, ownership
from rtfiles.errors import UsageError
from rtfiles.output import listed, print_note
from rtrun.results.record import FILE

ROOT = Path("results")
LINK = ROOT / "latest"


def default_results(name: str) -> Path:
    """The folder of results of a campaign, or a target, of this name. Raises UsageError for the name of the link."""
    folder = ROOT / name
    if folder == LINK:
        raise UsageError(f"{LINK}: the link to the newest results has this name: name another folder by --results")
    return folder


def set_latest(folder: Path) -> None:
    """Let the link lead to a folder of results that is measured into; one that is not in `results` changes nothing.

    A link that cannot be set is no reason not to measure: it is reported.
    """
    folder = folder.resolve()
    if folder.parent != ROOT.resolve() or (LINK.exists() and not LINK.is_symlink()):
        return
    try:
        atomic.replace_link(LINK, folder.name)
    except OSError as error:
        print_note(f"rtrun: {LINK}: not set to {folder.name}: {error.strerror}")


def latest_results() -> Path:
    """The folder that the link leads to. Raises UsageError where there is none, or where others could change it."""
    if not LINK.is_symlink():
        there = sorted({str(record.parent.parent) for record in ROOT.glob(f"*/*/{FILE}")})
        known = f"; those here are {listed(there, 5)}" if there else ""
        raise UsageError(f"{LINK}: no such link, which whatever measures makes: name the results{known}")
    name = str(LINK.readlink())
    folder = ROOT / name
    if name in ("..", LINK.name) or folder.parent != ROOT or folder.is_symlink():
        raise UsageError(f"{LINK}: does not lead to a folder in {ROOT}, but to {name}: name the results")
    try:
        ownership.check_folder(LINK, "name the results that you mean")
    except OSError as error:
        raise UsageError(f"{LINK}: leads to {name}: {error.strerror}: name the results") from error
    return folder
