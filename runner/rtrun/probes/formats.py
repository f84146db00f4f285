"""The kernel's description of a trace event, and how an event's values are read with it.

tracefs has a file `format` for each event: the name, offset, size and sign of each of its fields. The file comes from a
target, and so do the events.
"""

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rtfiles.untrusted import whole_number

FIELDS_MAX = 200  #: fields of an event of the kernel's trace
EVENT_BYTES_MAX = 65536  #: such an event
PAGE_BYTES_MAX = 65536  #: a page of such events: the largest that Linux has where there are probes
_FIELD = re.compile(
    r"\s*field:([^;]{1,200}?)\s*(\w{1,64})(\[[^\];]{0,40}\])?;\s*offset:(\d{1,5});\s*size:(\d{1,5});\s*signed:([01]);",
    re.ASCII,
)
_CODES = {1: "bB", 2: "hH", 4: "iI", 8: "qQ"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Field:
    """A field of an event."""

    name: str
    offset: int
    size: int
    code: str
    """The format for the module struct."""
    is_text: bool = False
    """Bytes up to the first NUL."""
    is_dynamic: bool = False
    """A text elsewhere in the event: this number has its offset in the lower 16 bits, its length in the upper 16."""
    is_relative: bool = False
    """Of a dynamic field: the offset counts from the end of this field."""
    is_rest: bool = False
    """A text that goes on to the end of the event."""

    def is_of(self, kind: str) -> bool:
        """Whether the kernel makes such a field for a probe's argument of this type: u64, s32, x8, string."""
        if kind == "string":
            return self.is_dynamic
        return not self.is_dynamic and self.code == _CODES[int(kind[1:]) // 8][0 if kind[0] == "s" else 1]


class EventFormat:
    """How to read the values of an event. Raises ValueError for a text that is no `format` file.

    `types` are the types, as tracefs calls them, of the values that a probe was to record: only these values are read,
    and the format must have each of them with its type. Without `types` all values are read.
    """

    __slots__ = ("_dynamic", "_names", "_struct", "_texts", "fields", "identifier", "name", "size_bytes")

    def __init__(self, text: str, types: Mapping[str, str] | None = None) -> None:
        name = re.search(r"^name: (\w{1,64})$", text, re.MULTILINE | re.ASCII)
        identifier = re.search(r"^ID: (\d{1,5})$", text, re.MULTILINE | re.ASCII)
        if name is None or identifier is None:
            raise ValueError("no format of an event: it lacks 'name:' or 'ID:'")
        self.name = name[1]
        self.identifier = int(identifier[1])
        lines = [line for line in text.splitlines() if line.lstrip().startswith("field:")]
        if len(lines) > FIELDS_MAX:
            raise ValueError(f"the format of {self.name} has more than {FIELDS_MAX} fields")
        by_name = {field.name: field for field in map(_field, lines)}
        fields = sorted(by_name.values(), key=lambda field: field.offset)
        self.fields = tuple(fields)
        if (by_name["common_pid"].offset, by_name["common_pid"].size) != (4, 4) if "common_pid" in by_name else True:
            raise ValueError(f"the format of {self.name} is not that of a kernel known here: it has no pid at 4")
        # Fields with two underscores: where the kernel put a probe.
        own = [field for field in fields if not field.name.startswith(("common_", "__"))]
        if types is not None:
            own = [field for field in own if field.name in types]
            for value, kind in types.items():
                if value not in by_name or not by_name[value].is_of(kind):
                    raise ValueError(f"the format of {self.name} has no field {value} that is a {kind}")
        code, end = "<", 0
        for field in (field for field in own if not field.is_rest):
            if field.offset < end:
                raise ValueError(f"in the format of {self.name} the field {field.name} overlaps another")
            code += f"{field.offset - end}x{field.code}"
            end = field.offset + field.size
        self._struct = struct.Struct(code)
        self.size_bytes = max(end, 8)
        self._names = tuple(field.name for field in own if not field.is_rest)
        self._texts = tuple(field.name for field in own if field.is_text)
        self._dynamic = tuple(field for field in own if field.is_dynamic or field.is_rest)

    def values(self, page: bytes, start: int, size_bytes: int) -> dict[str, int | str]:
        """The values of the event at `start` in a page.

        Raises ValueError if the event lacks one of its fields, or if its texts together are longer than the event: many
        fields could name the same text.
        """
        if size_bytes < self.size_bytes:
            raise ValueError(f"an event {self.name} of {size_bytes} bytes; its fields take {self.size_bytes}")
        values = dict(zip(self._names, self._struct.unpack_from(page, start), strict=True))
        for name in self._texts:
            values[name] = values[name].partition(b"\0")[0].decode("utf-8", "replace")
        left_bytes = size_bytes
        for field in self._dynamic:
            if field.is_rest:
                begin, length = field.offset, size_bytes - field.offset
            else:
                begin, length = values[field.name] & 0xFFFF, values[field.name] >> 16
                if field.is_relative:
                    begin += field.offset + field.size
            if begin + length > size_bytes:
                raise ValueError(f"an event {self.name} whose text {field.name} goes beyond its {size_bytes} bytes")
            left_bytes -= length
            if left_bytes < 0:
                raise ValueError(f"an event {self.name} whose texts together are longer than its {size_bytes} bytes")
            text = page[start + begin : start + begin + length]
            values[field.name] = text.partition(b"\0")[0].decode("utf-8", "replace")
        return values


class RawValues(Mapping[str, int | str]):
    """The values of an event in a page, decoded when one is asked for: most kernel events are never decoded.

    Decoding raises ValueError as `EventFormat.values` does.
    """

    __slots__ = ("_decoded", "_format", "_page", "_size_bytes", "_start")

    def __init__(self, event: EventFormat, page: bytes, start: int, size_bytes: int) -> None:
        self._format, self._page, self._start, self._size_bytes = event, page, start, size_bytes
        self._decoded: dict[str, int | str] | None = None

    def _values(self) -> dict[str, int | str]:
        if self._decoded is None:
            page, start = self._page, self._start
            self._decoded = self._format.values(page, start, self._size_bytes)
            self._decoded |= {"common_flags": page[start + 2], "common_preempt_count": page[start + 3]}
        return self._decoded

    def __getitem__(self, key: str) -> int | str:
        return self._values()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values())

    def __len__(self) -> int:
        return len(self._values())


def _field(line: str) -> Field:
    match = _FIELD.match(line)
    if match is None:
        raise ValueError(f"no field of an event: {line.strip()[:80]!r}")
    kind, name, array = match[1], match[2], match[3]
    offset, size, is_signed = int(match[4]), int(match[5]), match[6] == "1"
    if offset + size > EVENT_BYTES_MAX:
        raise ValueError(f"the field {name} at {offset} is of no event")
    if kind.startswith(("__data_loc", "__rel_loc")):
        if size != 4:
            raise ValueError(f"the field {name} is a text elsewhere, and takes {size} bytes in place of 4")
        is_relative = kind.startswith("__rel_loc")
        return Field(name=name, offset=offset, size=4, code="I", is_dynamic=True, is_relative=is_relative)
    if array is not None and size == 0:
        return Field(name=name, offset=offset, size=0, code="", is_rest=True)
    if array is None and size in _CODES:
        return Field(name=name, offset=offset, size=size, code=_CODES[size][0 if is_signed else 1])
    return Field(name=name, offset=offset, size=size, code=f"{size}s", is_text=True)


def subbuffer_bytes(header_page: str) -> tuple[int, int, int]:
    """Read the file header_page: the bytes of a page, the bytes of the field `commit`, and where the events begin.

    Raises ValueError for any other text.
    """
    fields = {field.name: field for field in map(_field, filter(str.strip, header_page.splitlines()))}
    try:
        commit, data = fields["commit"], fields["data"]
    except KeyError as error:
        raise ValueError(f"header_page has no field {error}") from None
    size_bytes = data.offset + data.size
    if commit.offset != 8 or commit.size not in (4, 8) or data.offset != 8 + commit.size:
        raise ValueError("header_page is not that of a kernel known here")
    whole_number(str(size_bytes), lowest=1024, highest=PAGE_BYTES_MAX)
    return size_bytes, commit.size, data.offset
