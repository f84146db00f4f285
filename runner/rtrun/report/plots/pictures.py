"""The picture next to every log: ``<name>.jpg`` for ``<name>.log``, drawn by gnuplot.

gnuplot could draw a log directly, but a log comes from a target, and gnuplot would obey commands in its lines
(``system``, backquotes). So the log is read, and gnuplot draws our own script with the log's numbers.
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.results.gnuplot_log import Log, read_log

_TIMEOUT_S = 60


def draw_all(logs: Iterable[Path]) -> list[str]:
    """Draw every log that has no picture or an older one. Returns what could not be drawn, one line each.

    Raises InfrastructureError when there is no gnuplot or a folder cannot be written.
    """
    stale = [log for log in logs if _is_stale(log)]

    def attempt(path: Path) -> str | None:
        try:
            draw(path)
        except UsageError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(max_workers=min(2, os.cpu_count() or 1)) as pool:
        return [problem for problem in pool.map(attempt, stale) if problem]


def _is_stale(log: Path) -> bool:
    picture = log.with_suffix(".jpg")
    return not picture.exists() or picture.stat().st_mtime < log.stat().st_mtime


def draw(path: Path) -> Path:
    """Draw a log and return its picture. Raises UsageError if it is not a log, InfrastructureError without gnuplot."""
    log = read_log(path)
    picture = path.with_suffix(".jpg")
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".picture.", suffix=".jpg")
        os.close(handle)
    except OSError as error:
        raise InfrastructureError(f"{path.parent}: cannot write the pictures: {error.strerror}") from error
    temporary = Path(name)
    try:
        done = subprocess.run(
            ["gnuplot", "-"],
            input=script(log, temporary.name),
            cwd=path.parent,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode or not temporary.stat().st_size:
            messages = done.stderr.strip().splitlines() or ["no message"]
            raise InfrastructureError(f"{path}: gnuplot failed: {messages[-1]}")
        temporary.chmod(0o644)
        temporary.replace(picture)
    except FileNotFoundError as error:
        raise InfrastructureError("gnuplot is not installed: apt-get install gnuplot-nox") from error
    except subprocess.TimeoutExpired as error:
        raise InfrastructureError(f"{path}: gnuplot took longer than {_TIMEOUT_S} s") from error
    finally:
        temporary.unlink(missing_ok=True)
    return picture


def script(log: Log, output: str) -> str:
    """The gnuplot script of a log: the picture that the log's own commands make, but only words of its text."""
    title = re.sub(r"[^A-Za-z0-9 .,:=+_()-]", " ", log.path.stem).replace("_", r"\\_")
    n = int(log.count.sum())
    lines = [
        "set terminal jpeg size 1920,1080",
        f"set output '{output}'",
        f'set title "{title}: {n} measurements"',
        'set xlabel "value in us"',
        'set ylabel "count"',
        "set yrange [0.7:]",
        "set logscale y",
        "set grid",
    ]
    if not n:
        return (
            "\n".join([*lines, 'set label 1 "no measurement" at graph 0.5,0.5 center', "plot [0:1] 1 notitle"]) + "\n"
        )
    low, high = int(log.value_us[0]), int(log.value_us[-1])
    edge = max(5, (high - low) // 20)
    lines += [f"set xrange [{low - edge}:{high + edge}]", 'plot "-" using 1:2 with steps lc rgb "#0072B2" notitle']
    previous = low - 1
    lines.append(f"{previous} 0.1")
    for value, count in zip(log.value_us.tolist(), log.count.tolist(), strict=True):
        # Empty bins are included only at the edges of filled ranges: a log of seconds has a million of them.
        if value > previous + 1:
            lines.append(f"{previous + 1} 0.1")
        lines.append(f"{value} {count}")
        previous = value
    return "\n".join([*lines, f"{previous + 1} 0.1", "e"]) + "\n"
