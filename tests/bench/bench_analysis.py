"""How fast and how frugal the analysis is, as ratios in one run; `--check` makes it exit 1 when a bound is missed.

    .venv/bin/python tests/bench/bench_analysis.py [--check] [--runs 92] [--samples 2000000]

Every run of two million messages has samples of its own: copies are told, and not judged. Some GB are written.
"""

import argparse
import hashlib
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

# The package before tests, whose folder rtrun has its name.
sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "runner"))
sys.path.insert(0, str(Path(__file__).parents[1] / "rtrun"))
sys.path.insert(0, str(Path(__file__).parents[1] / "rtrun" / "report"))
import archived_year  # type: ignore[import-not-found]
from campaigns import communication_rows, latencies, oneshot_run, write_campaign, write_run  # type: ignore[import-not-found]

from measured import Measured, measured
from rtrun.analysis.figures import PERCENTILES, figures_of_samples
from rtrun.analysis.histogram import from_samples
from rtrun.kinds.values import Int64s

Check = tuple[str, float, float, str]
# Our time is about the same for all kinds, that of pandas is less where values are wide.
SHARE_OF_PANDAS = {"narrow": 0.25, "wide lognormal": 0.3, "one value of 50 ms": 0.25}
# Processor time of whole processes: 0.42 to 0.49 beside much else; most of it are imports of numpy, pydantic and rich.
SHOW_OF_PANDAS = 0.5
# In imports of pandas. Such an import takes 0.36 s, a report of 2 runs 0.6 s, one of 15 with three suites 1.0 s.
REPORT_IN_IMPORTS = {2: 2.5, 15: 4.0}
# How many times as long as numpy's bincount of as many values into 8192 bins. The wish is 25 ms for 2 million samples;
# bincount alone takes 5 to 20 ms of them, depending on the machine and on what else runs there.
COUNTS_OF_FIGURES = 3.5
# How many times as long as a bare interpreter. The wish is 150 ms, and a bare interpreter takes 30 to 55 ms.
STARTS_OF_HELP = 5.0
# Highest memory of the process alone. 2026-11-26, x86-64 with 2 CPUs, Debian 12's Python 3.11: `show` of two million
# messages had 114 MiB; a report of 4 such runs 230 MiB, of 92 runs 274 MiB.
SHOW_MIB, REPORT_MIB = 150.0, 350.0
RTRUN = Path(sys.executable).parent / "rtrun"
_BARE = "python -c ''"
_IDLE_MS = 60.0  # a bare interpreter starts in half of that on the machine the bounds are for


def median_s(work: Callable[[], object], times: int) -> float:
    """Median seconds of so many calls, after one that warms up."""
    work()
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def ratio(work: Callable[[], object], other: Callable[[], object], times: int) -> float:
    """Median of the processor seconds of `work` over those of `other`, each pair one right after the other.

    What else runs on the machine slows both of a pair.
    """

    def seconds(called: Callable[[], object]) -> float:
        start = time.process_time()
        called()
        return time.process_time() - start

    work(), other()
    return statistics.median(seconds(work) / seconds(other) for _ in range(times))


