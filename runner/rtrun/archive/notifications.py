"""Who was notified of what: a file in the archive for each message that arrived."""

from collections.abc import Collection, Sequence
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from rtfiles.config import Config, matching
from rtrun.archive.alarms import Alarm, of_no_concern
from rtrun.archive.entries import EntryKind, Moment, add_entry, check_room, read_entries
from rtrun.archive.store import Store

ALARMS_MAX = 3000  #: alarms of a message of `rtrun notify`
_MESSAGES_MAX = 10_000  #: such messages that an archive remembers
_BYTES_MAX = 1 << 20  #: such a message, as remembered
_Level = Annotated[float, Field(allow_inf_nan=False)]


class NotifiedAlarm(Config):
    """An alarm of a message, by its key: the last run known at that time, and the levels of its figures."""

    key: Annotated[str, matching("[0-9a-f]{64}", "a SHA-256")]
    last_run: Moment | None = None
    levels: Annotated[dict[str, _Level], Field(max_length=10)] = Field(default_factory=dict)


class Notification(Config):
    """A message that a receiver accepted, at a time in UTC without a zone."""

    schema_number: Literal[1] = Field(alias="schema")
    at: Moment
    receiver: Annotated[str, Field(min_length=1, max_length=200)]
    alarms: Annotated[list[NotifiedAlarm], Field(max_length=ALARMS_MAX)]


_KIND = EntryKind(folder="told", reader=TypeAdapter(Notification), entries_max=_MESSAGES_MAX, bytes_max=_BYTES_MAX)


def read_told(store: Store) -> list[Notification]:
    """Every message, oldest first. Raises UsageError for a file that is not a message, InfrastructureError."""
    return [message for _, message in read_entries(store, _KIND)]


def check_memory(store: Store, messages: Sequence[Notification], more: int) -> None:
    """Raise UsageError where the archive has no room to record `more` messages: all would be sent again."""
    check_room(store, _KIND, len(messages), more)


def add_told(store: Store, receiver: str, alarms: Collection[Alarm], now: datetime) -> None:
    """Record that a receiver was notified of alarms. Raises UsageError, InfrastructureError."""
    notified = [
        NotifiedAlarm(
            key=alarm.key, last_run=alarm.last_run, levels={name: level for name, (level, _) in alarm.levels.items()}
        )
        for alarm in alarms
    ]
    message = Notification(schema=1, at=now, receiver=receiver, alarms=notified)
    add_entry(store, _KIND, message, now)


def not_told(receiver: str, alarms: Sequence[Alarm], messages: Sequence[Notification]) -> list[Alarm]:
    """The alarms that a receiver has not received yet, without known ones."""
    notified: dict[str, NotifiedAlarm] = {}
    for message in messages:
        if message.receiver == receiver:
            notified |= {alarm.key: alarm for alarm in message.alarms}  # the last one counts
    return [alarm for alarm in alarms if alarm.known is None and _is_new(alarm, notified.get(alarm.key))]


def _is_new(alarm: Alarm, notified: NotifiedAlarm | None) -> bool:
    if notified is None:
        return True
    if alarm.begins and notified.last_run and alarm.begins > notified.last_run:
        return True
    return any(
        name in notified.levels and above > notified.levels[name] + of_no_concern(name, notified.levels[name])
        for name, (_, above) in alarm.levels.items()
    )
