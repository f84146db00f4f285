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


def imports(package: ModuleType) -> dict[str, set[str]]:
    """The modules of a package that each of its modules imports, wherever in it the import stands."""
    top = Path(str(package.__file__)).parent
    paths = {".".join(path.relative_to(top.parent).with_suffix("").parts): path for path in top.rglob("*.py")}
    return {
        name: {
            module
            for imported in _imported(path)
            for module in (imported, imported.rpartition(".")[0])
            if module in paths
        }
        for name, path in paths.items()
    }


def _imported_rooms(package: ModuleType, path: Path) -> Iterator[str]:
    yield from (name.split(".")[1] for name in _imported(path) if name.startswith(f"{package.__name__}."))


def _imported(path: Path) -> Iterator[str]:
    """The full names of what a module imports: of modules, or of what is in them."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
