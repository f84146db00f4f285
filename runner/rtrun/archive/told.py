"""Who was told what: files that are added to the archive, one for each message that arrived."""

from collections.abc import Collection, Sequence
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from rtfiles.config import Config, matching
from rtrun.archive.alarms import Alarm, of_no_concern
from rtrun.archive.entries import add_entry, read_entries
from rtrun.archive.store import Store

FOLDER = "told"
ALARMS_MAX = 4000
"""Of one message."""
_MESSAGES_MAX = 10_000
_BYTES_MAX = 1 << 20
_Time = Annotated[datetime | None, Field(strict=False)]


class ToldAlarm(Config):
    """An alarm of a message, by its key: the last run that was known then, and the levels of its figures."""

    key: Annotated[str, matching("[0-9a-f]{64}", "a SHA-256")]
    last_run: _Time = None
    levels: Annotated[dict[str, float], Field(max_length=10)] = Field(default_factory=dict)


class ToldMessage(Config):
    """A message that a receiver took, at a time in UTC without a zone."""

    schema_number: Literal[1] = Field(alias="schema")
    at: Annotated[datetime, Field(strict=False)]
    receiver: Annotated[str, Field(min_length=1, max_length=200)]
    alarms: Annotated[list[ToldAlarm], Field(max_length=ALARMS_MAX)]


def read_told(store: Store) -> list[ToldMessage]:
    """Every message, the first one first. Raises UsageError for a file that is none, InfrastructureError."""
    reader = TypeAdapter(ToldMessage)
    entries = read_entries(store, FOLDER, reader, most=_MESSAGES_MAX, max_bytes=_BYTES_MAX)
    return [message for _, message in entries]


def add_told(store: Store, receiver: str, alarms: Collection[Alarm], now: datetime) -> None:
    """Remember that a receiver was told of alarms. Raises InfrastructureError."""
    told = [
        ToldAlarm(key=one.key, last_run=one.last_run, levels={name: level for name, (level, _) in one.levels.items()})
        for one in alarms
    ]
    message = ToldMessage(schema=1, at=now, receiver=receiver, alarms=told)
    add_entry(store, FOLDER, now, message.model_dump_json(by_alias=True, exclude_none=True).encode() + b"\n")


def not_told(receiver: str, alarms: Sequence[Alarm], messages: Sequence[ToldMessage]) -> list[Alarm]:
    """The alarms that a receiver has not heard of, of those that are not known."""
    told: dict[str, ToldAlarm] = {}
    for message in messages:
        if message.receiver == receiver:
            told |= {each.key: each for each in message.alarms}  # the last one counts
    return [alarm for alarm in alarms if alarm.known is None and _is_new(alarm, told.get(alarm.key))]


def _is_new(alarm: Alarm, told: ToldAlarm | None) -> bool:
    if told is None:
        return True
    if alarm.begins and told.last_run and alarm.begins > told.last_run:
        return True
    return any(
        name in told.levels and above > told.levels[name] + of_no_concern(name, told.levels[name])
        for name, (_, above) in alarm.levels.items()
    )
