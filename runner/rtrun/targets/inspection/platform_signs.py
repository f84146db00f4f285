"""Whether a target is a virtual or an emulated machine, by signs on it: platform_signs.yml."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from rtfiles.config import Config, load_own
from rtfiles.output import printable
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.inspection.platform import KnownPlatform, Platform, weakest
from rtrun.targets.link import Link

DATA = Path(__file__).with_suffix(".yml")
SCRIPT = ON_TARGET / "platform.sh"
NO_SIGN = "no sign of a virtual machine"
# How much of platform.sh's output is read, as a target may make it as long as it likes, and how much is shown.
LINES_MAX = 200  #: lines searched for signs of a virtual machine
LINE_CHARACTERS_MAX = 400  #: characters of such a line
SHOWN_LINES = 4
SHOWN_CHARACTERS = 80


class Sign(Config):
    """A hypervisor, and the expressions to search for in the lines of platform.sh.

    The sign does not count if signs of the hypervisor `unless` are seen.
    """

    hypervisor: str
    platform: Annotated[Platform, Field(strict=False)]
    unless: str | None = None
    lines: list[str]


class Signs(Config):
    """platform_signs.yml."""

    schema_: Literal[1] = Field(alias="schema")
    signs: list[Sign]


def read_signs() -> list[Sign]:
    """Read platform_signs.yml."""
    return load_own(DATA, Signs).signs


def find_platform(link: Link) -> KnownPlatform:
    """Find out what the target is, by asking it unless that is known already. Raises as `Link.check` does."""
    if link.target.known_platform is not None:
        return link.target.known_platform
    return judge(link.check(["sh", "-s"], stdin=SCRIPT.read_text(encoding="utf-8")).splitlines(), read_signs())


def judge(lines: Sequence[str], signs: Sequence[Sign]) -> KnownPlatform:
    """Judge what platform.sh printed."""
    lines = [line[:LINE_CHARACTERS_MAX] for line in lines[:LINES_MAX]]
    seen = {sign.hypervisor: matching for sign in signs if (matching := _matching(sign, lines))}
    telling = [sign for sign in signs if sign.hypervisor in seen and sign.unless not in seen]
    if not telling:
        return KnownPlatform(platform=Platform.HARDWARE, evidence=NO_SIGN)
    evidence = ", ".join(f"{sign.hypervisor} ({'; '.join(seen[sign.hypervisor])})" for sign in telling)
    return KnownPlatform(platform=weakest(sign.platform for sign in telling), evidence=evidence)


def _matching(sign: Sign, lines: Sequence[str]) -> list[str]:
    matching = [line for line in lines if any(re.search(expression, line) for expression in sign.lines)]
    return [printable(line[:SHOWN_CHARACTERS]).strip() for line in dict.fromkeys(matching)][:SHOWN_LINES]
