"""Numbers with their units, as text for people: the same form on the screen and on a page."""

import math

_UNITS = ((1e9, "s"), (1e6, "ms"), (1e3, "us"), (1.0, "ns"))


def time(value_ns: float | None) -> str:
    """A time in a suitable unit, with four digits, fewer where they are exact; a dash if there is none."""
    if value_ns is None or not math.isfinite(value_ns):
        return "-"
    if not value_ns:
        return "0 us"
    size = abs(value_ns) * (1 + 5e-5)  # a size that rounds up to the next unit is written in that unit
    unit_ns, unit = next((one for one in _UNITS if size >= one[0]), _UNITS[-1])
    value = value_ns / unit_ns
    text = f"{value:.{min(3, max(0, 3 - math.floor(math.log10(size / unit_ns))))}f}"
    if "." in text and float(text) == value:
        text = text.rstrip("0").rstrip(".")
    return f"{text} {unit}"


def signed(value_ns: float) -> str:
    """A difference of two times, with its sign."""
    return f"{'+' if value_ns >= 0 else ''}{time(value_ns)}"


def percent(share: float) -> str:
    """A share in percent to two digits; close to 100 % to four, as two would show 100 %."""
    of_hundred = 100 * share
    return f"{of_hundred:.{2 if of_hundred < 98.5 else 4}g} %"


def grouped(number: float) -> str:
    """An integer, or the nearest one, with spaces between its thousands."""
    return f"{round(number):,}".replace(",", " ")


def duration(seconds: float) -> str:
    """A time in its two largest units."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours >= 48:
        return f"{hours // 24} d {hours % 24} h"
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {rest:02} s" if minutes else f"{rest} s"
