"""A lab of 64 boards for a month of nights: what is kept, shown and told, how long that takes, and who is called.

Each night every board is measured in two runs of one boot; the archive is put together, and `rtrun notify` asks what
somebody is to hear of. Planted are boards that get worse by 20 %, one of them known, and
boards in quarantine at a real labgrid coordinator. Runs are drawn as those of `tests/rtrun/archive/archived.py`: a boot
differs by 1 %. What measuring takes is in tests/bench/farm.py.
"""

import http.server
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from unittest import mock

from archive.archived import write_course
from labgrid_farm import farm_of

from rtrun.archive.compacting import compact
from rtrun.archive.store import make_archive

BOARDS = int(os.environ.get("BOARDS") or 64)
NIGHTS = 30
WORSE_FROM = {5: 8, 17: 13, 40: 18, 63: 22}
"""Boards that get worse, and the night from which on."""
KNOWN, KNOWN_SINCE = 17, 14
ILL_FROM = {2: 6, 33: 20}
"""Boards in quarantine, and since which night."""
TOLD_WITHIN = 6  # nights
# Of two tables: some packs, and the runs of the last night, for whoever reads them still.
FILES_MAX = 2 * (2 * BOARDS + 4)
NIGHT_S, HISTORY_S, SITE_S, FARM_S = 60.0, 3.0, 120.0, 5.0
RTRUN = (sys.executable, "-m", "rtrun.cli")


def name_of(board: int) -> str:
    return f"board-{board:02}"


def write_month(archive: Path) -> None:
    """All runs of the month, each in a file of its own."""
    for board in range(BOARDS):
        begin = WORSE_FROM.get(board, NIGHTS)
        levels = [100.0] * begin + [120.0] * (NIGHTS - begin)
        write_course(archive, levels, machine=name_of(board), seed=board)


def rtrun(*words: object) -> tuple[str, float]:
    """What a command prints, and the time that it took in s."""
    start = time.perf_counter()
    done = subprocess.run([*RTRUN, *map(str, words)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, time.perf_counter() - start


def receiving(nights_told: dict[str, list[int]], night: list[int]) -> http.server.ThreadingHTTPServer:
    """A web hook that writes down in which night it was told of what."""

    class Hook(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            for alarm in json.loads(self.rfile.read(int(self.headers["Content-Length"])))["alarms"]:
                # No place has an exporter, and in the first night all boards are new.
                if alarm["kind"] not in ("offline", "new"):
                    nights_told.setdefault(alarm["about"], []).append(night[0])
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hook)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def check_told(nights_told: dict[str, list[int]]) -> None:
    """Every planted thing once and in time, nothing that is known, and nothing else."""
    begun = {name_of(board): begin for board, begin in ILL_FROM.items()}
    scenario = next(about for about in nights_told if " on " in about).rpartition(" on ")[0]
    begun |= {f"{scenario} on {name_of(board)}": begin for board, begin in WORSE_FROM.items() if board != KNOWN}
    assert nights_told.keys() == begun.keys(), (nights_told, begun)
    for about, nights in nights_told.items():
        late = nights[0] - begun[about]
        print(f"{about}: from night {begun[about]} on, told {len(nights)} times, first {late} nights later")
        assert len(nights) == 1 and 0 <= late <= TOLD_WITHIN, about


def month(folder: Path) -> list[tuple[str, float, float, str]]:
    """Live through it; returns what it took, with a limit for each."""
    archive, later, nights_told, night = folder / "archive", folder / "later", {}, [0]
    store = make_archive(str(archive))
    with mock.patch("os.fsync"):
        write_month(later)
    (folder / "farm").mkdir()
    slowest_s = 0.0
    with (
        receiving(nights_told, night) as hook,
        farm_of(folder / "farm", {name_of(board): {} for board in range(BOARDS)}, {}) as farm,
    ):
        receiver = {"name": "chat", "kind": "hook", "url": f"http://127.0.0.1:{hook.server_port}/"}
        config = {"schema": 1, "coordinator": farm.coordinator, "receivers": [receiver]}
        (folder / "receivers.yml").write_text(json.dumps(config))
        for night[0] in range(NIGHTS):
            for path in later.glob(f"*/??{night[0]:060d}??.parquet"):
                (archive / path.parent.name).mkdir(exist_ok=True)
                path.rename(archive / path.parent.name / path.name)
            for board in (board for board, begin in ILL_FROM.items() if begin == night[0]):
                farm.client("-p", name_of(board), "set-tags", f"quarantine=since_night_{night[0]}")
            start = time.perf_counter()
            compact(store, grace=timedelta(hours=12), now=datetime.now(UTC) + timedelta(days=night[0]))
            if night[0] == KNOWN_SINCE:
                rtrun("archive", "annotate", archive, "--known", "--reason", "fan", "--machine", name_of(KNOWN))
            rtrun("notify", folder / "receivers.yml", archive)
            taken_s = time.perf_counter() - start
            print(f"night {night[0]}: {taken_s:.1f} s, told of {nights_told}", flush=True)
            slowest_s = max(slowest_s, taken_s)
        hook.shutdown()
        os.environ["LG_COORDINATOR"] = farm.coordinator
        printed, farm_s = rtrun("farm", "--archive", archive, "--json")
    places = json.loads(printed)["places"]
    assert len(places) == BOARDS and sum(place["quarantine"] is not None for place in places) == len(ILL_FROM)
    check_told(nights_told)
    printed, history_s = rtrun("history", archive, "--json")
    runs = sum(len(point["run_keys"]) for point in json.loads(printed)["points"])
    assert runs == BOARDS * NIGHTS * 2, runs
    _, site_s = rtrun("site", archive, "--output", folder / "site")
    page = (folder / "site" / "boards.html").read_text()
    assert f"✗ {len(WORSE_FROM) - 1} of {BOARDS} boards:" in page and page.count('<th scope="row">') == BOARDS
    files = sum(1 for path in archive.rglob("*") if path.is_file() and path.parent.name in ("runs", "histograms"))
    size = f"{BOARDS} boards, {NIGHTS} nights, {runs} runs"
    return [
        (f"{size}: the slowest night's compact and notify", slowest_s, NIGHT_S, "s"),
        (f"{size}: rtrun history", history_s, HISTORY_S, "s"),
        (f"{size}: rtrun site with its page of boards ({len(page) / 1e3:.0f} kB)", site_s, SITE_S, "s"),
        (f"{size}: rtrun farm", farm_s, FARM_S, "s"),
        (f"{size}: files of runs and histograms", files, FILES_MAX, ""),
    ]


def main() -> int:
    """Print every figure; 1 when one is beyond its limit."""
    with tempfile.TemporaryDirectory() as folder:
        checks = month(Path(folder))
    for name, value, limit, unit in checks:
        print(f"{name}: {value:.3g} {unit} (limit {limit:g} {unit})")
    return int(any(value > limit for _, value, limit, _ in checks))


if __name__ == "__main__":
    sys.exit(main())
