"""A program of a run, and how it ended."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """A program of a run: `argv` with its whole path, `environment` on top of the login's."""

    name: str
    argv: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()
    deadline_s: float = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Exit:
    """How a program ended: its status, or None when it was killed."""

    status: int | None
    expired: bool
