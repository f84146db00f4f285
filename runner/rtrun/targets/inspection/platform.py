"""What a measurement ran on: a real, a virtual or an emulated machine."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Platform(StrEnum):
    """What measured times mean on such a machine, the strongest statement first.

    HARDWARE: they are the times of the machine. VIRTUAL: the clock is real but CPUs are shared, so they hold for this
    virtual machine on this host. EMULATED: nothing, because a program plays the processor.
    """

    HARDWARE = "hardware"
    VIRTUAL = "virtual"
    EMULATED = "emulated"

    @property
    def machine(self) -> str:
        """Its name in a sentence."""
        return {"hardware": "hardware", "virtual": "a virtual machine", "emulated": "an emulated board"}[self]


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPlatform:
    """A platform, and in a few words how it is known."""

    platform: Platform
    evidence: str


def weakest(platforms: Iterable[Platform]) -> Platform:
    """The platform that allows the weakest statement; hardware if there are no platforms."""
    return max(platforms, key=list(Platform).index, default=Platform.HARDWARE)
