"""What the JSON of rt-tests and jitterdebugger states about its measurement: host, kernel, times, and how it ended."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtrun.results.importers.counts import words_in
from rtrun.results.record import moment
from rtrun.targets.inspection.facts import TargetState, is_preempt_rt

UTSNAME_MAX = 64  #: characters of a host, kernel or time in an imported file
_TIME = "%a, %d %b %Y %H:%M:%S %z"  # Thu, 26 Nov 2026 11:18:02 +0000


@dataclass(frozen=True, kw_only=True, slots=True)
class FileOrigin:
    """What a file states about where and when it was measured; None where it states nothing."""

    host: str | None = None
    kernel_release: str | None = None
    kernel_version: str | None = None
    machine: str | None = None
    preempt_rt: bool | None = None
    start: datetime | None = None
    end: datetime | None = None
    failure: str | None = None
    """How its program failed; None: it did not fail, or the file does not state it."""


NOWHERE = FileOrigin()


def read_origin(path: Path, data: dict[str, Any]) -> FileOrigin:
    """Read the origin from a JSON object. Raises UsageError ``file: key: what is wrong``."""
    system = data.get("sysinfo", {})
    if not isinstance(system, dict):
        raise UsageError(f"{path}: sysinfo: expected a mapping")
    version, realtime = _text(path, system, "version"), system.get("realtime")
    if realtime is not None and (isinstance(realtime, bool) or realtime not in (0, 1)):
        raise UsageError(f"{path}: sysinfo.realtime: expected 0 or 1, got {str(realtime)[:40]!r}")
    # Mainline's PREEMPT_RT has no /sys/kernel/realtime, so a 0 proves nothing.
    state = TargetState(kernel_version=version, realtime=None if realtime is None else str(realtime))
    status = data.get("return_code", 0)
    if isinstance(status, bool) or not isinstance(status, int):
        raise UsageError(f"{path}: return_code: expected a whole number, got {str(status)[:40]!r}")
    return FileOrigin(
        host=_text(path, system, "nodename"),
        kernel_release=_text(path, system, "release"),
        kernel_version=version,
        machine=_text(path, system, "machine"),
        preempt_rt=True if is_preempt_rt(state) else None if version is None else False,
        start=_time(path, data, "start_time"),
        end=_time(path, data, "end_time"),
        failure=f"return_code: {status}, expected 0" if status else None,
    )


def _text(path: Path, system: dict[str, Any], key: str) -> str | None:
    value = system.get(key)
    return None if value is None else words_in(path, f"sysinfo.{key}", value, most=UTSNAME_MAX) or None


def _time(path: Path, data: dict[str, Any], key: str) -> datetime | None:
    value = data.get(key)
    if value is None:
        return None
    text = words_in(path, key, value, most=UTSNAME_MAX)
    try:
        time = datetime.strptime(text, _TIME)
        moment(time.isoformat())
    except ValueError as error:
        raise UsageError(f"{path}: {key}: {text!r} is no time, as Thu, 26 Nov 2026 11:18:02 +0000") from error
    return time
