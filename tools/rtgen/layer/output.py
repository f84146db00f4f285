"""Compare a rendering with a folder, and write it there without changing files that rtgen did not render."""

import difflib
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rtfiles import atomic
from rtfiles.errors import UsageError
from rtgen.checkout import shipped
from rtgen.layer.render import SOURCES_LINK, SymbolicLink, Tree, is_ours
from rtgen.profile import LAYER

OWNED = (LAYER,)  # folders with rendered files only


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """The changes from writing a rendering. `linked`: missing folders that became links to those of the checkout."""

    written: int
    removed: tuple[Path, ...]
    linked: tuple[Path, ...]


def prefix_in_git(out: Path) -> str:
    """`out` relative to its git repository, with a slash at the end; "" if it is the top or there is no repository."""
    out = out.resolve()
    for folder in (out, *out.parents):
        if (folder / ".git").exists():
            return "" if folder == out else f"{out.relative_to(folder).as_posix()}/"
    return ""


def differences(tree: Tree, out: Path) -> str:
    """The differences between a folder and the rendering, as a unified diff; "" if there are none."""
    lines: list[str] = []
    for path in sorted({*tree, *_present(out)}):
        name = path.as_posix()
        have, want = _read(out / path), _content(tree, path)
        if have != want:
            before, after = have.splitlines(keepends=True), want.splitlines(keepends=True)
            lines += difflib.unified_diff(before, after, f"{name} (present)", f"{name} (rendered)")
    return "".join(line if line.endswith("\n") else f"{line}\n" for line in lines)


def write(tree: Tree, out: Path) -> Outcome:
    """Write the rendering into a folder. A missing folder that the rendering links to becomes a link to ours.

    Raises UsageError, before anything is written, naming every file in its place that rtgen did not render.
    """
    obstacles = _obstacles(tree, out)
    if obstacles:
        raise UsageError("\n".join(f"{path}: {what}, move it away" for path, what in sorted(obstacles.items())))
    present = _present(out)
    written = 0
    for path, content in tree.items():
        target = out / path
        target.parent.mkdir(parents=True, exist_ok=True)
        # An unchanged file keeps its time stamp, so that BitBake does not parse it again.
        if isinstance(content, SymbolicLink):
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
    linked = [
        link.target for link in tree.values() if isinstance(link, SymbolicLink) and not (out / link.target).exists()
    ]
    for path in linked:
        (out / path).symlink_to(shipped(str(path)))
    return Outcome(written=written, removed=tuple(removed), linked=tuple(out / path for path in linked))


def _obstacles(tree: Tree, out: Path) -> dict[Path, str]:
    """The files that prevent the rendering from being written, each with the reason."""
    targets = [out / path for path in tree]
    obstacles = {out / path: "not rendered by rtgen" for path in _present(out) if not _replaceable(path, out)}
    obstacles |= {
        path: "a folder in the place of a file" for path in targets if path.is_dir() and not path.is_symlink()
    }
    parents = {parent for path in targets for parent in path.parents}
    links = {out / content.target for content in tree.values() if isinstance(content, SymbolicLink)}
    for path in parents | links:
        if os.path.lexists(path) and not path.is_dir():
            obstacles[path] = "not a folder" if path.exists() else "a broken link"
    return obstacles


def _present(out: Path) -> list[PurePosixPath]:
    """Every file and link in the owned folders, kas.yml, and a link in the place of an owned folder."""
    present = [PurePosixPath("kas.yml")] if os.path.lexists(out / "kas.yml") else []
    for owned in OWNED:
        if (out / owned).is_symlink():
            present.append(PurePosixPath(owned))
            continue
        for folder, folders, files in os.walk(out / owned):
            links = [name for name in folders if (Path(folder) / name).is_symlink()]
            present += [PurePosixPath((Path(folder) / name).relative_to(out).as_posix()) for name in [*files, *links]]
    return sorted(present)


def _replaceable(path: PurePosixPath, out: Path) -> bool:
    return path == SOURCES_LINK if (out / path).is_symlink() else is_ours(_read(out / path))


def _content(tree: Tree, path: PurePosixPath) -> str:
    content = tree.get(path, "")
    return f"link to {_relative(content, path)}\n" if isinstance(content, SymbolicLink) else content


def _read(path: Path) -> str:
    """A file's text, or a line with a link's target; "" if there is neither."""
    if path.is_symlink():
        return f"link to {path.readlink()}\n"
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _relative(link: SymbolicLink, at: PurePosixPath) -> str:
    return os.path.relpath(link.target, at.parent)


def _remove_empty(path: Path, out: Path) -> None:
    for folder in path.parents:
        if folder == out or any(folder.iterdir()):
            return
        folder.rmdir()
