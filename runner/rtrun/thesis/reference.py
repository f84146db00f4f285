"""The published results of 2014 (pandaboard-2014.yml), to compare with."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtfiles.config import read_yaml
from rtrun.judgement.groups import Group
from rtrun.kinds import messages, oneshot
from rtrun.kinds.kind import MeasurementKind
from rtrun.plan.conditions import IDLE
from rtrun.plan.suites import Value
from rtrun.thesis.examination import select

# The load of the published tables, by the condition that makes the same load.
_LOAD_PERCENT = {IDLE: 0, "cpu80": 80}
_DEFAULTS: dict[str, Value] = {"policy": "0", "subscribers": 1}
FILE = Path(__file__).with_name("pandaboard-2014.yml")


@functools.cache
def published() -> dict[str, Any]:
    """The whole file as plain data."""
    data: dict[str, Any] = read_yaml(FILE)
    return data


@dataclass(frozen=True, kw_only=True)
class Row:
    """Figures that were published, in us, and what they were measured with; None: a group may have any."""

    place: str
    kind: MeasurementKind
    parameters: Mapping[str, Value]
    load_percent: int | None = None
    preempt_rt: bool | None = None
    is_rt: bool | None = None
    figures_us: tuple[float, float, float]
    """Lowest, mean, highest."""

    def is_like(self, group: Group) -> bool:
        """Whether a group was measured as this row was, as far as the group's kernel is known."""
        given = _DEFAULTS | group.parameters
        load_percent = _LOAD_PERCENT.get(str(given.get("condition", IDLE)))
        kernels = {record.target.preempt_rt for record in group.records} or {None}
        return (
            bool(select([group], self.kind, rt=self.is_rt))
            and all(given.get(key) == value for key, value in self.parameters.items())
            and self.load_percent in (None, load_percent)
            and (self.preempt_rt is None or not kernels.isdisjoint({None, self.preempt_rt}))
        )


def oneshot_rows() -> list[Row]:
    """The table of one-shot timers."""
    columns = published()["oneshot_table"]["columns"]
    rows = [dict(zip(columns, row, strict=True)) for row in published()["oneshot_table"]["rows"]]
    return [
        Row(
            place=f"PandaBoard ES 2014, {row['kernel']}, {row['cpu_load_percent']} % load",
            kind=oneshot.KIND,
            parameters={"timeout_us": 1000 * row["timeout_ms"], "policy": row["policy"]},
            load_percent=row["cpu_load_percent"],
            preempt_rt="-rt" in row["kernel"],
            figures_us=(row["min_us"], row["avg_us"], row["max_us"]),
        )
        for row in rows
    ]


def message_rows() -> list[Row]:
    """The figure of one subscriber, without the first message."""
    figure = published()["thesis_figures"]["communication_fig_4_3"]
    return [
        Row(
            place="PandaBoard ES 2014, figure 4.3",
            kind=messages.KIND,
            parameters={key: figure[key] for key in ("frequency_hz", "subscribers")},
            is_rt=True,
            figures_us=(figure["rest_min_us"], figure["rest_avg_us"], figure["rest_max_us"]),
        )
    ]
