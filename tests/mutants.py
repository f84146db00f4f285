"""Mutants of the rooms that decide: constants and comparisons, each against the tests that execute its line.

    make mutants SEED=1                       # 300 of them; exit status 1 where fewer than 85 % die
    python tests/mutants.py --seed 1 --number 300

A test that fails kills a mutant. One that takes too long counts as dead only if it does so once more, alone. Mutants
that no test can tell from the original are listed in mutants_equivalent.tsv, each with the reason.
"""

import argparse
import ast
import json
import multiprocessing
import os
import random
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("analysis", "flows", "judgement", "evidence", "validity", "kinds")
# Their tests, and those of what asks them.
TESTED = (*ROOMS, "plan", "results", "report", "commands", "thesis")
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.tsv")
FOUND = ROOT / "build/mutants"
LEAST_DEAD, MOST_EQUIVALENT = 0.85, 0.05
# The quickest tests of a line, for so long at most; a mutant may take some times longer.
TESTS_S, SLOWER, START_S = 90.0, 5, 60.0
COMPARED: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.In: "not in", ast.NotIn: "in", ast.Is: "is not", ast.IsNot: "is",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """A change of one place: `path` below the root, the place in its bytes, and what stands there instead."""

    path: str
    line: int
    begin: int
    end: int
    was: str
    now: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.was} -> {self.now}"

    def apply(self, source: bytes) -> bytes:
        return source[: self.begin] + self.now.encode() + source[self.end :]


def mutants_of(path: Path, rng: random.Random) -> Iterator[Mutant]:
    """All mutants of a module, one for each constant and comparison."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    name = str(path.relative_to(ROOT))

    def mutant(node: ast.expr, begin: int, end: int, now: str) -> Mutant:
        return Mutant(path=name, line=node.lineno, begin=begin, end=end, was=source[begin:end].decode(), now=now)

    def place(line: int | None, column: int | None) -> int:
        assert line is not None and column is not None
        return starts[line - 1] + column

    tree = ast.parse(source)
    # A text with values in it has no places of its own in older versions of Python.
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in inner:
            continue
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            begin, end = place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset)
            yield mutant(node, begin, end, changed(node.value, rng))
        elif isinstance(node, ast.Compare):
            for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                begin = place(left.end_lineno, left.end_col_offset)
                end = place(right.lineno, right.col_offset)
                between = source[begin:end].decode()
                # With brackets between, the place is not certain.
                if between.strip(" \n") in COMPARED.values():
                    yield mutant(left, begin, end, f" {COMPARED[type(operator)]} ")


def changed(number: int | float, rng: random.Random) -> str:
    """A number as somebody might have it wrong: by one, or by a factor."""
    if isinstance(number, float):
        return repr(number * rng.choice([0.5, 2.0, 10.0])) if number else "1.0"
    if abs(number) < 10:
        return repr(number + 1)
    return repr(rng.choice([number + 1, number * 10, number // 2]))


def sample(seed: int, number: int) -> list[Mutant]:
    """Mutants drawn at random from all rooms."""
    rng = random.Random(seed)
    paths = sorted(path for room in ROOMS for path in (ROOT / "runner/rtrun" / room).rglob("*.py"))
    every = [mutant for path in paths for mutant in mutants_of(path, rng)]
    return rng.sample(every, min(number, len(every)))


Lines = Mapping[tuple[str, int], Sequence[str]]


def tests_of_lines(folder: Path) -> tuple[Lines, dict[str, float]]:
    """Which test functions execute each line, and how long each takes; of this state of the code, found once."""
    kept = FOUND / "tests_of_lines.json"
    state = subprocess.run(["git", "write-tree"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    if not kept.exists() or json.loads(kept.read_text())["state"] != state:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({"state": state, **_traced(folder)}))
    found = json.loads(kept.read_text())
    lines = {
        (path, int(line)): names
        for path, names_by_line in found["lines"].items()
        for line, names in names_by_line.items()
    }
    return lines, found["seconds"]


def _traced(folder: Path) -> dict[str, object]:
    tree = _copy(folder / "traced")
    (tree / "coverage.ini").write_text(
        "[run]\ndynamic_context = test_function\nsource = runner/rtrun\n[json]\nshow_contexts = True\n"
    )
    files = sorted(
        f"tests/rtrun/{room}/{path.name}" for room in TESTED for path in (tree / "tests/rtrun" / room).glob("test_*.py")
    )
    seconds: dict[str, float] = {}
    command = [sys.executable, "-m", "coverage", "run", "--rcfile=coverage.ini", "-a", "-m", "pytest", "-q"]
    for file in files:
        subprocess.run([*command, "--junitxml=times.xml", file], cwd=tree, capture_output=True)
        for case in ElementTree.parse(tree / "times.xml").iter("testcase"):
            name = f"{file}::{case.get('name', '').partition('[')[0].partition('@')[0]}"
            seconds[name] = seconds.get(name, 0.0) + float(case.get("time", 0))
    subprocess.run(
        [sys.executable, "-m", "coverage", "json", "--rcfile=coverage.ini", "-q", "-o", "lines.json"],
        cwd=tree,
        check=True,
    )
    lines: dict[str, dict[str, list[str]]] = {}
    for path, found in json.loads((tree / "lines.json").read_text())["files"].items():
        tests_by_line = {line: sorted(filter(None, map(_node_id, names))) for line, names in found["contexts"].items()}
        lines[path] = {line: names for line, names in tests_by_line.items() if names}
    return {"lines": lines, "seconds": seconds}


def _node_id(context: str) -> str:
    """tests.rtrun.flows.test_calls.test_x is tests/rtrun/flows/test_calls.py::test_x."""
    module, _, function = context.rpartition(".")
    return f"{module.replace('.', '/')}.py::{function}" if module.startswith("tests.") else ""


def _copy(folder: Path) -> Path:
    """All files that git knows, in a folder of their own."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target, follow_symlinks=False)
    return folder


