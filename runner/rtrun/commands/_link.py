"""The link for a command that queries a target without measuring."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rtfiles.output import print_note
from rtrun.targets.config import TargetConfig, connect
from rtrun.targets.link import Link


@contextlib.contextmanager
def linked(config: TargetConfig, folder: Path, *, about: str = "", is_check: bool = False) -> Iterator[Link]:
    """Yield a link to the target. Relative paths in `config` refer to `folder`; no console log is kept.

    Remarks are `about` this target, where there are several; `is_check` as for `connect`.
    """

    def note(text: str) -> None:
        print_note(f"rtrun: {about}{text}")

    with (
        tempfile.TemporaryDirectory(prefix="rtrun-") as work,
        connect(config, folder, Path(work) / "console.log", notify=note, is_check=is_check) as target,
        Link(target, note) as link,
    ):
        yield link
