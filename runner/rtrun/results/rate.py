"""How often a program did what it was asked to do, and whether it kept to that."""

from rtfiles.config import Config
from rtfiles.output import counted
from rtrun.kinds.limits import Count, RateHz

# A publisher that is further from the rate that was asked for measured something else.
OFF_MAX = 0.01


class Rate(Config):
    """The rate of a program in hertz, asked for and achieved, and how often it did not keep up; None if not periodic.

    `overruns` came more than a period late, `skipped` are periods in which nothing came.
    """

    asked_hz: Count | None
    achieved_hz: RateHz | None
    overruns: Count | None
    skipped: Count | None

    @property
    def off(self) -> float:
        """How far the achieved rate is from the one that was asked for, as a part of that; 0 where one is not known."""
        return abs(self.achieved_hz / self.asked_hz - 1) if self.achieved_hz and self.asked_hz else 0.0

    @property
    def words(self) -> str:
        """Both rates, and what was not kept."""
        achieved = "no rate" if self.achieved_hz is None else f"{self.achieved_hz:.7g} Hz"
        overruns = "" if self.overruns is None else f", {counted(self.overruns, 'overrun')}"
        skipped = "" if self.skipped is None else f", {counted(self.skipped, 'skipped period')}"
        return f"asked for {self.asked_hz} Hz, achieved {achieved}{overruns}{skipped}"


def is_missed(rate: Rate, sent: int) -> bool:
    """Whether so many messages missed the rate asked for: by more than 1 %, and more than one period in all."""
    if not rate.achieved_hz or not rate.asked_hz:
        return False
    due = (sent - 1) / rate.achieved_hz * rate.asked_hz
    return rate.off > OFF_MAX and abs(due - (sent - 1)) > 1
