"""Logs that programs really wrote. tests/data keeps them without the rows of empty bins; here they are whole.

`000003 to 002849 \\t000000` in such a file stands for a row for each of these bins.
"""

import atexit
import re
import shutil
import tempfile
from pathlib import Path

_EMPTY = re.compile(r"^(-?)(\d{6}) to -?(\d{6}) \t000000\n", re.MULTILINE)


def _rows(match: re.Match) -> str:
    first, last = int(match[2]), int(match[3])
    bins = range(first, last + 1) if first < last else range(first, last - 1, -1)
    return "".join(f"{match[1]}{value:06d} \t000000\n" for value in bins)


def _written_whole() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="rt-tests-logs-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path in Path(__file__).parent.glob("data/*/*"):
        copy = folder / path.parent.name / path.name
        copy.parent.mkdir(exist_ok=True)
        if path.suffix == ".log":
            copy.write_text(_EMPTY.sub(_rows, path.read_text()))
        else:
            shutil.copy(path, copy)
    return folder


DATA = _written_whole()  # tests/data with whole logs
LOGS_2014 = DATA / "2014"
SUITES = DATA / "suites"
