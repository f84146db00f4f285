"""Stalls that a node plants and tells the times of (chain_node.py): what `rtrun why` says is held against them."""

import re
from typing import Any

CALLBACK = "earlier callback of its thread"
THREAD = "thread of the measured programs"
_STALL = re.compile(r"(\d+) (\d+) (\d+)")


def check_named(outliers: list[dict[str, Any]], printed: str, name: str) -> None:
    """Of most outliers that passed while a stall lasted, most of the time must be that of a callback of this name.

    `outliers` are those of `rtrun why --json`, `printed` is what the node said. Others were late for what else the
    machine does: nothing is asked of them. Nor is of a stall from which somebody took the CPU, who is named then. Where
    the callback's thread took the CPU of the publisher while it sent, it is that thread which is to be named.
    """
    stalls = [tuple(map(int, match.groups())) for match in map(_STALL.fullmatch, printed.splitlines()) if match]
    undisturbed = [(begin_ns, end_ns) for begin_ns, end_ns, cpu_ns in stalls if cpu_ns > 0.9 * (end_ns - begin_ns)]
    waited = [
        outlier
        for outlier in outliers
        for begin_ns, end_ns in undisturbed
        if min(end_ns, outlier["at_ns"]) - max(begin_ns, outlier["at_ns"] - outlier["value_ns"])
        > 0.75 * outlier["value_ns"]
        and not outlier["note"]  # events were lost within, or none are there
    ]
    assert waited, (outliers, stalls)
    # A busy machine loses hits of probes, and with them the begin of a callback: its thread is named then.
    unnamed = [outlier for outlier in waited if not _is_named(outlier, name)]
    assert 2 * len(unnamed) < len(waited), unnamed


def _is_named(outlier: dict[str, Any], name: str) -> bool:
    """Whether most of the time was that of a callback of this name, or of its thread while the publisher sent."""
    parts = outlier["parts"]
    if 2 * outlier["steps"].get("publisher's thread writes", 0) > outlier["value_ns"]:
        named = [part for part in parts if part["kind"] == THREAD and part["pid"] == outlier["tid"]]
    else:
        named = [part for part in parts if part["kind"] == CALLBACK and re.match(name, part["name"])]
    return 2 * sum(part["length_ns"] for part in named) > outlier["value_ns"]
