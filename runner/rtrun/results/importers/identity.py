"""The board, kernel, boot and time of another program's file, as the user and the file state them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.results.importers.origin import NOWHERE, FileOrigin
from rtrun.results.record import UNKNOWN, TargetFacts, moment

_FIELD = re.compile(r"\{([^{}]*)\}")
_DATE = r"[0-9]{4}-?[0-9]{2}-?[0-9]{2}"
# Any other field may contain the characters that separate fields: a kernel is 6.6.30-rt30.
_FORMS = {"start": rf"{_DATE}(?:[T ][0-9:.]+(?:Z|[+-][0-9:]+)?)?"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Identity:
    """Where and when a file was measured; "" where it is not known. `start` is an ISO 8601 time."""

    board: str = ""
    kernel: str = ""
    boot: str = ""
    start: str = ""

    @property
    def start_time(self) -> str:
        """The begin of the run as run.json has it. Raises UsageError for a text that is not a time."""
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


@dataclass(frozen=True, kw_only=True, slots=True)
class NamePattern:
    """Reads fields from file names: ``{board}-{kernel}-{start}.txt``, or with folders ``{board}/{start}.txt``.

    It must match the whole name, and as many folders above it as it has itself. A field is as short as possible.
    """

    text: str
    form: re.Pattern[str]

    def read(self, path: Path) -> Mapping[str, str]:
        """The fields in a file's name. Raises UsageError for a name that does not match."""
        match = self.form.fullmatch("/".join(self._parts(path)))
        if match is None:
            raise UsageError(f"{path}: its name is not {self.text}, as --names says")
        return match.groupdict()

    def name_of(self, path: Path) -> str:
        """The name of a file's run, with its folders: files in different folders may share a name."""
        return "-".join([*self._parts(path)[:-1], path.stem])

    def _parts(self, path: Path) -> Sequence[str]:
        return path.resolve().parts[-1 - self.text.count("/") :]


def read_pattern(pattern: str) -> NamePattern:
    """Read a pattern. Raises UsageError for an unknown field, or one that occurs twice."""
    names = _FIELD.findall(pattern)
    for name in names:
        if name not in FIELDS or names.count(name) > 1:
            raise UsageError(f"--names: {{{name}}}: a field once each of {', '.join(f'{{{word}}}' for word in FIELDS)}")
    parts = _FIELD.split(pattern)
    words = [
        f"(?P<{part}>{_FORMS.get(part, '[^/]+?')})" if place % 2 else re.escape(part)
        for place, part in enumerate(parts)
    ]
    return NamePattern(text=pattern, form=re.compile("".join(words)))


def target_facts(identity: Identity, path: Path, origin: FileOrigin = NOWHERE) -> TargetFacts:
    """The target of an imported file. Files of an unknown board share a board only if they lie in one folder.

    They must then also name one host; a host alone does not identify a board, as many are called localhost or
    raspberrypi. Raises UsageError for a kernel that is not the one that the file states.
    """
    folder = path.resolve().parent
    unknown = f"{origin.host or UNKNOWN} ({folder.name}, {sha256(bytes(folder)).hexdigest()[:8]})"
    if identity.kernel and origin.kernel_release and identity.kernel != origin.kernel_release:
        raise UsageError(
            f"{path}: its kernel is {origin.kernel_release}, but --kernel or --names says {identity.kernel}"
        )
    return TargetFacts(
        name=identity.board or unknown,
        is_identified=bool(identity.board),
        preempt_rt=origin.preempt_rt,
        kernel_release=identity.kernel or origin.kernel_release,
        kernel_version=origin.kernel_version,
        machine=origin.machine,
        boot_id=identity.boot or None,
    )


def times(identity: Identity, path: Path, origin: FileOrigin) -> tuple[str, str]:
    """Begin and end of the run, as run.json has them: as the file states, else the begin that the user names.

    Raises UsageError for a begin on another day than the file states.
    """
    given, start = identity.start_time, origin.start
    if start is None:
        return given, origin.end.isoformat() if origin.end else given
    day = given.partition("T")[0]
    if identity.start and day not in {start.date().isoformat(), start.astimezone(UTC).date().isoformat()}:
        raise UsageError(f"{path}: it was begun at {start.isoformat()}, but --start or --names says {given}")
    return start.isoformat(), (origin.end or start).isoformat()
