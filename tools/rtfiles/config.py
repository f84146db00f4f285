"""YAML and JSON files parsed once, at the edge, into frozen typed objects."""

import functools
import re
from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from rtfiles import untrusted
from rtfiles.errors import UsageError
from rtfiles.untrusted import JSON_BYTES_MAX, JSON_ITEMS_MAX, parse_json, read_text
from rtfiles.wording import SHOWN_CHARACTERS, mistake, unknown

# Limits for reporting errors in data, which somebody else may have written.
SHOWN_ERRORS = 20
ERRORS_MAX = 10_000  #: errors of a file that are listed


class Config(BaseModel):
    """Base of every type that is read from a file: frozen, strict about types, refusing unknown keys."""

    model_config = ConfigDict(defer_build=True, frozen=True, extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        # pydantic's own message does not name the allowed keys.
        if isinstance(data, dict):
            names = key_names(cls)
            if refused := [key for key in data if key not in names]:
                text = unknown("key", *refused, known=names, label="allowed")
                raise PydanticCustomError("unknown_key", "{text}", {"text": text, "key": refused[0]})
        return data


@functools.cache
def key_names(model: type[Config]) -> tuple[str, ...]:
    """The keys of a Config as written in a file."""
    return tuple(field.alias or name for name, field in model.model_fields.items())


def matching(pattern: str, allowed: str) -> AfterValidator:
    """Accept an ASCII text that matches the pattern completely; the message states what is `allowed`."""

    def check(value: str) -> str:
        if not re.fullmatch(pattern, value, re.ASCII):
            raise ValueError(f"{value[:SHOWN_CHARACTERS]!r} is not {allowed}")
        return value

    return AfterValidator(check)


def _path(text: str) -> str:
    if not text.isprintable():
        raise ValueError("a path holds printable characters alone")
    try:
        Path(text).expanduser()
    except RuntimeError as error:
        raise ValueError(f"the user of {text.partition('/')[0]!r} is unknown here") from error
    return text


# A path as a user writes it; it may begin with ~ or ~user.
UserPath = Annotated[str, Field(min_length=1), AfterValidator(_path)]

ConfigT = TypeVar("ConfigT", bound=Config)


@dataclass(frozen=True, slots=True)
class Place:
    """A place in data, for messages: ``a.yml:7: runs.0.suite``, with the line of the entry if it is known."""

    origin: str
    path: tuple[str | int, ...] = ()
    node: yaml.Node | None = None
    """What is at this place in a YAML file."""
    line: int | None = None

    def __truediv__(self, key: str | int) -> Self:
        """The place of a key, or of a list entry, in the mapping or list at this place."""
        key_node, node = None, None
        if isinstance(self.node, yaml.MappingNode):
            pairs = (pair for pair in self.node.value if pair[0].value == str(key))
            key_node, node = next(pairs, (None, None))
        elif isinstance(self.node, yaml.SequenceNode) and isinstance(key, int) and key < len(self.node.value):
            key_node = node = self.node.value[key]
        line = self.line if key_node is None else key_node.start_mark.line + 1
        return replace(self, path=(*self.path, key), node=node, line=line)

    def __str__(self) -> str:
        where = ".".join(str(part)[:SHOWN_CHARACTERS] for part in self.path)
        line = "" if self.line is None else f":{self.line}"
        return f"{self.origin}{line}: {where}" if where else f"{self.origin}{line}"


YAML_BYTES_MAX = 1 << 20  #: a YAML file
# With every alias expanded: a few hundred bytes of nested aliases can exceed the memory.
YAML_NODES_MAX = 200_000  #: values in a YAML file, with aliases expanded
YAML_NUMBER_MAX = 40  #: characters of a number in a YAML file


class _StrictLoader(yaml.SafeLoader):
    """SafeLoader that refuses lone surrogates and duplicate keys, where YAML would silently keep the last."""

    def get_single_node(self) -> Any:
        node = super().get_single_node()
        if node is not None:
            _count_nodes(node, {})
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            if node.tag in _NUMBERS and len(node.value) > YAML_NUMBER_MAX:
                raise ValueError(f"a number has at most {YAML_NUMBER_MAX} characters")
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, ValueError) as error:
            # PyYAML passes on Python's errors for 2024-02-30, !!int x and the like.
            kind = node.tag.rpartition(":")[2]
            raise yaml.constructor.ConstructorError(
                None, None, f"no valid {kind}: {error}; a text is to be in quotes", node.start_mark
            ) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable):
                if key in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key {key!r} is given twice, give it once", key_node.start_mark
                    )
                seen.add(key)
        return super().construct_mapping(node, deep)


# PyYAML may have been built without libyaml.
_OWN_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


