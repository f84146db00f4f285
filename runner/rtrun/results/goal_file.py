"""The goal that a folder of runs was measured for, kept next to them, so that later questions need not repeat it."""

import json
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles import atomic
from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtrun.plan.goal import Goal
from rtrun.plan.question import NONE_TOLERATED, may_follow
from rtrun.results.record import is_closed

FILE = "goal.json"


class GoalFile(Config):
    """goal.json: ``until`` of the campaign, written as in the campaign file."""

    schema_number: Literal[1] = Field(alias="schema")
    until: Goal


def write_goal(results: Path, goal: Goal) -> None:
    """Write the goal of a campaign into its results folder.

    Raises UsageError where the folder has runs that were measured for a goal that this one must not follow.
    """
    before = read_goal(results)
    if before and not may_follow(before.question, goal.question) and any(map(is_closed, results.iterdir())):
        raise UsageError(
            f"{results / FILE}: these runs were measured for P({before.question.miss}), the campaign asks for "
            f"P({goal.question.miss}) now: what is chosen after looking has no confidence of "
            f"{100 * goal.confidence:g} %. Measure anew with --fresh, or ask as before"
        )
    written = {
        "of": goal.of,
        "probability": goal.probability,
        "confidence": goal.confidence,
        "at_most": f"{goal.at_most_ns}ns",
        "boots": goal.boots,
    }
    if goal.bursts is not None:
        written["bursts"] = goal.bursts
    if goal.deadline_ns is not None:
        written["deadline"] = f"{goal.deadline_ns}ns"
    if goal.tolerate != NONE_TOLERATED:
        written["tolerate"] = str(goal.tolerate)
    atomic.write_text(results / FILE, json.dumps({"schema": 1, "until": written}, indent=2) + "\n")


def read_goal(results: Path) -> Goal | None:
    """Read the goal of the runs in a folder; None when they had no goal. Raises UsageError for a damaged file."""
    path = results / FILE
    return read_json(path, GoalFile).until if path.is_file() else None
