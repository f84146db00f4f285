"""How often a program did its work, and whether it kept to the rate that was asked for."""

from rtfiles.config import Config
from rtfiles.output import counted
from rtrun.kinds.limits import Count, RateHz

# A publisher that deviates more from the requested rate measured something else.
OFF_MAX = 0.01  # a share of the rate


class Rate(Config):
    """The requested and the achieved rate of a program in hertz, and how often it was late; None if not periodic.

    `overruns` came more than a period late; `skipped` are periods in which nothing came.
    """

    asked_hz: Count | None
    achieved_hz: RateHz | None
    overruns: Count | None
    skipped: Count | None

    @property
    def off(self) -> float:
        """The deviation from the requested rate, as a fraction of it; 0 where one of the rates is not known."""
        return abs(self.achieved_hz / self.asked_hz - 1) if self.achieved_hz and self.asked_hz else 0.0

    @property
    def words(self) -> str:
        """Both rates, and how often the program was late."""
        achieved = "no rate" if self.achieved_hz is None else f"{self.achieved_hz:.7g} Hz"
        overruns = "" if self.overruns is None else f", {counted(self.overruns, 'overrun')}"
        skipped = "" if self.skipped is None else f", {counted(self.skipped, 'skipped period')}"
        return f"asked for {self.asked_hz} Hz, achieved {achieved}{overruns}{skipped}"


def is_missed(rate: Rate, sent: int) -> bool:
    """Whether `sent` messages missed the requested rate by more than 1 %, and by more than one period in all."""
    if not rate.achieved_hz or not rate.asked_hz:
        return False
    due = (sent - 1) / rate.achieved_hz * rate.asked_hz
    return rate.off > OFF_MAX and abs(due - (sent - 1)) > 1
