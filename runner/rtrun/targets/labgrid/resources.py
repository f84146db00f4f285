"""The resources of an acquired place, read from the output of labgrid's client."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from rtfiles.config import parse_yaml
from rtfiles.errors import UsageError
from rtrun.targets.errors import TargetError
from rtrun.targets.labgrid.environment import entries


class SshService(BaseModel):
    """Where the SSH server of a place is: labgrid's resource NetworkService."""

    address: Annotated[str, Field(min_length=1, max_length=255)]
    port: Annotated[int, Field(ge=1, le=65535)] = 22
    username: Annotated[str, Field(min_length=1, max_length=255)]


def ssh_service(resources: Mapping[str, Mapping[str, Any]], place: str) -> SshService:
    """Where the SSH server of a place is. Raises TargetError."""
    if "NetworkService" not in resources:
        raise TargetError(
            f"place {place} has no NetworkService, which says where its SSH server is; its resources: "
            f"{', '.join(resources)[:500] or 'none, is its exporter running?'}"
        )
    try:
        return SshService.model_validate(resources["NetworkService"])
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}" for problem in error.errors())
        raise TargetError(f"place {place}: NetworkService: {wrong}") from error


def read_resources(printed: str, place: str) -> dict[str, dict[str, Any]]:
    """The resources of a place by class, from what `labgrid-client env` printed."""
    try:
        # The client may print what it does before the file.
        data, _ = parse_yaml(printed[printed.index("targets:") :], "labgrid-client env")
        return dict(entries(data["targets"][place], "resources"))
    except (UsageError, ValueError, KeyError, TypeError) as error:
        raise TargetError(
            f"place {place}: labgrid-client env printed no environment: {printed.strip()[:200]!r}"
        ) from error
