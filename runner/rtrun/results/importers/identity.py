"""What files of other programs do not say: on which board, kernel and boot they were measured, and when."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from hashlib import sha256
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.results.record import UNKNOWN, TargetFacts, moment

_FIELD = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Identity:
    """Where and when a file was measured; "" where that is not known. `start` is an ISO 8601 time."""

    board: str = ""
    kernel: str = ""
    boot: str = ""
    start: str = ""

    @property
    def start_time(self) -> str:
        """The begin of the run as run.json has it. Raises UsageError for what is no time."""
        if not self.start:
            return UNKNOWN
        try:
            moment(self.start)
            return datetime.fromisoformat(self.start).isoformat()
        except ValueError as error:
            raise UsageError(
                f"--start: {self.start!r} is no time, as 2026-11-23 or 2026-11-23T10:00:00+01:00"
            ) from error


FIELDS = tuple(field.name for field in fields(Identity))


def read_pattern(pattern: str) -> Callable[[Path], Mapping[str, str]]:
    """What reads fields from file names: ``{board}-{kernel}-{start}.txt``.

    A field is as short as it can be, and the pattern is of the whole name. What is returned raises UsageError for a
    name that does not match. Raises UsageError for an unknown field, or one that stands twice.
    """
    names = _FIELD.findall(pattern)
    for name in names:
        if name not in FIELDS or names.count(name) > 1:
            raise UsageError(f"--names: {{{name}}}: a field once each of {', '.join(f'{{{each}}}' for each in FIELDS)}")
    parts = _FIELD.split(pattern)
    words = [f"(?P<{part}>.+?)" if place % 2 else re.escape(part) for place, part in enumerate(parts)]
    compiled = re.compile("".join(words))

    def read(path: Path) -> Mapping[str, str]:
        match = compiled.fullmatch(path.name)
        if match is None:
            raise UsageError(f"{path}: its name is not {pattern}, as --names says")
        return match.groupdict()

    return read


def target_facts(identity: Identity, path: Path) -> TargetFacts:
    """The target of an imported file. Files of an unknown board are of one board only if they lie in one folder."""
    folder = path.resolve().parent
    unknown = f"{UNKNOWN} ({folder.name}, {sha256(bytes(folder)).hexdigest()[:8]})"
    return TargetFacts(
        name=identity.board or unknown,
        is_identified=bool(identity.board),
        kernel_release=identity.kernel or None,
        boot_id=identity.boot or None,
    )
