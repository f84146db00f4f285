"""Where a target listens, and how it and the runner prove to each other who they are."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """An SSH server and the login to use there.

    `host_key` is ``SHA256:…`` or ``type base64``; without it the `known_hosts` file decides. `key` is a private key
    file; without it the SSH agent is asked.
    """

    host: str
    port: int = 22
    user: str = "root"
    key: Path | None = None
    host_key: str | None = None
    known_hosts: Path = Path("~/.ssh/known_hosts")

    def __str__(self) -> str:
        return f"{self.user}@{self.host}:{self.port}"
