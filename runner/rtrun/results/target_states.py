"""target.json: the state of the target before and after a run."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, read_json
from rtrun.results.record import RunRecord, check_file
from rtrun.targets.inspection.facts import TargetState

FILE = "target.json"


class TargetStates(Config):
    """target.json; its two uptimes bound the times of the samples."""

    schema_number: Literal[1] = Field(alias="schema")
    before: TargetState
    after: TargetState
    own_service: bool


def read_states(folder: Path, record: RunRecord) -> TargetStates | None:
    """The states of a run's target; None if the run has none. Raises UsageError for a damaged file."""
    if FILE not in record.files:
        return None
    check_file(folder, record, FILE)
    return read_json(folder / FILE, TargetStates)
