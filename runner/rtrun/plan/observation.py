"""What an observation is asked for: how long, which streams have a deadline, which paths of topics are followed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rtrun.plan.quantities import read_time_ns
from rtrun.plan.suites import Value

# How a stream is named by what its deadline is of: its entry in observed.yml, and the parameter that has the name.
_NAMED = {
    "": ("observed_messages", "topic"),
    "timer": ("observed_timers", "node"),
    "callback": ("observed_callbacks", "node"),
    "interval": ("observed_intervals", "topic"),
    "path": ("observed_paths", "path"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamDeadline:
    """A deadline of every stream of a suite of observed.yml whose parameter `key` is `name`."""

    suite: str
    key: str
    name: str
    deadline_ns: int

    def is_of(self, suite: str, parameters: Mapping[str, Value]) -> bool:
        """Whether a stream has it."""
        return suite == self.suite and parameters.get(self.key) == self.name

    @property
    def words(self) -> str:
        """What it is of."""
        what = {suite: word for word, (suite, _) in _NAMED.items()}[self.suite]
        return f"{what or 'topic'} {self.name}"


def read_stream_deadline(text: str) -> StreamDeadline:
    """Read ``/cmd_vel=5ms``, or ``timer:/controller=200us`` with one of the words of `_NAMED`. Raises ValueError."""
    what, equals, time = text.rpartition("=")
    word, colon, name = what.partition(":")
    if not colon:
        word, name = ("path", what) if "," in what else ("", what)
    if not equals or not name or word not in _NAMED:
        words = ", ".join(word for word in _NAMED if word)
        raise ValueError(
            f"{text[:60]!r}: takes TOPIC=TIME, as /cmd_vel=5ms, or one of {words} before it, as timer:/node=200us"
        )
    suite, key = _NAMED[word]
    return StreamDeadline(suite=suite, key=key, name=name, deadline_ns=read_time_ns(time))


def read_path(text: str) -> tuple[str, ...]:
    """Read ``/scan,/objects,/cmd_vel``. Raises ValueError."""
    topics = tuple(text.split(","))
    if len(topics) < 2 or not all(topics):
        raise ValueError(f"{text[:60]!r}: a path has two topics at least, as /scan,/cmd_vel")
    return topics


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservationPlan:
    """How long to observe, in seconds, and what for."""

    for_s: float
    deadlines: Sequence[StreamDeadline] = ()
    paths: Sequence[tuple[str, ...]] = ()
