"""A rendering on disk: compared, and written without touching what others put there."""

import difflib
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rtfiles import atomic
from rtfiles.errors import UsageError
from rtgen.checkout import checkout
from rtgen.layer.render import SOURCES_LINK, Link, Tree, is_ours
from rtgen.profile import LAYER

OWNED = (LAYER,)  # folders that hold nothing but the rendering


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """What writing a rendering did. `linked`: folders the rendering links to, which were not there."""

    written: int
    removed: tuple[Path, ...]
    linked: tuple[Path, ...]


def prefix_in_git(out: Path) -> str:
    """`out` below the git repository it lies in, with a slash at the end; "" if it is its top or there is none."""
    out = out.resolve()
    for folder in (out, *out.parents):
        if (folder / ".git").exists():
            return "" if folder == out else f"{out.relative_to(folder).as_posix()}/"
    return ""


def differences(tree: Tree, out: Path) -> str:
    """How the folder differs from the rendering, as a unified diff; "" if it does not."""
    lines: list[str] = []
    for path in sorted({*tree, *_present(out)}):
        name = path.as_posix()
        have, want = _read(out / path), _content(tree, path)
        if have != want:
            before, after = have.splitlines(keepends=True), want.splitlines(keepends=True)
            lines += difflib.unified_diff(before, after, f"{name} (present)", f"{name} (rendered)")
    return "".join(line if line.endswith("\n") else f"{line}\n" for line in lines)


def write(tree: Tree, out: Path) -> Outcome:
    """Make the folder hold the rendering. A folder that it links to and that is not there becomes a link to ours.

    What is there must be a rendering: raises UsageError naming all that is not, before anything is written.
    """
    obstacles = _obstacles(tree, out)
    if obstacles:
        raise UsageError("\n".join(f"{path}: {what}, move it away" for path, what in sorted(obstacles.items())))
    present = _present(out)
    written = 0
    for path, content in tree.items():
        target = out / path
        target.parent.mkdir(parents=True, exist_ok=True)
        # An unchanged file keeps its time, so that BitBake parses it no second time.
        if isinstance(content, Link):
            link = _relative(content, path)
            if not target.is_symlink() or str(target.readlink()) != link:
                atomic.replace_link(target, link)
                written += 1
        elif target.is_symlink() or _read(target) != content:
            atomic.write_text(target, content)
            written += 1
    removed = [out / path for path in present if path not in tree]
    for file in removed:
        file.unlink()
        _remove_empty(file, out)
    linked = [link.target for link in tree.values() if isinstance(link, Link) and not (out / link.target).exists()]
    for path in linked:
        (out / path).symlink_to((checkout() / path).resolve())
    return Outcome(written=written, removed=tuple(removed), linked=tuple(out / path for path in linked))


def _obstacles(tree: Tree, out: Path) -> dict[Path, str]:
    """What keeps the rendering from being written, and why."""
    targets = [out / path for path in tree]
    obstacles = {out / path: "not rendered by rtgen" for path in _present(out) if not _replaceable(path, out)}
    obstacles |= {
        path: "a folder, a file is to be there" for path in targets if path.is_dir() and not path.is_symlink()
    }
    parents = {parent for path in targets for parent in path.parents}
    links = {out / content.target for content in tree.values() if isinstance(content, Link)}
    for path in parents | links:
        if os.path.lexists(path) and not path.is_dir():
            obstacles[path] = "not a folder" if path.exists() else "a link that leads nowhere"
    return obstacles


def _present(out: Path) -> list[PurePosixPath]:
    """Every file and link below the folders we own, kas.yml, and a link where such a folder is to be."""
    found = [PurePosixPath("kas.yml")] if os.path.lexists(out / "kas.yml") else []
    for owned in OWNED:
        if (out / owned).is_symlink():
            found.append(PurePosixPath(owned))
            continue
        for folder, folders, files in os.walk(out / owned):
            links = [name for name in folders if (Path(folder) / name).is_symlink()]
            found += [PurePosixPath((Path(folder) / name).relative_to(out).as_posix()) for name in [*files, *links]]
    return sorted(found)


def _replaceable(path: PurePosixPath, out: Path) -> bool:
    return path == SOURCES_LINK if (out / path).is_symlink() else is_ours(_read(out / path))


def _content(tree: Tree, path: PurePosixPath) -> str:
    content = tree.get(path, "")
    return f"link to {_relative(content, path)}\n" if isinstance(content, Link) else content


def _read(path: Path) -> str:
    """What is there: a file's text, a link's target, "" if nothing."""
    if path.is_symlink():
        return f"link to {path.readlink()}\n"
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _relative(link: Link, at: PurePosixPath) -> str:
    return os.path.relpath(link.target, at.parent)


def _remove_empty(path: Path, out: Path) -> None:
    for folder in path.parents:
        if folder == out or any(folder.iterdir()):
            return
        folder.rmdir()
