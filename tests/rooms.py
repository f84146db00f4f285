"""Which room of a package a module stands in, and which rooms it imports from."""

import ast
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType


def modules_of_rooms(package: ModuleType) -> dict[str, list[Path]]:
    """The modules of each room: the first part of their path below the package."""
    top = Path(str(package.__file__)).parent
    rooms: dict[str, list[Path]] = {}
    for path in top.rglob("*.py"):
        if path != top / "__init__.py":
            rooms.setdefault(path.relative_to(top).parts[0].removesuffix(".py"), []).append(path)
    return rooms


def find_late_imports(package: ModuleType, rooms: Sequence[str], room: str) -> list[str]:
    """Imports of a room from those after it in `rooms`, as ``path: room``."""
    late = rooms[rooms.index(room) + 1 :]
    modules = modules_of_rooms(package)[room]
    return [f"{path}: {name}" for path in modules for name in _imported_rooms(package, path) if name in late]


def _imported_rooms(package: ModuleType, path: Path) -> Iterator[str]:
    """The rooms that a module imports from, wherever in the module the import stands."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from (name.split(".")[1] for name in names if name.startswith(f"{package.__name__}."))
