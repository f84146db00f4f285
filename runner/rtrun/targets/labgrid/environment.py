"""labgrid's own environment file: what it says about the places that it names."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtfiles.config import read_yaml
from rtfiles.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class Environment:
    """What labgrid's own environment file says about the places that it names."""

    path: Path | None = None
    coordinator: str | None = None
    keys: Mapping[str, Path | None] = field(default_factory=dict)
    """By place: the private key file of its SSHDriver."""
    powered: frozenset[str] = frozenset()
    """Places with a power driver."""


def read_environment(path: Path) -> Environment:
    """Read labgrid's environment file. Raises UsageError when it names no RemotePlace."""
    data = read_yaml(path)
    targets = data.get("targets") if isinstance(data, dict) else None
    keys: dict[str, Path | None] = {}
    powered = set()
    for target in targets.values() if isinstance(targets, dict) else ():
        drivers = dict(entries(target, "drivers"))
        key = drivers.get("SSHDriver", {}).get("keyfile")
        for kind, values in entries(target, "resources"):
            if kind == "RemotePlace" and isinstance(name := values.get("name"), str):
                keys[name] = path.parent / Path(key).expanduser() if isinstance(key, str) and key else None
                if any("Power" in driver for driver in drivers):
                    powered.add(name)
    if not keys:
        raise UsageError(f"{path}: names no RemotePlace under targets: it is to be an environment file of labgrid")
    options = data.get("options") if isinstance(data, dict) else None
    coordinator = options.get("coordinator_address") if isinstance(options, dict) else None
    return Environment(
        path=path,
        coordinator=coordinator if isinstance(coordinator, str) else None,
        keys=keys,
        powered=frozenset(powered),
    )


def entries(target: Any, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the resources or drivers of a target, which labgrid takes as a mapping or as a list of mappings."""
    entries = target.get(section) if isinstance(target, dict) else None
    for mapping in entries if isinstance(entries, list) else [entries]:
        for kind, values in mapping.items() if isinstance(mapping, dict) else ():
            yield str(kind), values if isinstance(values, dict) else {}
