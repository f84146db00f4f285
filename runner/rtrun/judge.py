"""What became of a run, from the files that were pulled back."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun import launch
from rtrun.logfile import read_log
from rtrun.samples import read_samples


def judge(
    folder: Path,
    programs: Sequence[launch.Program],
    exits: Sequence[launch.Exit],
    outputs: Sequence[str],
    refused: Mapping[str, str],
) -> tuple[str, str | None]:
    """Say what became of a run from what was pulled back, and why: the first thing that went wrong.

    `refused` are files that were not taken, name to reason.
    """
    for program, exit_ in zip(programs, exits, strict=True):
        if exit_.expired:
            return "failed", f"{program.name} did not end within {program.deadline_s:.0f} s and was ended"
        if exit_.status is None:
            return "failed", f"{program.name} was killed from outside"
        if exit_.status != 0:
            return "failed", f"{program.name} ended with exit status {exit_.status}: {_last_word(folder, program.name)}"
    for output in outputs:
        names = (f"{output}.json", f"{output}.npy")
        if found := [refused[name] for name in names if name in refused]:
            return "failed", found[0]
        missing = [name for name in names if not (folder / name).exists()]
        try:
            # The programs of 2014 write logs and nothing else.
            logs = [path for path in folder.glob("*.log") if path.name.startswith(output)] if len(missing) == 2 else []
            if missing and not logs:
                return "failed", f"{missing[0]} is missing though its program ended with exit status 0"
            for log in logs:
                read_log(log)
            record = None if logs else read_samples(folder / names[0]).record
        except UsageError as error:
            return "failed", str(error).replace(f"{folder}/", "")
        if record is not None and not record.complete:
            return "incomplete", f"{output}: {record.incomplete_reason or 'ended before all was measured'}"
    return "ok", None


def _last_word(folder: Path, program: str) -> str:
    path = folder / f"{program}.stderr"
    said = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    return next((line.strip()[:500] for line in reversed(said.splitlines()) if line.strip()), "it said nothing")
