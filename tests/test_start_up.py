"""How both programs start: what is imported, what Ctrl-C does before there is a command, and what the parsers take."""

import argparse
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from report.campaigns import write_campaign

import rtgen.cli
import rtrun.cli
from rtfiles.command import called_as, parser_of
from rtfiles.start import commands_of

SLOW = {
    "duckdb", "fsspec", "jinja2", "numpy", "paramiko", "pyarrow", "pydantic", "rich", "ruptures", "yaml",
}  # fmt: skip
PROGRAM = """
import sys
from {program}.cli import main
status = main({arguments})
print(*sorted(sys.modules), file=sys.stderr)
sys.exit(status)
"""
INTERRUPTED = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, *_):
        if name == "{program}.commands.{command}":
            os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupt())
from {program}.cli import main
sys.exit(main(["--help"]))
"""
PROGRAMS = {"rtgen": rtgen.cli.COMMANDS, "rtrun": rtrun.cli.COMMANDS}


def python(code: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
@pytest.mark.parametrize("program", PROGRAMS)
def test_nothing_slow_is_imported(program: str, arguments: list[str]) -> None:
    """Commands import in `run` what takes long to load."""
    done = python(PROGRAM.format(program=program, arguments=arguments))
    imported = set(done.stderr.split())
    assert done.returncode == 0 and "argparse" in imported
    assert not imported & SLOW


@pytest.mark.parametrize(
    ("command", "files", "others"),
    [
        ("show", "*/*.npy", {"rtrun.plan.run", "rtrun.results.gnuplot_log", "rtrun.results.record"}),
        ("show", "", {"jinja2", "numpy.ma"}),
        ("verdict", "", {"jinja2"}),
        ("claims", "", set()),
        ("report", "", set()),
    ],
)
def test_reading_results_loads_no_more_than_it_takes(
    command: str, files: str, others: set[str], tmp_path: Path
) -> None:
    """scipy is not installed for it, and paramiko takes longer to load than a small report takes."""
    write_campaign(tmp_path, n=1000)
    path = next(tmp_path.glob(files)) if files else tmp_path
    done = python(PROGRAM.format(program="rtrun", arguments=[command, str(path)]))
    imported = set(done.stderr.splitlines()[-1].split())
    assert done.returncode == 0 and "numpy" in imported
    never = {"paramiko", "scipy", "duckdb", "pyarrow", "rtrun.commands.bisect", "rtrun.targets.config"}
    assert not imported & (never | others)


def test_an_archive_is_read_without_pandas(tmp_path: Path) -> None:
    """pyarrow imports it for most of what turns a column into numbers, which takes as long as an answer."""
    write_campaign(tmp_path / "results", n=1000)
    assert rtrun.cli.main(["archive", "add", str(tmp_path / "results"), "--to", str(tmp_path / "archive")]) == 0
    done = python(PROGRAM.format(program="rtrun", arguments=["history", str(tmp_path / "archive")]))
    imported = set(done.stderr.splitlines()[-1].split())
    assert done.returncode == 0 and "pyarrow" in imported
    assert not imported & {"pandas", "scipy", "duckdb", "paramiko"}


def test_nothing_is_said_at_the_end(tmp_path: Path) -> None:
    """duckdb of a program around us prints what is left of it: nothing, unless somebody keeps Python from looking."""
    write_campaign(tmp_path / "results", n=100)
    words = ["show", str(tmp_path / "results")]
    done = python(f"import duckdb\nfrom rtrun.cli import main\nprint(main({words}), duckdb.sql('select 1').fetchall())")
    assert (done.stdout.splitlines()[-1], done.stderr) == ("0 [(1,)]", "")


@pytest.mark.parametrize(("program", "command"), [("rtrun", "why"), ("rtgen", "suites")])
def test_an_interruption_of_the_start_leaves_no_traceback(program: str, command: str) -> None:
    done = python(INTERRUPTED.format(program=program, command=command))
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for subparser in action.choices.values():
                yield from parsers(subparser)


EVERY = [
    parser
    for name, commands in PROGRAMS.items()
    for parser in parsers(parser_of(name, "", commands_of(name, commands)))
]


@pytest.mark.parametrize("parser", EVERY, ids=[parser.prog for parser in EVERY])
def test_an_option_is_written_whole(parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]) -> None:
    """A part of an option could mean another one in the next version."""
    option = next(word for word in reversed(parser._option_string_actions) if word.startswith("--"))
    for action in parser._actions:
        action.required = False
    with pytest.raises(SystemExit) as ended:
        parser.parse_args([option[:-1]])
    assert ended.value.code == 2
    assert f"error: unknown argument {option[:-1]}, did you mean '{option}" in capsys.readouterr().err


MODULES = {name: commands_of(name, commands) for name, commands in PROGRAMS.items()}
EVERY_COMMAND = [(name, module) for name, modules in MODULES.items() for module in modules]


@pytest.mark.parametrize(
    ("program", "command"), EVERY_COMMAND, ids=[f"{p} {called_as(c.__name__)}" for p, c in EVERY_COMMAND]
)
def test_help_has_two_examples_that_are_understood_and_the_exit_statuses(
    program: str, command: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = parser_of(program, "", MODULES[program])
    with pytest.raises(SystemExit):
        parser.parse_args([called_as(command.__name__), "--help"])
    shown = capsys.readouterr().out
    assert "exit status: 0 done; " in shown and (" 1 " in shown) >= hasattr(command, "FAILS")
    assert len(command.EXAMPLES) == 2
    for example in command.EXAMPLES:
        assert f"\n  {example}\n" in shown
        called, *words = shlex.split(example)
        assert (
            called == program and words[0] == called_as(command.__name__)
        ) or example == "rtgen explain scarthgap-jazzy"
        parser.parse_args(words)


def test_help_lists_every_command_once_below_its_group(capsys: pytest.CaptureFixture[str]) -> None:
    for cli in (rtgen.cli, rtrun.cli):
        assert cli.main(["--help"]) == 0
        shown = capsys.readouterr().out
        program = cli.__name__.partition(".")[0]
        assert all(f"\n{title}:\n" in shown for title in cli.GROUPS)
        assert [
            re.match(r"  ([a-z][a-z-]*)  +\S", line)[1] for line in re.findall(r"\n(  [a-z][a-z-]*  +\S.*)", shown)
        ] == [called_as(command.__name__) for command in MODULES[program]]


WITH_COMMANDS = [
    parser for parser in EVERY if any(isinstance(action, argparse._SubParsersAction) for action in parser._actions)
]


@pytest.mark.parametrize("parser", WITH_COMMANDS, ids=[parser.prog for parser in WITH_COMMANDS])
def test_without_a_command_it_prints_its_help(
    parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]
) -> None:
    program, *words = parser.prog.split()
    main = {"rtgen": rtgen.cli, "rtrun": rtrun.cli}[program].main
    assert main([*words, "--help"]) == 0
    asked = capsys.readouterr()
    assert (main(words), capsys.readouterr()) == (2, asked)


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_manual_page_has_every_command_and_no_mistake(program: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert {"rtgen": rtgen.cli, "rtrun": rtrun.cli}[program].main(["--print-manual"]) == 0
    page = capsys.readouterr().out
    groff = shutil.which("groff") or pytest.fail("groff is in tools/apt-packages-dev.txt")
    done = subprocess.run(
        [groff, "-k", "-man", "-Tutf8", "-ww"], input=page, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    plain = re.sub(r"\x1b\[[0-9;]*m|.\x08", "", done.stdout)
    for command in MODULES[program]:
        assert f"\n{program} {called_as(command.__name__)}\n" in plain and command.EXAMPLES[1] in plain


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["reprot", "x"], "argument COMMAND: unknown word 'reprot', did you mean 'report'? known: quick, observe,"),
        (
            ["report", "x", "--format", "htm"],
            "argument --format: unknown word 'htm', did you mean 'html'? known: html,",
        ),
        (["plan", "x", "y"], "error: unknown argument y\n"),
    ],
)
def test_a_word_that_is_none(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert rtrun.cli.main(words) == 2
    assert message in capsys.readouterr().err


# What is not there, for each command: a file, a folder, a machine, or a value that is none.
BAD = [
    "rtgen profiles x",
    "rtgen new-profile missing/mine.yml",
    "rtgen doctor missing",
    "rtgen explain missing.yml",
    "rtgen render --profile missing.yml",
    "rtgen kconfig verify --config missing --machine none",
    "rtgen kernel build --machine none",
    "rtgen suites build --machine none",
    "rtgen board build --machine none",
    "rtgen flash --image missing.wic --device /dev/null",
    "rtrun quick --deadline 0",
    "rtrun observe --target missing.yml --for 1s",
    "rtrun plan missing.yml",
    "rtrun run missing.yml --target missing.yml",
    "rtrun influence missing.yml --of other_nodes --target missing.yml",
    "rtrun new-target --host",
    "rtrun probe --target missing.yml",
    "rtrun check-rt --target missing.yml",
    "rtrun build-suites missing --target missing.yml",
    "rtrun report missing",
    "rtrun verdict missing",
    "rtrun gate missing",
    "rtrun why missing",
    "rtrun compare missing missing",
    "rtrun show missing",
    "rtrun verify missing",
    "rtrun claims missing",
    "rtrun import missing.log --platform hardware",
    "rtrun archive add missing --to archive",
    "rtrun history missing",
    "rtrun trends missing",
    "rtrun bisect missing --order missing.txt",
    "rtrun site missing --output site",
    "rtrun farm --target missing.yml",
    "rtrun notify missing.yml archive",
]


@pytest.mark.parametrize("command", BAD)
def test_bad_input_is_named_in_the_last_line(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    program, *words = command.split()
    assert {"rtgen": rtgen.cli, "rtrun": rtrun.cli}[program].main(words) == 2
    shown = capsys.readouterr()
    last = shown.err.splitlines()[-1]
    assert shown.out == "" and re.search(r"missing\b|\bnone\b|'0'|argument x$|--host", last)
    assert "Traceback" not in shown.err and shown.err.startswith((f"{program}: ", "usage: "))
    assert list(tmp_path.iterdir()) == []


def test_every_command_is_given_bad_input() -> None:
    given = {tuple(command.split()[:2]) for command in BAD}
    assert given == {(program, called_as(command.__name__)) for program, command in EVERY_COMMAND}