def examine(work: tuple[Mutant, Sequence[str], float, Path]) -> str:
    """What became of a mutant: dead, alive, late, or untested."""
    mutant, tests, limit_s, folder = work
    if not tests:
        return "untested"
    tree = folder / f"tree-{os.getpid()}"
    if not tree.exists():
        _copy(tree)
    module = tree / mutant.path
    source = module.read_bytes()
    module.write_bytes(mutant.apply(source))
    try:
        done = subprocess.run(
            [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests],
            cwd=tree, capture_output=True, timeout=limit_s,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "late"
    finally:
        module.write_bytes(source)
    return "alive" if done.returncode == 0 else "dead"


def chosen(names: Sequence[str], seconds: Mapping[str, float]) -> tuple[list[str], float]:
    """The quickest of these tests, and how long they take."""
    tests, total_s = [], 0.0
    for name in sorted(names, key=lambda test: seconds.get(test, 0.0)):
        total_s += seconds.get(name, 0.0)
        if tests and total_s > TESTS_S:
            break
        tests.append(name)
    return tests, min(total_s, TESTS_S)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=300)
    args = parser.parse_args()
    rows = [line.split("\t") for line in EQUIVALENT.read_text().splitlines() if line and not line.startswith("#")]
    equivalent = {(path, was, now) for path, was, now, _ in rows}
    mutants = sample(args.seed, args.number)
    real = [mutant for mutant in mutants if (mutant.path, mutant.was.strip(), mutant.now.strip()) not in equivalent]
    with tempfile.TemporaryDirectory(prefix="rt-tests-mutants-") as name:
        folder = Path(name)
        lines, seconds = tests_of_lines(folder)
        works = []
        for mutant in real:
            tests, total_s = chosen(lines.get((mutant.path, mutant.line), ()), seconds)
            works.append((mutant, tests, START_S + SLOWER * total_s, folder))
        with multiprocessing.Pool(min(2, os.cpu_count() or 1)) as pool:
            ends = []
            for work, end in zip(works, pool.imap(examine, works), strict=True):
                ends.append(end)
                if end != "dead":
                    print(f"{end:8} {work[0]}", flush=True)
        # Alone, what took too long beside others.
        ends = [examine(work) if end == "late" else end for work, end in zip(works, ends, strict=True)]
    dead = sum(end in ("dead", "late") for end in ends)
    equal = len(mutants) - len(real)
    print(
        f"{dead} of {len(real)} mutants die ({dead / max(1, len(real)):.0%}); {equal} of {len(mutants)} are equivalent"
    )
    return 0 if dead >= LEAST_DEAD * len(real) and equal <= MOST_EQUIVALENT * len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
