"""What makes a campaign the same one when it is resumed: a digest of its runs in a canonical form."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, fields
from typing import Any

from rtrun.plan import conditions, suites
from rtrun.plan.kernels import order_by_kernel
from rtrun.plan.run import Run
from rtrun.plan.trace import WARM_UP, with_warm_ups

# Increased when the canonical form changes, or the default of a field or an option: a default is not in the form.
VERSION = 2


def digest(runs: Sequence[Run]) -> str:
    """The digest of the canonical form of these runs, ``<version>:<SHA-256>``.

    The form holds, of each run, the fields that are not at their default, and of its parameters and settings
    those that are not at the default of their option. So a field or an option that is added later changes no digest.
    """
    return f"{VERSION}:{_sha256([_canonical(run) for run in runs])}"


def is_digest_of(known: str, runs: Sequence[Run]) -> bool:
    """Whether a journal with this digest, of this version or the one before, is of these runs.

    Earlier versions drew the order of each repeat anew.
    """
    drawn = _as_drawn(runs)
    return known in (digest(runs), digest(drawn), _digest_1(drawn))


def _as_drawn(runs: Sequence[Run]) -> list[Run]:
    """The runs in the order that earlier versions had for an interleaved campaign."""
    if any(run.seed is None for run in runs):
        return list(runs)
    draw = {run.name: hashlib.sha256(f"{run.seed} {run.name}".encode()).digest() for run in runs}
    planned = [run for run in runs if not run.name.endswith(WARM_UP)]
    kernels = [kernel for kernel in dict.fromkeys(run.kernel for run in planned if run.repeat == 1) if kernel]
    ordered = sorted(planned, key=lambda run: (run.repeat, draw[run.name]))
    return list(with_warm_ups(order_by_kernel(ordered, kernels)))


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


# The fields that a run had when its digest was made of all of them, and a setting that it did not have.
_FIELDS_1 = ("name", "suite", "parameters", "condition", "settings", "repeat", "seed")


def _digest_1(runs: Sequence[Run]) -> str:
    forms = [{key: value for key, value in asdict(run).items() if key in _FIELDS_1} for run in runs]
    for form in forms:
        form["settings"] = {key: value for key, value in form["settings"].items() if key != conditions.SAMPLER or value}
    return _sha256(forms)


def _sha256(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
