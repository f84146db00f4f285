"""Times and probabilities in texts. `rtrun --help` imports this module, so it imports little."""

import re

_UNITS_NS = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "min": 60_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
    "w": 604_800_000_000_000,
}
_TIME = re.compile(rf"([0-9]{{1,15}}(?:\.[0-9]{{1,9}})?)\s?({'|'.join(_UNITS_NS)})", re.ASCII)
FOREVER = "forever"
# Nobody waits longer than 30 years for an answer, and 64 bits still hold that time in nanoseconds.
_TIME_MAX_NS = 30 * 365 * 24 * _UNITS_NS["h"]


def read_time_ns(text: object) -> int:
    """Read a time with its unit, such as ``400us``, ``1.5ms``, ``8h`` or ``90d``, into ns. Raises ValueError."""
    parts = _TIME.fullmatch(text) if isinstance(text, str) else None
    time_ns = round(float(parts[1]) * _UNITS_NS[parts[2]]) if parts else 0
    if not 0 < time_ns <= _TIME_MAX_NS:
        raise ValueError(
            f"{str(text)[:40]!r} is no time above 0 with its unit ({', '.join(_UNITS_NS)}), as 400us or 8h"
        )
    return time_ns


# The longest interval between two wake-ups of a thread; with longer ones a day measures nothing.
INTERVAL_MAX_US = 60_000_000


def whole_interval_us(time_ns: int) -> int:
    """A time in whole microseconds, at most 60s. Raises ValueError."""
    interval_us, rest = divmod(time_ns, 1000)
    if rest or interval_us > INTERVAL_MAX_US:
        raise ValueError(f"{time_text(time_ns)} is no whole number of microseconds up to 60s, as 200us or 1ms")
    return interval_us


def read_days(text: object) -> int | None:
    """Read a time that is a whole number of days, as ``90d`` or ``12w``; None: ``forever``. Raises ValueError."""
    if text == FOREVER:
        return None
    try:
        days, rest = divmod(read_time_ns(text), _UNITS_NS["d"])
    except ValueError as error:
        raise ValueError(f"{error}, nor {FOREVER!r}") from None
    if rest:
        raise ValueError(f"{str(text)[:40]!r} is not a whole number of days, as 90d, 12w or {FOREVER!r}")
    return days


def time_text(time_ns: int) -> str:
    """A time as a whole number in the largest possible unit, as `read_time_ns` reads it."""
    unit, unit_ns = max(((name, ns) for name, ns in _UNITS_NS.items() if not time_ns % ns), key=lambda pair: pair[1])
    return f"{time_ns // unit_ns}{unit}"


_SIZES = {"B": 1, "kB": 10**3, "MB": 10**6, "KiB": 2**10, "MiB": 2**20}
_SIZE = re.compile(r"([0-9]{1,9}) ?(B|kB|MB|KiB|MiB)", re.ASCII)
SIZE_BYTES_MAX = 2**28  #: a message of a topology, and what a node touches at once; boards have more memory


def read_size_bytes(value: object) -> int:
    """Read a size with its unit, as ``100kB``, or a whole number of bytes. Raises ValueError."""
    parts = _SIZE.fullmatch(value) if isinstance(value, str) else None
    size = int(parts[1]) * _SIZES[parts[2]] if parts else value
    if not isinstance(size, int) or isinstance(size, bool) or not 0 <= size <= SIZE_BYTES_MAX:
        raise ValueError(
            f"{str(value)[:40]!r} is no size up to 256 MiB: a number of bytes, or with its unit ({', '.join(_SIZES)})"
        )
    return size


def size_text(size_bytes: int) -> str:
    """A size as a whole number in the largest possible unit, as `read_size_bytes` reads it."""
    whole = (unit for unit in ("MiB", "MB", "KiB", "kB") if size_bytes and not size_bytes % _SIZES[unit])
    unit = next(whole, "B")
    return f"{size_bytes // _SIZES[unit]} {unit}"


def read_probability(value: object) -> float:
    """Read a probability, both ends excluded. Raises ValueError."""
    # YAML 1.1 reads 1e-6 as a text, because it has no point.
    try:
        number = float(value) if isinstance(value, str | float) else -1.0
    except ValueError:
        number = -1.0
    if not 0 < number < 1:
        raise ValueError(f"{str(value)[:40]!r} is no number between 0 and 1, as 1e-6 or 0.95")
    return number


def read_share(value: object) -> float:
    """Read a share, as ``5%`` or 0.05, both ends excluded. Raises ValueError."""
    try:
        if isinstance(value, str) and value.endswith("%"):
            return read_probability(float(value.removesuffix("%")) / 100)
        return read_probability(value)
    except ValueError:
        raise ValueError(f"{str(value)[:40]!r} is no share between 0 and 1, as 5% or 0.05") from None
