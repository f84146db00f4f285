"""``results/latest``: the link to the newest folder of results, for commands that are called without one.

Only `results` in the working directory has it, and it leads only to folders directly in there. It is checked before it
is followed, because nobody named the folder that it leads to: another user may have placed it.
"""

from datetime import datetime
from pathlib import Path

from rtfiles import atomic, ownership
from rtfiles.errors import UsageError
from rtfiles.output import listed, print_note
from rtrun.results.reading import find_source
from rtrun.results.record import FILE, RunRecord, moment, read_record

ROOT = Path("results")
LINK = ROOT / "latest"
_REMEDY = "name the results that you mean"


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
        ownership.check_folder(LINK, _REMEDY)
    except OSError as error:
        raise UsageError(f"{LINK}: leads to {name}: {error.strerror}: name the results") from error
    return folder


def measured_before(folder: Path) -> Path:
    """The folder next to this one that has the same campaign as it was measured the time before.

    Raises UsageError where there is none, or where others could change it.
    """
    record = _first_record(folder)
    start = moment(record.start_time)
    if start is None:
        raise UsageError(f"{folder}: when it was measured is not known: name the results to compare it with")
    earlier: list[tuple[datetime, Path]] = []
    for other in folder.resolve().parent.iterdir():
        if other.is_symlink() or not other.is_dir() or other.samefile(folder):
            continue
        try:
            its = _first_record(other)
        except UsageError:  # no folder of results, or one that cannot be read
            continue
        its_start = moment(its.start_time)
        if its.campaign == record.campaign and its_start is not None and its_start < start:
            earlier.append((its_start, other))
    if not earlier:
        raise UsageError(
            f"{folder}: the campaign {record.campaign} was not measured before into a folder next to it: run it with "
            "--fresh to keep both, or name the results to compare it with"
        )
    last = folder.parent / max(earlier)[1].name
    ownership.check_folder(last, _REMEDY)
    return last


def _first_record(folder: Path) -> RunRecord:
    """The record of the first run in a folder: the others were measured with it."""
    folders = find_source(folder).folders
    if not folders:
        raise UsageError(f"{folder}: not a results folder or a run directory")
    return read_record(folders[0])