def _count_nodes(node: yaml.Node, known: dict[yaml.Node, int]) -> int:
    """Return how many nodes a node expands to; `known` holds those already counted, 0 for nodes still being counted."""
    if node in known:
        if not known[node]:
            raise yaml.constructor.ConstructorError(None, None, "an alias within what it names", node.start_mark)
        return known[node]
    known[node] = 0
    parts: list[yaml.Node] = []
    if isinstance(node, yaml.ScalarNode):
        try:
            untrusted.text(node.value)
        except ValueError as error:
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from None
    if isinstance(node, yaml.MappingNode):
        parts = [part for pair in node.value for part in pair]
    elif isinstance(node, yaml.SequenceNode):
        parts = node.value
    known[node] = 1 + sum(_count_nodes(part, known) for part in parts)
    if known[node] > YAML_NODES_MAX:
        raise yaml.constructor.ConstructorError(
            None, None, f"its aliases stand for more than {YAML_NODES_MAX} values", node.start_mark
        )
    return known[node]


def read_yaml(path: Path) -> Any:
    """Return the plain data in a YAML file. Raises UsageError as `read_yaml_with_place` does."""
    return read_yaml_with_place(path)[0]


def read_yaml_with_place(path: Path) -> tuple[Any, Place]:
    """Return the plain data in a YAML file, and the place that knows the lines of its entries.

    Raises UsageError when the file cannot be read, and as `parse_yaml` does.
    """
    return parse_yaml(read_text(path, max_bytes=YAML_BYTES_MAX), str(path))


def parse_yaml(text: str, origin: str) -> tuple[Any, Place]:
    """Return the plain data in a YAML text, and the place that knows the lines of its entries.

    Raises UsageError naming origin and line when the text is not YAML, has a key twice, or is larger than any file of
    ours, as written or expanded.
    """
    if len(text) > YAML_BYTES_MAX:  # a character takes at least a byte
        raise UsageError(f"{origin}: larger than {YAML_BYTES_MAX} bytes")
    try:
        loader = _StrictLoader(text)
        try:
            node = loader.get_single_node()
            data = None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
        return data, Place(origin, node=node)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise UsageError(f"{origin}{line}: {error.problem}") from error
    except RecursionError as error:
        raise UsageError(f"{origin}: nested too deeply") from error
    except yaml.YAMLError as error:
        raise UsageError(f"{origin}: not YAML: {error}") from error


def parse(data: Any, model: type[ConfigT], origin: str | Place) -> ConfigT:
    """Turn plain data into a Config; all errors found are in the UsageError, one line each.

    A line reads ``origin:line: path.to.key: what is wrong, what is allowed``.
    """
    top = Place(origin) if isinstance(origin, str) else origin
    if not isinstance(data, dict):
        raise UsageError(f"{top}: expected a mapping with the keys {', '.join(key_names(model))}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        if error.error_count() > ERRORS_MAX:
            # The details of each error take a KiB.
            raise UsageError(f"{top}: {error.error_count()} errors, so this is no such file") from None
        by_place: dict[Place, list[ErrorDetails]] = {}
        for item in error.errors():
            by_place.setdefault(_place_of(item, data, top), []).append(item)
        lines = [f"{place}: {mistake(errors)}" for place, errors in by_place.items()]
        if (more := len(lines) - SHOWN_ERRORS) > 0:
            lines[SHOWN_ERRORS:] = [f"{top}: and {more} more errors"]
        raise UsageError("\n".join(lines)) from error


def _place_of(error: ErrorDetails, data: Any, top: Place) -> Place:
    """The place of an error; pydantic's path to it also names the alternatives of a union."""
    place = top
    for part in error["loc"]:
        is_there = part in data if isinstance(data, dict) else isinstance(data, list) and isinstance(part, int)
        if is_there:
            place, data = place / part, data[part]
    if error["type"] == "missing":
        place = place / error["loc"][-1]
    if error["type"] == "unknown_key":
        place = replace(place, line=(place / error["ctx"]["key"]).line)
    return place


def load(path: Path, model: type[ConfigT]) -> ConfigT:
    """Read a YAML file into a Config. Raises UsageError as `read_yaml` and `parse` do."""
    data, place = read_yaml_with_place(path)
    return parse(data, model, place)


def load_own(path: Path, model: type[ConfigT]) -> ConfigT:
    """Read a YAML file of this package into a Config, in a fifth of the time that `load` takes.

    It is parsed by libyaml, which ends the process on deeply nested data: never use it for a file that somebody else
    wrote.
    """
    return parse(yaml.load(path.read_text("utf-8"), _OWN_LOADER), model, str(path))


def read_json(
    path: Path, model: type[ConfigT], *, max_bytes: int = JSON_BYTES_MAX, max_items: int = JSON_ITEMS_MAX
) -> ConfigT:
    """Read a JSON file into a Config. Raises UsageError that names the file and what is wrong in it."""
    text = read_text(path, max_bytes=max_bytes)
    return parse(parse_json(text, str(path), max_bytes=max_bytes, max_items=max_items), model, str(path))
