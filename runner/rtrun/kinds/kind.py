"""What distinguishes one kind of measurement from another."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rtrun.kinds.lateness import Measure
from rtrun.kinds.rows import Columns, Stated
from rtrun.kinds.values import IndexedValues, Int64s

# An action is three services and two topics.
_OF_ACTION = re.compile(r"(/.+)/_action/(send_goal|cancel_goal|get_result|feedback|status)", re.DOTALL)


def name_in_words(name: object) -> object:
    """A name as people know it: what belongs to an action begins with the name of that."""
    match = _OF_ACTION.fullmatch(name) if isinstance(name, str) else None
    return name if match is None else f"{match[1]} (action, {match[2]})"


@dataclass(frozen=True, kw_only=True, slots=True)
class LogForm:
    """The logs that a suite wrote in 2014 and still writes: gnuplot scripts with the data in them.

    `main` is the suite's series in 2014. `summary` is the line with the requested number of values. `series` has the
    series of a log by the end of its name, `labels` those of its lines of figures by how the lines begin.
    `missing_as_value`: the log has a missing message as a value of -1 us.
    """

    suite: str
    main: str
    summary: re.Pattern[str]
    series: Mapping[str, str]
    labels: Mapping[str, str] = field(default_factory=dict)
    missing_as_value: bool = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StreamKind:
    """A kind of stream: values of one thing in programs that run already.

    `word` precedes the name of a stream. A stream is written as a run of `suite`, which `summary` describes, with these
    `columns`. A deadline names a stream by its parameter `named_by`; with `is_plain`, without the word.

    With `narrowed_by`, another parameter, a deadline may name a stream by both: NAME/THREAD.

    `words` are templates that distinguish a stream from others; a template is left out if the stream lacks one of its
    parameters. `begins_with` is a parameter whose value says what the stream is, and replaces the word. `hidden` are
    parameters that the words show in another way, `usual` are values that need not be shown.

    `at` is the column with the time at which a value was there, `index` the column that numbers the values; empty: the
    row does. With `is_between_rows`, a value lies between two rows of one segment. `filled` are columns that may be
    missing, each with a number or another column instead. `has_period`: its samples need the period.

    `overdue` is a sentence about a value that had not come at the end, with the time for which it was awaited.

    `is_shown`: it is shown while observed, even without a deadline. A line of what was observed so far counts its
    streams and its values by `live_words`; an empty word counts nothing. `is_traced`: its late values can have a trace.
    `is_of_topologies`: only the nodes of a topology can report it, since they write down when they were due.
    """

    word: str
    suite: str
    summary: str
    columns: tuple[str, ...]
    named_by: str
    at: str
    words: tuple[str, ...]
    narrowed_by: str = ""
    is_plain: bool = False
    begins_with: str = ""
    hidden: tuple[str, ...] = ()
    usual: Mapping[str, object] = field(default_factory=dict)
    index: str = ""
    is_between_rows: bool = False
    filled: Mapping[str, int | str] = field(default_factory=dict)
    has_period: bool = False
    overdue: str = ""
    is_shown: bool = False
    live_words: tuple[str, str] = ("", "")
    is_traced: bool = False
    is_of_topologies: bool = False

    def __str__(self) -> str:
        return self.word

    @property
    def is_of_paths(self) -> bool:
        """Whether it is of a path of topics."""
        return self.named_by == "path"

    def name(self, name: str) -> str:
        """A stream as a deadline names it."""
        return name if self.is_plain else f"{self.word}:{name}"

    def is_named(self, name: str, parameters: Mapping[str, object]) -> bool:
        """Whether a deadline with this name is for a stream with these parameters."""
        own = str(parameters.get(self.named_by))
        return name == own or (bool(self.narrowed_by) and name == f"{own}/{parameters.get(self.narrowed_by)}")

    def in_words(self, parameters: Mapping[str, object]) -> tuple[str, frozenset[str]]:
        """A stream in a few words, and the parameters that these words show, if the stream has them."""
        parts = [*self.words, f"{{{self.begins_with}}}", *(f"{{{key}}}" for key in self.hidden)]
        keys = frozenset(re.findall(r"{(\w+)}", " ".join(parts)))
        values = {key: value for key, value in parameters.items() if key in keys and value is not None}
        shown = {
            key: name_in_words(value)
            for key, value in values.items()
            if key not in self.usual or value != self.usual[key]
        }
        rest = [part.format_map(shown) for part in self.words if set(re.findall(r"{(\w+)}", part)) <= shown.keys()]
        return " ".join(filter(None, [str(values.get(self.begins_with) or self.word), *rest])), keys


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasurementKind:
    """A kind of measurement.

    `series` makes the series of the samples from their columns, each of shape (rows,). The first series is what the
    suite is about. `series` raises UsageError, with the file, if the rows disagree with what is stated about them.
    `called` has the name of each series in questions; if two share a name, the first in the samples is meant. `times`
    gives the moments at which the values of a series were measured, int64 (n,).

    `subject` follows the name of a series and states what its values belong to: "of the timer".

    `startup` has, by series, the number of loops at the start of a run whose values are separated, as in the thesis.
    `clustered` are the series that may have a cluster of negative values, with their names in a report. `layer_below`
    is the baseline, or the kind, that measures the layer below this kind.

    `logs` is the form of its logs of 2014; None: there were none. `stream` is how it is observed; None: it is not.
    `has_steps`: a value passes between two programs, and its steps can be found (causes/steps.py). `is_of_callbacks`:
    the measured thing is itself a callback, so no earlier callback is a cause.
    """

    series: Callable[[Columns, Stated, Path], dict[str, IndexedValues]]
    called: Mapping[str, Measure]
    times: Callable[[Columns, IndexedValues], Int64s]
    subject: str
    startup: Mapping[str, int] = field(default_factory=dict)
    clustered: Mapping[str, str] = field(default_factory=dict)
    layer_below: str = ""
    logs: LogForm | None = None
    stream: StreamKind | None = None
    has_steps: bool = False
    is_of_callbacks: bool = False
