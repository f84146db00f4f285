"""YAML files parsed once, at the edge, into frozen typed objects."""

from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from rtfiles.errors import UsageError


class Config(BaseModel):
    """Base of every type that is read from YAML: frozen, strict about types, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        # pydantic's own message does not say what is allowed.
        if isinstance(data, dict):
            names = key_names(cls)
            unknown = [str(key) for key in data if key not in names]
            if unknown:
                raise ValueError(f"unknown key {', '.join(map(repr, unknown))}, allowed: {', '.join(names)}")
        return data


def key_names(model: type[Config]) -> list[str]:
    """The keys of a Config as they stand in a file."""
    return [field.alias or name for name, field in model.model_fields.items()]


ConfigT = TypeVar("ConfigT", bound=Config)


class _StrictLoader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice, where YAML would silently keep the last."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, ValueError) as error:
            # PyYAML lets through what Python says of 2024-02-30, !!int x and the like.
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


def read_yaml(path: Path) -> Any:
    """Return the plain data in a YAML file.

    Raises UsageError naming file and line when it cannot be read, is not YAML, or gives a key twice.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"{path}: {reason}") from error
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise UsageError(f"{path}{line}: {error.problem}") from error
    except RecursionError as error:
        raise UsageError(f"{path}: nested too deeply") from error
    except yaml.YAMLError as error:
        raise UsageError(f"{path}: not YAML: {error}") from error


def parse(data: Any, model: type[ConfigT], origin: str) -> ConfigT:
    """Turn plain data into a Config; every error found is in the UsageError, one line each.

    A line reads ``origin: path.to.key: what is wrong, what is allowed``.
    """
    if not isinstance(data, dict):
        raise UsageError(f"{origin}: expected a mapping with the keys {', '.join(key_names(model))}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = []
        for item in error.errors():
            where = ".".join(str(part) for part in item["loc"])
            message = item["msg"].removeprefix("Value error, ")
            got = item["input"]
            if isinstance(got, str | int | float | bool) and item["type"] not in ("missing", "value_error"):
                message += f", got {got!r}"
            lines.append(f"{origin}: {where + ': ' if where else ''}{message}")
        raise UsageError("\n".join(lines)) from error


def load(path: Path, model: type[ConfigT]) -> ConfigT:
    """Read a YAML file into a Config. Raises UsageError as `read_yaml` and `parse` do."""
    return parse(read_yaml(path), model, str(path))
