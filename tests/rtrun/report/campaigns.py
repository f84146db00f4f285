"""Campaigns as a board would leave them, made of numbers drawn by lot: run directories with npy, json and log."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from written import NOT_FIRED, write_output, write_record

Int64s = NDArray[np.int64]


def random_numbers(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def latencies(n: int, seed: int, mean_us: float = 90.0, spread_us: float = 8.0) -> Int64s:
    """Independent latencies with a tail of exponential kind."""
    values = mean_us + spread_us * (random_numbers(seed).gamma(4.0, 0.5, n) - 2)
    return (1000 * values).astype(np.int64)


def bursty(n: int, seed: int, mean_us: float = 90.0) -> Int64s:
    """Latencies that remember the ones before them (first order, 0.95)."""
    noise = random_numbers(seed).normal(size=n)
    state = np.empty(n)
    level = 0.0
    for i, step in enumerate(noise):
        level = 0.95 * level + 0.31 * step
        state[i] = level
    return (1000 * (mean_us + 10 * state)).astype(np.int64)


def oneshot_rows(latency_ns: Int64s, timeout_us: int, reported_off_ns: int = 8000, armed_after_ns: int = 0) -> Int64s:
    """Rows of one-shot measurements; `armed_after_ns` is the time from the start of each to the armed timer."""
    fired = latency_ns != NOT_FIRED
    step = timeout_us * 1000 + 150_000
    start = 5_000_000 + np.arange(latency_ns.size, dtype=np.int64) * step
    end = np.where(fired, start + timeout_us * 1000 + latency_ns, NOT_FIRED)
    reported = np.where(fired, latency_ns + reported_off_ns, NOT_FIRED)
    return np.stack([start, end, latency_ns, reported, start + armed_after_ns], axis=1)


WALL_NS = 1_800_000_000 * 10**9


def cyclic_rows(lateness_ns: Int64s, frequency_hz: int) -> Int64s:
    """Calls whose lateness against the ideal grid is given; shape (n + 1, 3), the first on the grid."""
    grid = np.arange(lateness_ns.size + 1, dtype=np.int64) * round(10**9 / frequency_hz)
    called = grid + np.concatenate(([0], lateness_ns))
    return np.stack([7_000_000 + called, WALL_NS + grid, WALL_NS + called], axis=1)


def communication_rows(latency_ns: Int64s, frequency_hz: int, lost: tuple[int, ...] = ()) -> Int64s:
    seq = np.setdiff1d(np.arange(latency_ns.size), np.array(lost, dtype=np.int64))
    sent = 9_000_000 + seq * 10**9 // frequency_hz
    return np.stack([sent, sent + latency_ns[seq], seq], axis=1)


def write_log(path: Path, suite: str, values_ns: Int64s, *, label: str, asked: int) -> None:
    """A log as suites.md has it."""
    us = np.floor_divide(values_ns, 1000)
    values_us, counts = np.unique(us, return_counts=True)
    low, high, mean = int(us.min()), int(us.max()), int(us.mean())
    summary = f"MIN: {low}us AVG: {mean}us MAX: {high}us"
    head = {
        "oneshot_timer_tests": f"# Measurement results with a loop length of {asked} and a timeout of 1000 us:",
        "cyclic_timer_tests": f"# Measurement results with a total of {asked} measurements and a frequency of 100Hz:",
        "communication_tests": f"# Amount messages: {asked}; Messages out of order: 0",
    }[suite]
    top = np.lexsort((np.arange(us.size), -us))[:10]
    lines = [
        f'set title "{suite} plot"',
        f'set xlabel "Latency in micro seconds - {summary}"',
        "set yrange [0.7:]",
        "set logscale y",
        f"set xrange [{low - 5}:{high + 5}]",
        "set terminal jpeg size 1920,1080",
        f'set output "{path.stem}.jpg"',
        "plot \"-\" u 1:2 t 'Occurrence' w steps",
        "# Plot data for gnuplot",
        head,
        f"# {label}\t{summary}",
        *([f"# {asked - us.size} timers didn't fire"] if suite.startswith("oneshot") and asked > us.size else []),
        "# Indices of top values(|latency:index|): |" + "".join(f"{us[i]}:{i}|" for i in top),
    ]
    filled = dict(zip(values_us.tolist(), counts.tolist(), strict=True))
    first = low if suite == "cyclic_timer_tests" else 0
    ordered = [value for value in values_us.tolist() if value < 0] if suite != "cyclic_timer_tests" else []
    lines += [
        f"{'-' if value < 0 else ''}{abs(value):06d} \t{filled.get(value, 0):06d}" for value in range(first, high + 1)
    ]
    if ordered:
        lines += ["# negative Values following", *(f"#-{-value:06d} \t{filled[value]:06d}" for value in ordered)]
    path.write_text("\n".join([*lines, "", "end"]) + "\n")


_OUTPUTS = {
    "oneshot_timer_tests": "oneshot_timer_tests_l{n}_tm{timeout_us}",
    "cyclic_timer_tests": "cyclic_timer_tests_l{n}_fq{frequency_hz}",
    "communication_tests": "ct_gnuplot_l{n}_fq{frequency_hz}_pl{payload_bytes}",
}


def write_run(
    root: Path,
    name: str,
    suite: str,
    outputs: list[Int64s],
    parameters: dict[str, Any],
    *,
    asked: int,
    platform: str = "hardware",
    logs: bool = True,
    **record: Any,
) -> Path:
    """Write and close a run directory; one output for each array of rows (the subscribers)."""
    folder = root / name
    folder.mkdir(parents=True)
    policy = parameters.get("policy", "0")
    parameters = {"policy": policy, "repetitions": asked, **parameters}
    base = _OUTPUTS[suite].format(n=asked, **parameters) + ("" if policy == "0" else f"-tnRT{policy}")
    names = []
    for k, rows in enumerate(outputs):
        output = base if len(outputs) == 1 else f"s{k}_{base}"
        names.append(output)
        _write_output(folder, output, suite, _begun_at(rows, suite, name), parameters, asked, logs)
    write_record(folder, suite, names, parameters, **{"campaign": root.name, "platform": platform, **record})
    return folder


def write_log_alone(root: Path, name: str, suite: str, rows: Int64s, parameters: dict[str, Any], **more: Any) -> Path:
    """A run as the programs of 2014 leave one: without samples."""
    folder = write_run(root, name, suite, [rows], parameters, **more)
    for path in [folder / "run.json", *folder.glob("*_l*.npy"), *folder.glob("*_l*.json")]:
        path.unlink()
    (log,) = folder.glob("*.log")
    write_record(folder, suite, [log.stem], parameters, **{key: more[key] for key in more if key != "asked"})
    return folder


def oneshot_run(
    root: Path,
    name: str,
    values: Int64s,
    *,
    policy: str = "RR",
    timeout_us: int = 1000,
    off_ns: int = 8000,
    armed_after_ns: int = 0,
    logs: bool = False,
    **record: Any,
) -> Path:
    """Write a run of a one-shot timer with these latencies; `parameters` of `record` are on top of the usual ones."""
    parameters = {"policy": policy, "timeout_us": timeout_us, "busy_mode": 0, **record.pop("parameters", {})}
    rows = [oneshot_rows(values, timeout_us, off_ns, armed_after_ns)]
    return write_run(root, name, "oneshot_timer_tests", rows, parameters, asked=values.size, logs=logs, **record)


def cyclic_run(
    root: Path, name: str, lateness: Int64s, *, policy: str = "RR", hz: int = 100, logs: bool = False, **record: Any
) -> Path:
    """Write a run of a cyclic timer with these latenesses; `parameters` as above."""
    parameters = {"policy": policy, "frequency_hz": hz, **record.pop("parameters", {})}
    rows = [cyclic_rows(lateness, hz)]
    return write_run(root, name, "cyclic_timer_tests", rows, parameters, asked=lateness.size, logs=logs, **record)


def message_run(
    root: Path,
    name: str,
    outputs: list[Int64s],
    *,
    policy: str = "RR",
    hz: int = 100,
    lost: tuple[int, ...] = (),
    logs: bool = False,
    **record: Any,
) -> Path:
    """Write a run of messages, with the latencies of each subscriber; `parameters` as above."""
    parameters = {"policy": policy, "frequency_hz": hz, "payload_bytes": 0, "subscribers": len(outputs)}
    parameters |= record.pop("parameters", {})
    rows, asked = [communication_rows(values, hz, lost) for values in outputs], outputs[0].size
    return write_run(root, name, "communication_tests", rows, parameters, asked=asked, logs=logs, **record)


def at_minute(minute: int) -> dict[str, str]:
    """The times of a run that began in this minute, for `record`."""
    return {f"{what}_time": f"2026-01-01T00:{minute:02}:{s:02}+00:00" for what, s in (("start", 0), ("end", 30))}


def _begun_at(rows: Int64s, suite: str, run: str) -> Int64s:
    """The rows with the times of a run of its own: two runs never measure at the same ones."""
    of_times = {"oneshot_timer_tests": [0, 1, 4], "cyclic_timer_tests": [0]}.get(suite, [0, 1])[: rows.shape[1]]
    times = rows[:, of_times]
    begun = rows.copy()
    begun[:, of_times] = np.where(times == NOT_FIRED, NOT_FIRED, times + zlib.crc32(run.encode()))
    return begun


def _write_output(
    folder: Path, output: str, suite: str, rows: Int64s, parameters: dict[str, Any], asked: int, logs: bool
) -> None:
    counts = {"asked": asked}
    if suite == "oneshot_timer_tests":
        values = rows[:, 2][rows[:, 2] != NOT_FIRED]
        counts["not_fired"] = asked - values.size
        label, names = "Measured:", [f"{output}-measured.log"]
    elif suite == "cyclic_timer_tests":
        values = np.diff(rows[:, 0]) - round(1e9 / parameters["frequency_hz"])
        label, names = "Jitter:", [f"{output}.log"]
    else:
        values = rows[:, 1] - rows[:, 0]
        counts["missing"] = asked - values.size
        label, names = "Latency:", [f"{output}.log"]
    if not logs:
        names = []
    write_output(folder, output, suite, rows, requested=parameters, logs=names, measured=values.size, **counts)
    if values.size:
        for name in names:
            write_log(folder / name, suite, values, label=label, asked=asked)


def write_campaign(root: Path, *, n: int = 20_000, platform: str = "hardware", seed: int = 0) -> Path:
    """One-shot, cyclic and communication runs with and without policy, one and five subscribers."""
    for k, policy in enumerate(("RR", "FIFO", "0"), start=1):
        spread = 8.0 if policy != "0" else 300.0
        for timeout in (1000, 10000):
            mean = 98.0 if timeout == 1000 else 150.0
            values = latencies(n, seed + k + timeout, mean, spread)
            if policy == "0":
                values = values.copy()
                values[n // 2] = NOT_FIRED
            name = f"{k:03d}-oneshot-tm{timeout}-{policy}"
            rows = oneshot_rows(values, timeout, 8000 if policy != "0" else 3_000_000)
            parameters = {"policy": policy, "timeout_us": timeout, "busy_mode": 0}
            write_run(root, name, "oneshot_timer_tests", [rows], parameters, asked=n, platform=platform)
        name = f"{k:03d}-cyclic-{policy}"
        rows = cyclic_rows(latencies(n, seed + 50 + k, 90.0, spread), 1000)
        parameters = {"policy": policy, "frequency_hz": 1000}
        write_run(root, name, "cyclic_timer_tests", [rows], parameters, asked=n, platform=platform)
        for subscribers in (1, 5):
            outputs = []
            for s in range(subscribers):
                values = latencies(n, seed + 70 + k + s, 224.0 + 40 * s, spread)
                values[0] = 538_000
                outputs.append(communication_rows(values, 100))
            name = f"{k:03d}-comm-{subscribers}sub-{policy}"
            parameters = {"policy": policy, "frequency_hz": 100, "payload_bytes": 200, "subscribers": subscribers}
            write_run(root, name, "communication_tests", outputs, parameters, asked=n, platform=platform)
    return root
