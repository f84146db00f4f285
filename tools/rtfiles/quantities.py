"""Numbers with their units, as text for people: the same form on the screen and on a page."""

import math
from collections.abc import Callable

_UNITS = ((1e9, "s"), (1e6, "ms"), (1e3, "us"), (1.0, "ns"))


def time(value_ns: float | None) -> str:
    """A time in a suitable unit, with four digits, fewer where they are exact; a dash if there is none."""
    if value_ns is None or not math.isfinite(value_ns):
        return "-"
    if not value_ns:
        return "0 us"
    size = abs(value_ns) * (1 + 5e-5)  # a size that rounds up to the next unit is written in that unit
    unit_ns, unit = next((pair for pair in _UNITS if size >= pair[0]), _UNITS[-1])
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


def one_in(share: float) -> str:
    """A share below 1 as so many in a round number, as "3 in 1 000": its first three digits."""
    digits, _, exponent = f"{share:.2e}".partition("e")
    most = digits.rstrip("0").rstrip(".")
    size = len(most.partition(".")[2]) - int(exponent)
    return f"{most.replace('.', '')} in {_power_of_ten(size)}"


def at_most_in(share: float) -> str:
    """A share as `one_in`, rounded up to one digit, or two where one would be more than a third too high."""
    rounded = _one_digit(share, math.ceil)
    return one_in(rounded) if rounded < 1 else "all"


def at_least_in(share: float) -> str:
    """A share as `one_in`, rounded down to one digit, or two where one would be more than a third too low."""
    return one_in(_one_digit(share, math.floor)) if share < 1 else "all"


def rounded_up(share: float) -> str:
    """A share to two digits, no lower than it is."""
    return f"{_to_digits(share, 1, math.ceil):.2g}" if share else "0"


def rounded_down(share: float) -> str:
    """A share to two digits, no higher than it is."""
    return f"{_to_digits(share, 1, math.floor):.2g}" if share else "0"


def between(low: float, high: float) -> str:
    """An interval of shares to two digits, no narrower than it is."""
    return f"{rounded_down(low)} to {rounded_up(high)}"


def percent_at_most(share: float) -> str:
    """A share as `percent`, no lower than it is."""
    return percent(min(1.0, _to_digits(share, 1 if share < 0.985 else 3, math.ceil)) if share else share)


def _one_digit(share: float, rounded: Callable[[float], int]) -> float:
    return _to_digits(share, 0 if share / 10.0 ** math.floor(math.log10(share)) >= 3 else 1, rounded)


def _to_digits(share: float, digits: int, rounded: Callable[[float], int]) -> float:
    exponent = math.floor(math.log10(share))
    # What is exact but for its binary form is not rounded to the next digit.
    whole = rounded(float(f"{share * 10.0 ** (digits - exponent):.9g}"))
    return whole * 10.0 ** (exponent - digits)


def _power_of_ten(exponent: int) -> str:
    if exponent < 6:
        return grouped(10**exponent)
    number, word = (10 ** (exponent - 6), "million") if exponent < 9 else (10 ** (exponent - 9), "billion")
    return f"a {word}" if number == 1 else f"{grouped(number)} {word}"


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
