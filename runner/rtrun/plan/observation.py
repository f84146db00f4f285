"""The plan of an observation: what is observed, how long, which streams have a deadline, which paths are followed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rtfiles.wording import did_you_mean, unknown
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.known import STREAMS
from rtrun.kinds.loop import STREAM as LOOP
from rtrun.kinds.loop_response import STREAM as LOOP_RESPONSE
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.kinds.path import STREAM as PATH
from rtrun.plan.quantities import read_time_ns

if TYPE_CHECKING:
    from rtrun.plan.suites import Value


SUITE = "observation"
"""The suite of a run that observes. Its streams become runs of the suites of their kinds."""
ATTACHED = "attached"
_TOPIC = "topic"
_NO_SAMPLER = ("sampler", "none")


def stream_words(suite: str, parameters: "Mapping[str, Value]") -> "tuple[str, dict[str, Value]]":
    """A stream in a few words, and the parameters not in these words; if it was not observed, the words are empty."""
    kind = next((kind for kind in STREAMS.values() if kind.suite == suite), None)
    if kind is None:
        return "", dict(parameters)
    words, named = kind.in_words(parameters)
    # In an observation it goes without saying that no sampler runs.
    return words, {key: value for key, value in parameters.items() if key not in named and (key, value) != _NO_SAMPLER}


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamDeadline:
    """A deadline of every stream of a kind and a name: the name of a topic, of a node, or of the topics of a path."""

    kind: str
    name: str
    deadline_ns: int

    @property
    def stream(self) -> StreamKind:
        """The kind of stream that it is for."""
        return STREAMS[self.kind]

    @property
    def text(self) -> str:
        """As `read_stream_deadline` takes it."""
        return f"{self.kind}:{self.name}={self.deadline_ns}ns"

    def is_of(self, suite: str, parameters: "Mapping[str, Value]") -> bool:
        """Whether a stream has this deadline."""
        return suite == self.stream.suite and self.stream.is_named(self.name, parameters)


def read_stream_deadline(text: object) -> StreamDeadline:
    """Read ``/cmd_vel=5ms``, ``/scan,/cmd_vel=9ms`` of a path, or ``timer:/controller=200us``. Raises ValueError."""
    text = str(text)  # a file may hold anything
    what, equals, time = text.rpartition("=")
    word, colon, name = what.partition(":")
    if not colon:
        word, name = (PATH if "," in what else MESSAGES).word, what
    if not equals or not name or word not in STREAMS:
        words = ", ".join(STREAMS)
        raise ValueError(
            f"{text[:60]!r}: takes TOPIC=TIME, as /cmd_vel=5ms, or one of {words} before it, as timer:/node=200us"
        )
    kind = STREAMS[word]
    if kind.is_of_paths:
        read_path(name)
    elif kind.named_by in ("topic", "service"):
        _check_topic(name)
    return StreamDeadline(kind=word, name=name, deadline_ns=read_time_ns(time))


def read_path(text: object) -> tuple[str, ...]:
    """Read ``/scan,/objects,/cmd_vel``. Raises ValueError."""
    text = str(text)
    topics = tuple(text.split(","))
    if len(topics) < 2 or not all(topics):
        raise ValueError(f"{text[:60]!r}: a path has two topics at least, as /scan,/cmd_vel")
    for topic in topics:
        _check_topic(topic)
    return topics


def _check_topic(name: str) -> None:
    """Refuse a name that no observed topic or service can have: programs report the full name."""
    if not name.startswith("/"):
        raise ValueError(f"{name[:60]!r}: the full name of a topic or a service begins with /, as /cmd_vel")


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservedSystem:
    """The programs to observe: those that the command `start` (for sh) starts; empty: those that run already.

    After the start they are ready when one of them publishes `ready_topic`, or uses ROS if no topic is named.
    """

    start: str = ""
    ready_topic: str = ""


def read_subject(value: object) -> ObservedSystem:
    """Read ``attached``, or ``{start: COMMAND, ready: topic /x}``. Raises ValueError."""
    if value == ATTACHED:
        return ObservedSystem()
    if not isinstance(value, dict):
        hint = did_you_mean([value], [ATTACHED]) if isinstance(value, str) else ""
        raise ValueError(
            f"{str(value)[:60]!r}: takes {ATTACHED}, of programs that run already, or "
            f"{{start: COMMAND, ready: topic /x}}{',' if hint else ''}{hint}"
        )
    known = ("start", "ready")
    if refused := [key for key in value if key not in known]:
        raise ValueError(unknown("key", *refused, known=known, label="allowed"))
    start, ready = value.get("start"), value.get("ready")
    if not isinstance(start, str) or not start.strip() or "\0" in start:
        raise ValueError(f"start: takes the command that starts the system, got {str(start)[:60]!r}")
    if ready is None:
        return ObservedSystem(start=start)
    word, _, topic = ready.partition(" ") if isinstance(ready, str) else ("", "", "")
    if word != _TOPIC or not topic.strip():
        raise ValueError(f"ready: takes topic NAME, as topic /cmd_vel, got {str(ready)[:60]!r}")
    _check_topic(topic.strip())
    return ObservedSystem(start=start, ready_topic=topic.strip())


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservationPlan:
    """How long to observe (in seconds), what, for which deadlines, paths and loops; those of deadlines are included."""

    word: ClassVar[str] = "observation"
    is_observed: ClassVar[bool] = True
    makes_streams: ClassVar[bool] = True

    for_s: float
    system: ObservedSystem = ObservedSystem()
    deadlines: Sequence[StreamDeadline] = ()
    paths: Sequence[tuple[str, ...]] = ()
    named_loops: Sequence[str] = ()

    @property
    def loops(self) -> tuple[str, ...]:
        """The names of loops that are observed besides those of real-time threads."""
        of_deadlines = (deadline.name for deadline in self.deadlines if deadline.stream in (LOOP, LOOP_RESPONSE))
        return tuple(dict.fromkeys((*self.named_loops, *of_deadlines)))

    @property
    def followed(self) -> tuple[tuple[str, ...], ...]:
        """Every path that is followed, without duplicates."""
        of_deadlines = (tuple(deadline.name.split(",")) for deadline in self.deadlines if deadline.stream is PATH)
        return tuple(dict.fromkeys((*self.paths, *of_deadlines)))
