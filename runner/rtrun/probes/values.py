"""The canonical values of a hit, made from what the kernel recorded of the arguments."""

from collections.abc import Callable, Mapping

from rtrun.probes.libraries.description import Argument, Bytes, Halves, Named, Reduced, Seconds

Values = dict[str, int | str]


def recorded(arguments: Mapping[str, Argument]) -> dict[str, str]:
    """What the kernel must record of the arguments: the type of each, by its name in the event."""
    types: dict[str, str] = {}
    for name, argument in arguments.items():
        if isinstance(argument, Halves):
            types |= {f"{name}_low": argument.low, f"{name}_high": argument.high}
        elif isinstance(argument, Seconds):
            types |= {f"{name}_s": argument.seconds, f"{name}_ns": argument.nanoseconds}
        else:
            types[name] = argument if isinstance(argument, str) else argument.number
    return types


def converter(arguments: Mapping[str, Argument], constants: Mapping[str, str | int]) -> Callable[[Values], None] | None:
    """The function that turns a probe's recorded values into its canonical ones; None if they are the same.

    The function changes its argument. It leaves out a value that cannot be computed, and raises KeyError if a recorded
    value is missing.
    """
    steps = [step for name, argument in arguments.items() if (step := _step(name, argument)) is not None]
    if not steps and not constants:
        return None

    def convert(values: Values) -> None:
        for step in steps:
            step(values)
        values.update(constants)

    return convert


def _step(name: str, argument: Argument) -> Callable[[Values], None] | None:
    if isinstance(argument, Halves):

        def join(values: Values) -> None:
            both = _number(values.pop(f"{name}_low")) & 0xFFFFFFFF | _number(values.pop(f"{name}_high")) << 32
            # As a signed number.
            values[name] = (both & (1 << 64) - 1 ^ 1 << 63) - (1 << 63)

        return join
    if isinstance(argument, Seconds):

        def add(values: Values) -> None:
            values[name] = _number(values.pop(f"{name}_s")) * 10**9 + _number(values.pop(f"{name}_ns"))

        return add
    if isinstance(argument, Named):
        names = argument.names

        def call(values: Values) -> None:
            word = names.get(_number(values.pop(name)))
            if word is not None:
                values[name] = word

        return call
    if isinstance(argument, Reduced):
        less = argument.less

        def reduce(values: Values) -> None:
            number = _number(values.pop(name))
            if number >= less:
                values[name] = number - less

        return reduce
    if isinstance(argument, Bytes):
        at, size_name = argument.at, argument.of

        def cut(values: Values) -> None:
            bits = 8 * min(8, max(0, _number(values.get(size_name, 0)) - at))
            values[name] = _number(values[name]) & (1 << bits) - 1

        return cut
    return None


def _number(value: int | str) -> int:
    if not isinstance(value, int):
        raise ValueError(f"expected a number, got the text {value[:40]!r}")
    return value
