"""Config files of the kernel: fragments, defconfigs and finished .config files, read line by line."""

import re
import zlib
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import MIB, read_bytes

# A finished .config of an ARM kernel has 200 kB.
CONFIG_BYTES_MAX = 4 * MIB  #: a kernel configuration, unpacked
_GZIP_WBITS = 31  # for zlib.decompressobj

_SET = re.compile(r'CONFIG_(\w+)=([ymn]|-?\d+|0x[0-9a-fA-F]+|"(?:[^"\\]|\\.)*")')
_UNSET = re.compile(r"# CONFIG_(\w+) is not set")
# A comment that means "not set" but that the kernel ignores.
_NEARLY_UNSET = re.compile(r"#\s*(CONFIG_)?[A-Z0-9_]+ (is )?not set\b")
_EXPANDED = re.compile(r"# Automatically generated file; DO NOT EDIT|CONFIG_CC_VERSION_TEXT=")
_HEAD = re.compile(r"# Linux/(\w+) ([0-9]{1,4}\.[0-9]{1,4})\S* Kernel Configuration")


@dataclass(frozen=True, slots=True)
class Line:
    """A symbol, its value (``n``: not set), and the number of its line."""

    symbol: str
    value: str
    number: int


def read_text(path: Path) -> str:
    """The text of a config file, decompressed if it is gzip (as ``/proc/config.gz``). Raises UsageError."""
    data = read_bytes(path, max_bytes=CONFIG_BYTES_MAX)
    try:
        if data[:2] == b"\x1f\x8b":
            unpacking = zlib.decompressobj(_GZIP_WBITS)
            data = unpacking.decompress(data, CONFIG_BYTES_MAX)
            if unpacking.unconsumed_tail:
                raise UsageError(f"{path}: larger than {CONFIG_BYTES_MAX} bytes when unpacked")
            if not unpacking.eof:
                raise zlib.error("cut off")
        return data.decode("utf-8")
    except (zlib.error, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: neither a text nor a whole gzip file") from error


def parse(text: str, origin: str) -> tuple[Line, ...]:
    """Read every setting. Raises UsageError, with file and line, for a line that the kernel would ignore."""
    lines = []
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.rstrip()
        if match := _SET.fullmatch(line):
            lines.append(Line(match[1], match[2], number))
        elif match := _UNSET.fullmatch(line):
            lines.append(Line(match[1], "n", number))
        elif line and (not line.startswith("#") or _NEARLY_UNSET.match(line)):
            raise UsageError(
                f"{origin}:{number}: {line[:80]!r} is not a config line, "
                "write CONFIG_NAME=value, # CONFIG_NAME is not set, or a # comment"
            )
    return tuple(lines)


def parse_fragment(text: str, origin: str) -> tuple[Line, ...]:
    """Like `parse`, for a file that may name a symbol only once."""
    first: dict[str, int] = {}
    lines = parse(text, origin)
    for line in lines:
        if line.symbol in first:
            raise UsageError(
                f"{origin}:{line.number}: CONFIG_{line.symbol} is given twice, "
                f"first in line {first[line.symbol]}: keep one"
            )
        first[line.symbol] = line.number
    return lines


def parse_defconfig(text: str, origin: str) -> tuple[Line, ...]:
    """Like `parse`, for a defconfig. A finished .config is refused: it sets every symbol before the fragment can."""
    for number, line in enumerate(text.splitlines(), 1):
        if _EXPANDED.match(line):
            raise UsageError(
                f"{origin}:{number}: this is a finished .config, not a defconfig; make one with `make savedefconfig`"
            )
    return parse(text, origin)


def kernel_of(text: str) -> str | None:
    """The version (``6.1``) in the head of a finished .config."""
    for line in text.splitlines()[:5]:
        if match := _HEAD.match(line):
            return match[2]
    return None


def values(lines: tuple[Line, ...]) -> dict[str, str]:
    """The value of each symbol. Of two values the later one counts, as in the kernel."""
    return {line.symbol: line.value for line in lines}
