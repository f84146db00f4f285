"""The suites, built natively, on a real ROS master; and what their outputs must have in common."""

import contextlib
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import time
import xmlrpc.client
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rtfiles.config import read_yaml
from rtgen import suites as builder

NOT_FIRED = np.iinfo(np.int64).min
HIST_LINE = re.compile(r"^(#?)(-?\d{6,}) \t(\d{6,})$")
UNIT_SOURCE = Path(__file__).parents[2] / "recipes-tests" / "unit_tests"
UNIT_BUILD = Path(__file__).parents[2] / "build" / "suites-unit"
PROGRAMS = {
    "oneshot_timer_tests": "oneshot_timer_tests",
    "cyclic_timer_tests": "cyclic_timer_tests",
    "communication_tests_publisher": "communication_tests",
    "communication_tests_subscriber": "communication_tests",
}


@pytest.fixture(scope="session")
def suites(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the native build."""
    return builder.build("host", tmp_path_factory.mktemp("suites"))


@pytest.fixture(scope="session")
def preloaded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the libraries that tests put before a program's own."""
    folder = tmp_path_factory.mktemp("preloaded")
    for source in (Path(__file__).parent / "preloaded").glob("*.cpp"):
        output_of("c++", "-shared", "-fPIC", "-O1", str(source), "-o", str(folder / source.stem), "-ldl")
    return folder


def options_of(program: str, middleware: str = "roscpp") -> dict[str, dict[str, Any]]:
    """What suites.yml says of the options that a program takes through a middleware."""
    known = read_yaml(builder.sources() / "suites.yml")
    keys = known["suites"][PROGRAMS[program]]["programs"][program]
    options = {key: known["options"][key] for key in keys if "flag" in known["options"][key]}
    return {
        key: option
        for key, option in options.items()
        if middleware in option.get("through", [middleware]) and middleware not in option.get("not_through", [])
    }


def defaults_of(program: str, middleware: str = "roscpp") -> dict[str, Any]:
    """What a program was requested to do where nobody gave it an option."""
    return {key: option["default"] for key, option in options_of(program, middleware).items()}


def output_of(*command: str) -> str:
    """What a tool says; a failure shows it."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}"
    return done.stdout


@pytest.fixture(scope="session")
def unit_build() -> Path:
    """The folder of the compiled unit tests; what did not change is not compiled again."""
    launcher = ["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else []
    UNIT_BUILD.mkdir(parents=True, exist_ok=True)
    with (UNIT_BUILD / ".lock").open("w") as lock:  # one worker builds
        fcntl.flock(lock, fcntl.LOCK_EX)
        output_of("cmake", "-G", "Ninja", "-S", str(UNIT_SOURCE), "-B", str(UNIT_BUILD), *launcher)
        output_of("ninja", "-C", str(UNIT_BUILD), "-j", "2")
    return UNIT_BUILD


@dataclass
class Bench:
    """Starts programs of the suites in a folder of their own, and ends them with the test."""

    suites: Path
    folder: Path
    environment: dict[str, str]
    started: list[subprocess.Popen[str]]
    middleware: str = "roscpp"

    def start(self, program: str, *arguments: str, before: tuple[str, ...] = ()) -> "subprocess.Popen[str]":
        executable = program if self.middleware == "roscpp" else f"{program}_{self.middleware}"
        (path,) = self.suites.glob(f"lib/*/{executable}")
        process = subprocess.Popen(
            [*before, str(path), *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.started.append(process)
        return process

    def run(self, program: str, *arguments: str, before: tuple[str, ...] = ()) -> "Ended":
        return end(self.start(program, *arguments, before=before))

    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())

    def subscribers(self) -> int:
        with xmlrpc.client.ServerProxy(self.environment["ROS_MASTER_URI"]) as master:
            state = master.getSystemState("/tests")[2]  # type: ignore[index]
        return sum(len(nodes) for topic, nodes in state[1] if topic == "/communication_tests")

    def communicate(self, *arguments: str, subscriber: tuple[str, ...] = ()) -> tuple["Ended", "Ended"]:
        """One subscriber and one publisher with the same arguments; what both said, the subscriber first."""
        receiver = self.start("communication_tests_subscriber", *arguments, *subscriber)
        wait_until(lambda: self.subscribers() == 1, receiver)
        sender = self.run("communication_tests_publisher", *arguments, "-d", "1")
        return end(receiver), sender


@dataclass(frozen=True)
class Ended:
    status: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()


def end(process: "subprocess.Popen[str]", timeout: float = 60) -> Ended:
    out, err = process.communicate(timeout=timeout)
    return Ended(process.returncode, out, err)


def wait_until(condition: Callable[[], bool], process: "subprocess.Popen[str]", timeout: float = 30) -> None:
    """Wait for a condition while a process runs."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def is_measuring(process: "subprocess.Popen[str]") -> bool:
    """Whether a program has caught SIGTERM, which it does when it begins to measure."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = int(re.search(r"^SigCgt:\s*(\w+)$", status, re.M)[1], 16)  # type: ignore[index]
    return bool(caught >> (signal.SIGTERM - 1) & 1)


def launch(bench: Bench, package: str, name: str, *words: str) -> str:
    """Have roslaunch start what a package's launch file names, and return what it says once all of it has ended."""
    roslaunch = shutil.which("roslaunch")
    assert roslaunch is not None
    environment = bench.environment | {
        "CMAKE_PREFIX_PATH": str(bench.suites),
        "ROS_PACKAGE_PATH": str(bench.suites / "share"),
        "ROS_HOME": str(bench.folder),  # where roslaunch starts nodes
    }
    process = subprocess.Popen(
        ["/usr/bin/python3", roslaunch, package, f"{name}.launch", *words],
        cwd=bench.folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        printed, _ = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            process.terminate()
            process.communicate()
    assert process.returncode == 0, printed
    return printed


@pytest.fixture
def bench(suites: Path, ros_master: int, tmp_path: Path) -> Iterator[Bench]:
    environment = os.environ | {
        "ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path / "ros-log"),
    }
    folder = tmp_path / "out"
    folder.mkdir()
    with ended(Bench(suites, folder, environment, [])) as bench:
        yield bench


@contextlib.contextmanager
def ended(bench: Bench) -> Iterator[Bench]:
    """A bench whose programs have ended afterwards."""
    yield bench
    for process in bench.started:
        if process.poll() is None:
            process.kill()
            process.communicate()


def summary_of(values: Any, indices: Any) -> dict[str, Any]:
    """What the json must say of a series (int64 ns), computed another way."""
    if len(values) == 0:
        return {"n": 0, "min_ns": None, "mean_ns": None, "max_ns": None, "top": [], "lowest": []}
    pairs = [(int(value), int(index)) for value, index in zip(values, indices, strict=True)]
    order = {index: at for at, (_, index) in enumerate(pairs)}
    top = sorted(pairs, key=lambda pair: (-pair[0], order[pair[1]]))[:10]
    lowest = sorted(pairs, key=lambda pair: (pair[0], order[pair[1]]))[:10]
    return {
        "n": len(pairs),
        "min_ns": lowest[0][0],
        "mean_ns": pytest.approx(sum(value for value, _ in pairs) / len(pairs), abs=0.51),
        "max_ns": top[0][0],
        "top": [{"value_ns": value, "index": index} for value, index in top],
        "lowest": [{"value_ns": value, "index": index} for value, index in lowest],
    }


def series_of(record: dict[str, Any], rows: Any) -> dict[str, tuple[Any, Any]]:
    """Values and indices of every series of a run, from its npy."""
    if record["suite"] == "oneshot_timer_tests":
        fired = rows[:, 1] != NOT_FIRED
        index = np.flatnonzero(fired)
        start, ended, measured, reported, armed = rows[fired].T
        assert np.array_equal(measured, ended - start - record["requested"]["timeout_us"] * 1000)
        assert (armed > start).all()
        measured_2014 = measured - (armed - start)
        return {
            "measured": (measured, index),
            "reported": (reported, index),
            "difference": (reported - measured, index),
            "measured_2014": (measured_2014, index),
            "difference_2014": (reported - measured_2014, index),
        }
    if record["suite"] == "cyclic_timer_tests":
        (stamps, expected, real), frequency = rows.T.tolist(), record["requested"]["frequency_hz"]
        pairs = range(max(len(stamps) - 1, 0))
        jitter = [stamps[i + 1] - stamps[i] - round(10**9 / frequency) for i in pairs]
        grid = [stamps[i + 1] - stamps[0] - (2 * (i + 1) * 10**9 + frequency) // (2 * frequency) for i in pairs]
        period = round(10**9 / frequency)
        passed = [expected[i + 1] - expected[i] for i in pairs]
        moved = [ns - ns // period * period if ns > period else 0 for ns in passed]
        lateness = [real[i + 1] - expected[i + 1] + moved[i] for i in pairs]
        return {"jitter": (jitter, pairs), "grid": (grid, pairs), "lateness": (lateness, pairs)}
    publication, reception, seq = rows.T
    return {"latency": (reception - publication, seq)}


def log_series(record: dict[str, Any]) -> list[str]:
    return {
        "oneshot_timer_tests": ["measured_2014", "reported", "difference_2014"],
        "cyclic_timer_tests": ["jitter"],
        "communication_tests": ["latency"],
    }[record["suite"]]


def histogram(log: str) -> Counter[int]:
    matches = [HIST_LINE.match(line) for line in log.splitlines()]
    return Counter({int(match[2]): int(match[3]) for match in matches if match and int(match[3]) > 0})


def check_rate(record: dict[str, Any], rows: Any) -> None:
    """Check the rate against the rows, computed another way."""
    suite, rate, asked_hz = record["suite"], record["rate"], record["requested"].get("frequency_hz")
    at_ns = rows[:, {"oneshot_timer_tests": 0, "cyclic_timer_tests": 0, "communication_tests": 1}[suite]]
    assert rate["asked_hz"] == asked_hz
    achieved_hz = None if len(rows) < 2 else pytest.approx(1e9 / np.diff(at_ns).mean(), rel=1e-6, abs=1e-6)
    assert rate["achieved_hz"] == achieved_hz
    skipped = overruns = None
    if suite == "cyclic_timer_tests":
        period_ns = round(1e9 / asked_hz)
        passed = np.maximum(np.diff(rows[:, 1]) // period_ns - 1, 0)
        skipped, late = int(passed.sum()), rows[:, 2] - rows[:, 1] > period_ns
        overruns = int(np.count_nonzero(late | np.append(passed > 0, False)[: len(rows)]))
    assert (rate["overruns"], rate["skipped"]) == (overruns, skipped)


def check_that_skipped_periods_make_up_the_time(rate: dict[str, Any], periods: int) -> None:
    """Of a program that was asked for more than it can do, at a real-time policy: another program's turn instead of
    its last period would be skipped, but not passed. An overrun may be late by more than what it skips.
    """
    assert rate["achieved_hz"] < 0.99 * rate["asked_hz"] and rate["overruns"] > 0
    passed = periods / rate["achieved_hz"] * rate["asked_hz"]
    assert periods + rate["skipped"] < 1.2 * passed
    assert periods + rate["skipped"] + rate["overruns"] > 0.8 * passed


def check_outputs(folder: Path, output: str, middleware: str = "roscpp") -> dict[str, Any]:
    """Read the json of a run, check npy, logs and pictures against it, and return it."""
    record: dict[str, Any] = json.loads((folder / f"{output}.json").read_text())
    rows = np.load(folder / f"{output}.npy", allow_pickle=False)
    assert rows.dtype == np.int64
    known = read_yaml(builder.sources() / "suites.yml")["suites"][record["suite"]]
    assert record["middleware"] == middleware
    assert (record["columns"], rows.shape[1]) == (known["columns"], len(known["columns"]))
    check_rate(record, rows)
    series = series_of(record, rows)
    assert record["summary"] == {name: summary_of(*pair) for name, pair in series.items()}
    assert record["counts"]["measured"] == len(series[log_series(record)[0]][0])
    assert record["complete"] == (record["incomplete_reason"] is None)
    assert record["files"]["npy"] == f"{output}.npy"
    for name, file in zip(log_series(record), record["files"]["logs"], strict=True):
        log = (folder / file).read_text()
        values = [int(value) for value in series[name][0]]
        # As in 2014: jitter is rounded down, latencies towards zero.
        microseconds = [value // 1000 if value >= 0 or name == "jitter" else -(-value // 1000) for value in values]
        assert histogram(log) == Counter(microseconds)
        assert log.endswith("\n\nend\n")
        assert f'set output "{output}' in log
        drawn = subprocess.run(["gnuplot", file], cwd=folder, capture_output=True, text=True, check=False)
        assert drawn.returncode == 0, drawn.stderr
        assert (folder / file).with_suffix(".jpg").read_bytes()[:3] == b"\xff\xd8\xff"
    return record
