"""Render fragments from the data; the same data give the same bytes."""

import textwrap
from pathlib import Path

from rtfiles.errors import UsageError
from rtgen.kconfig.data import Data
from rtgen.kconfig.tree import ARCHITECTURES


def fragment_path(data: Data, machine: str, kernel: str) -> Path:
    """The path of the committed fragment of a machine and kernel."""
    return data.folder / "fragments" / f"{machine}-{kernel}.cfg"


def render(data: Data, machine: str, kernel: str) -> str:
    """The fragment of a machine for a kernel version.

    Raises UsageError when either is unknown, or when the kernel is too old for a fragment of the machine.
    """
    series = data.rt_series(machine, kernel)
    if kernel not in data.kernels_of(machine):
        raise UsageError(f"{machine} has fragments from kernel {data.machine(machine).since} on, not for {kernel}")
    title = ARCHITECTURES[data.machine(machine).architecture].title
    needs = (
        f"On {title} this kernel has PREEMPT_RT only with the patch series {series}."
        if series
        else f"Mainline has PREEMPT_RT for {title}: no patch series is needed."
    )
    lines = [
        f"# {machine}, Linux {kernel}: {data.machine(machine).summary}.",
        *_comment(needs),
        "# Rendered from kconfig/options by `rtgen kconfig render`: change the options, not this file.",
    ]
    for concern, options in data.options(machine, kernel).items():
        if not options:
            continue
        lines += ["", f"# {concern}: {data.concerns[concern].summary}"]
        for option in options:
            lines += _comment(f"{option.reason} [{option.source}]")
            lines.append(config_line(option.symbol, str(option.value)))
    return "\n".join(lines) + "\n"


def config_line(symbol: str, value: str) -> str:
    """A symbol and its value as a line of a config file."""
    return f"# CONFIG_{symbol} is not set" if value == "n" else f"CONFIG_{symbol}={value}"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(
        text, 118, initial_indent="# ", subsequent_indent="#   ", break_long_words=False, break_on_hyphens=False
    )
