"""What makes a campaign the same one when it is resumed: a digest of its runs in a canonical form."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from rtrun.plan import conditions, suites
from rtrun.plan.run import Run

# Increased when the canonical form changes, or the default of a field or an option: a default is not in the form.
VERSION = 1


def digest(runs: Sequence[Run]) -> str:
    """The digest of the canonical form of these runs, ``<version>:<SHA-256>``.

    The form holds, of each run, the fields that are not at their default, and of its parameters and settings
    those that are not at the default of their option. So a field or an option that is added later changes no digest.
    """
    forms = json.dumps([_canonical(run) for run in runs], sort_keys=True)
    return f"{VERSION}:{hashlib.sha256(forms.encode()).hexdigest()}"


def _canonical(run: Run) -> dict[str, Any]:
    form: dict[str, Any] = {}
    for field in fields(run):
        value = getattr(run, field.name)
        default = field.default_factory() if field.default_factory is not MISSING else field.default
        if value != default:
            form[field.name] = dict(value) if isinstance(value, Mapping) else value
    form["parameters"] = _without_defaults(run.parameters, suites.defaults_of(run.suite))
    settings = {key: option.default for key, option in conditions.conditions().settings.items()}
    form["settings"] = _without_defaults(run.settings, settings)
    return form


def _without_defaults(values: Mapping[str, suites.Value], defaults: Mapping[str, suites.Value]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in defaults or value != defaults[key]}
