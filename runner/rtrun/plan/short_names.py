"""Short names to display: what is measured, and the parameters that distinguish it from its neighbours."""

from collections.abc import Mapping, Sequence

from rtrun.plan import conditions
from rtrun.plan.run import UNTRACED, Run
from rtrun.plan.suites import NOT_TELLING, Value, options
from rtrun.plan.topology.planning import TopologyPlan

_UNITS = {"timeout_us": " us", "frequency_hz": " Hz", "payload_bytes": " B", "subscribers": " sub", "priority": " prio"}
# Always named, default or not.
_TELLING = ("policy", "timeout_us", "frequency_hz", "payload_bytes", "subscribers")


def tell_apart(all_words: Sequence[tuple[str, Mapping[str, Value]]]) -> list[str]:
    """Name each of them by what is measured, and by those parameters that differ among ones that measure the same."""
    alike: dict[str, list[Mapping[str, Value]]] = {}
    for what, parameters in all_words:
        alike.setdefault(what, []).append(parameters)
    differ = {
        what: {key for parameters in all_of for key in parameters if len({str(other.get(key)) for other in all_of}) > 1}
        for what, all_of in alike.items()
    }
    return [
        f"{what} {format_parameters({key: value for key, value in all_of.items() if key in differ[what]})}".strip()
        for what, all_of in all_words
    ]


def short_names_of_runs(runs: Sequence[Run]) -> dict[str, str]:
    """A short name of each run of a campaign, by its own name."""
    names = tell_apart([(run.suite.removesuffix("_tests"), _parameters(run)) for run in runs])
    return {run.name: name for run, name in zip(runs, names, strict=True)}


def _parameters(run: Run) -> dict[str, Value]:
    topology = run.subject.topology.name if isinstance(run.subject, TopologyPlan) else ""
    further = {
        "topology": topology,
        "load": "" if run.condition == conditions.IDLE else run.condition,
        "programs": run.variant,
        "kernel": run.kernel,
        "trace": run.trace,
        "repeat": run.repeat,
    }
    # `trace` names this limit.
    parameters = {key: value for key, value in run.parameters.items() if key != "trace_threshold_us"}
    return {**parameters, **run.settings, **further}


def format_parameters(parameters: Mapping[str, Value]) -> str:
    """Parameters in a few words: policy first, then those that are not the default; units follow the number."""
    words: list[str] = []
    known = options()
    for key, value in parameters.items():
        if key in NOT_TELLING or value is None or value == "":
            continue
        option = known.get(key)
        if key not in _TELLING and option is not None and value == option.default:
            continue
        if key == "policy":
            words.insert(0, "OTHER" if value == "0" else str(value))
        elif key == "trace":
            words.append("not traced" if value == UNTRACED else f"traced above {value}")
        else:
            words.append(f"{value}{_UNITS[key]}" if key in _UNITS else f"{key}={value}")
    return " ".join(words)
