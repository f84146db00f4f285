"""The goal that a folder of runs was measured for, beside them: who asks later need not repeat the question."""

import json
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles import atomic
from rtfiles.config import Config, read_json
from rtrun.plan.goal import Goal

FILE = "goal.json"


class GoalFile(Config):
    """goal.json: ``until`` of the campaign, written as in the campaign file."""

    schema_number: Literal[1] = Field(alias="schema")
    until: Goal


def write_goal(results: Path, goal: Goal) -> None:
    """Write the goal of a campaign into its results folder."""
    written = {
        "deadline": f"{goal.deadline_ns}ns",
        "probability": goal.probability,
        "confidence": goal.confidence,
        "at_most": f"{goal.at_most_ns}ns",
        "boots": goal.boots,
        "bursts": goal.bursts,
    }
    atomic.write_text(results / FILE, json.dumps({"schema": 1, "until": written}, indent=2) + "\n")


def read_goal(results: Path) -> Goal | None:
    """Read the goal of the runs in a folder; None when they had none. Raises UsageError for a damaged file."""
    path = results / FILE
    return read_json(path, GoalFile).until if path.is_file() else None