def kinds(n: int) -> dict[str, Int64s]:
    """Samples of several kinds: narrow, wide, and narrow with one value of 50 ms."""
    narrow = latencies(n, 1)
    outlier = narrow.copy()
    outlier[n // 3] = 50_000_000
    wide = (50_000 * np.random.default_rng(3).lognormal(0, 1.5, n)).astype(np.int64)
    return {"narrow": narrow, "wide lognormal": wide, "one value of 50 ms": outlier}


def figures(n: int) -> list[Check]:
    """All figures, and counts in 1 us bins, against one count of as many values and against pandas.

    Pandas makes the same figures and counts of the same samples.
    """
    import pandas

    shares = [p / 100 for p in PERCENTILES]
    bins = np.random.default_rng(1).integers(0, 8192, n).astype(np.uint16)
    checks: list[Check] = []
    for kind, values in kinds(n).items():
        assert figures_of_samples(values).n == from_samples(values).counts.sum() == n
        series = pandas.Series(values)

        def figured(values: Int64s = values) -> object:
            return figures_of_samples(values)

        def counted(values: Int64s = values) -> object:
            return from_samples(values)

        def ours(values: Int64s = values) -> object:
            return figures_of_samples(values), from_samples(values)

        def theirs(series: "pandas.Series[int]" = series) -> object:
            return series.describe(shares), series.nlargest(10), series.nsmallest(10), (series // 1000).value_counts()

        for name, work in (("figures", figured), ("histogram in 1 us bins", counted)):
            times = ratio(work, lambda: np.bincount(bins, minlength=8192), 15)
            checks.append((f"{name}, {kind}", 1000 * median_s(work, 9), float("inf"), "ms"))
            checks.append((f"{name}, {kind}, in counts of as many values", times, COUNTS_OF_FIGURES, ""))
        checks.append(
            (f"figures and counts, {kind}, share of pandas", ratio(ours, theirs, 9), SHARE_OF_PANDAS[kind], "")
        )
    small, large = latencies(n, 1), latencies(4 * n, 2)
    longer = ratio(lambda: figures_of_samples(large), lambda: figures_of_samples(small), 9)
    return [*checks, ("figures, 4 times the samples take so many times as long", longer, 6.0, "")]


def messages_campaign(root: Path, runs: int, n: int) -> None:
    """Write so many runs of one scenario, each with its own messages."""
    parameters = {"policy": "RR", "frequency_hz": 1000, "payload_bytes": 200, "subscribers": 1}
    for k in range(runs):
        rows = communication_rows(latencies(n, k, 210.0), 1000)
        write_run(root, f"{k:03d}-comm", "communication_tests", [rows], parameters, asked=n, logs=False)


def check_judged(answers: str, scenarios: int, measurements: int) -> None:
    """The answers that `rtrun report` prints are of so many scenarios and measurements, none left out.

    The first message of a run is its start-up, and in no figure.
    """
    judged = [int(re.sub(r"\D", "", n)) for n in re.findall(r"(?<=\d) of (\d[\d ]*\d)  ", answers)]
    if "NOT ANALYSED" in answers or len(judged) != scenarios or sum(judged) != measurements:
        raise RuntimeError(
            f"{sum(judged)} of {measurements} measurements judged, {len(judged)} of {scenarios} scenarios:\n{answers}"
        )


def report(runs: int, n: int) -> list[Check]:
    """One report over everything, in a process of its own whose memory is measured."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "long"
        messages_campaign(root, runs, n)
        start = time.perf_counter()
        done = measured([RTRUN, "report", root])
        taken = time.perf_counter() - start
        check_judged(done.stdout, 1, runs * (n - 1))
        print(done.stdout.splitlines()[0], "; page", (root / "report.html").stat().st_size // 1024, "KiB")
        print("sha256 of the page", hashlib.sha256((root / "report.html").read_bytes()).hexdigest()[:16])
    return [
        (f"report of {runs} runs of {n} samples", taken, 60.0 * runs * n / 184e6, "s"),
        ("its highest memory", done.peak_mib, REPORT_MIB, "MiB"),
    ]


_PANDAS = """
import sys, numpy, pandas
rows = numpy.load(sys.argv[1])
series = pandas.Series(rows[:, 1] - rows[:, 0])
print(series.describe([0.5, 0.9, 0.99, 0.999]), series.nlargest(10), series.nsmallest(10))
print((series // 1000).value_counts())
"""


def least(times: int, *commands: Sequence[str | Path]) -> list[Measured]:
    """Of so many whole processes of each command, in turn, those with the least processor time."""
    taken = [[measured(command) for command in commands] for _ in range(times)]
    return [min(of_command, key=lambda run: run.cpu_s) for of_command in zip(*taken, strict=True)]


def whole_processes(n: int) -> list[Check]:
    """`rtrun show` beside pandas, and `rtrun report` beside the import of pandas, each as processes."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        messages_campaign(root / "one", 1, n)
        samples = next((root / "one").glob("*/*.npy"))
        ours, theirs = [RTRUN, "show", samples], [sys.executable, "-c", _PANDAS, samples]
        show, pandas, bare = least(11, ours, theirs, [sys.executable, "-c", "import pandas"])
        if f" {n - 1} " not in show.stdout or f"{n:.6e}" not in pandas.stdout:
            raise RuntimeError(f"not all of {n} messages are in the figures:\n{show.stdout}\n{pandas.stdout}")
        messages_campaign(root / "2", 2, 500)
        write_campaign(root / "15", n=500, platform="emulated")
        checks: list[Check] = [
            ("rtrun show, processor time", show.cpu_s, float("inf"), "s"),
            ("rtrun show, share of pandas as a process", show.cpu_s / pandas.cpu_s, SHOW_OF_PANDAS, ""),
            ("rtrun show, highest memory", show.peak_mib, SHOW_MIB, "MiB"),
        ]
        # Six one-shot runs, three cyclic ones whose first two values are in no figure, messages to 18 subscribers.
        judged = {2: (1, 2 * 499), 15: (15, 6 * 500 + 3 * 498 + 18 * 499)}
        for runs, bound in REPORT_IN_IMPORTS.items():
            (done,) = least(3, [RTRUN, "report", root / str(runs), "--output", root / "page.html"])
            check_judged(done.stdout, *judged[runs])
            name = f"rtrun report of {runs} runs, processor time"
            checks += [
                (name, done.cpu_s, float("inf"), "s"),
                (f"{name}, in imports of pandas", done.cpu_s / bare.cpu_s, bound, ""),
            ]
        return checks


# Behind a page: leaves the seconds from when the page was asked for until something was shown, and its first picture.
_TIMED = """<script>
onload = () => {
  const shown = performance.getEntriesByName("first-contentful-paint").map((entry) => entry.startTime);
  const height = document.querySelector("details[open] .frame svg").getBoundingClientRect().height;
  const drawn = performance.now();  // a page that is complete before anything is painted is shown no sooner
  document.body.textContent = `seconds ${(shown[0] ?? drawn) / 1000} ${height && drawn / 1000}`;
};
</script>"""


def seconds_to_open(page: Path) -> tuple[float, float]:
    """Seconds from the request for a page until Chromium shows something of it, and until its pictures are laid out."""
    with page.open("a") as text:
        text.write(_TIMED)
    chromium = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--dump-dom"]
    command = [*chromium, "--window-size=1400,900", f"--user-data-dir={page.with_suffix('')}", f"file://{page}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    taken = re.search(r">seconds ([0-9.]+) ([0-9.]+)<", done.stdout)
    if taken is None:
        raise RuntimeError(f"Chromium did not open {page.name}:\n{done.stdout[-500:]}\n{done.stderr[-500:]}")
    return float(taken[1]), float(taken[2])


def reports() -> list[Check]:
    """Reports of 10 and of 200 scenarios: processor time, size; and until Chromium shows answer and pictures."""
    checks: list[Check] = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number, wish_s in ((10, 1.5), (200, 6.0)):
            for k in range(number):
                values = latencies(2000, k, mean_us=90.0 + k)
                parameters = {"condition": f"load-{k}"}
                oneshot_run(root / str(number), f"{k:03d}", values, parameters=parameters)
            page = root / f"{number}.html"
            (done,) = least(3, [RTRUN, "report", root / str(number), "--deadline", "95us", "--output", page])
            check_judged(done.stdout, number, number * 2000)
            checks += [
                (f"rtrun report of {number} scenarios, processor time", done.cpu_s, wish_s, "s"),
                (f"its page of {number} scenarios", page.stat().st_size / 1e6, 0.15 * number, "MB"),
            ]
        shown_s, drawn_s = seconds_to_open(root / "10.html")
    return [
        *checks,
        ("a report of 10 scenarios shows its answer in Chromium", shown_s, 1.0, "s"),
        ("a report of 10 scenarios shows its first pictures in Chromium", drawn_s, 1.0, "s"),
    ]


def start_up() -> list[Check]:
    """`rtrun --help`, and a bare interpreter beside it."""
    assert "usage: rtrun" in measured([RTRUN, "--help"]).stdout
    ours_s = median_s(lambda: subprocess.run([RTRUN, "--help"], capture_output=True, check=True), 9)
    bare_s = median_s(lambda: subprocess.run([sys.executable, "-c", ""], capture_output=True, check=True), 9)
    return [
        ("rtrun --help", 1000 * ours_s, float("inf"), "ms"),
        (_BARE, 1000 * bare_s, float("inf"), "ms"),
        ("rtrun --help, in starts of a bare interpreter", ours_s / bare_s, STARTS_OF_HELP, ""),
    ]


def main() -> int:
    """Measure, print, and with --check judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit 1 when a bound is missed")
    parser.add_argument("--runs", type=int, default=92)
    parser.add_argument("--samples", type=int, default=2_000_000)
    args = parser.parse_args()
    np.seterr(all="raise")
    checks = [
        *start_up(),
        *figures(args.samples),
        *whole_processes(args.samples),
        *reports(),
        *report(args.runs, args.samples),
        *archived_year.history(),
        *archived_year.lab(),
    ]
    # Times of a busy machine say nothing; ratios and memory do.
    busy = next(value for name, value, _, _ in checks if name == _BARE) > _IDLE_MS
    missed = 0
    for name, value, bound, unit in checks:
        over = value > bound
        excused = over and busy and unit in ("ms", "s")
        missed += over and not excused
        limit = "" if bound == float("inf") else f"at most {bound:g} {unit}"
        print(f"{'busy' if excused else 'MISSED' if over else 'ok':6}  {name}: {value:.3g} {unit} {limit}".rstrip())
    return 1 if args.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
