"""The health of a place in its tags, and how a check changes them.

A place that failed its check once has the tag `failed_check`; after a second failure in a row it has `quarantine`. The
value is the day and the reason. A passed check removes both. In labs whose users filter by `healthy=yes`, that tag is
`no` meanwhile. Health is stored nowhere else.
"""

import contextlib
import re
from collections.abc import Mapping
from datetime import date

from rtrun.targets.labgrid.coordinator import QUARANTINE

FAILED = "failed_check"
HEALTHY = "healthy"
_REASON_MAX = 100  #: characters of the reason in a tag of a labgrid place


def after_failure(tags: Mapping[str, str], reason: str, today: date) -> dict[str, str]:
    """The tags to set after a failed check, by name; an empty value removes a tag."""
    if QUARANTINE in tags:
        return {}
    if FAILED not in tags:
        return {FAILED: _value(reason, today)}
    not_healthy = {HEALTHY: "no"} if tags.get(HEALTHY) == "yes" else {}
    return {QUARANTINE: _value(reason, today), FAILED: ""} | not_healthy


def after_success(tags: Mapping[str, str]) -> dict[str, str]:
    """The tags to set after a passed check."""
    healthy = {HEALTHY: "yes"} if QUARANTINE in tags and tags.get(HEALTHY) == "no" else {}
    return {name: "" for name in (QUARANTINE, FAILED) if name in tags} | healthy


def in_words(value: str) -> str:
    """The value of such a tag for people."""
    day = since(value)
    words = value.partition("_")[2] if day else value
    return words.replace("_", " ") + (f" (since {day})" if day else "")


def since(value: str) -> date | None:
    """The day of such a tag; None if somebody set the tag without a day."""
    with contextlib.suppress(ValueError):
        return date.fromisoformat(value.partition("_")[0])
    return None


def _value(reason: str, today: date) -> str:
    """Day and reason, in characters that every program accepts within a tag."""
    words = re.sub("[^a-z0-9.-]+", "_", reason.lower()).strip("_")
    return f"{today.isoformat()}_{words[:_REASON_MAX] or 'unknown'}"
