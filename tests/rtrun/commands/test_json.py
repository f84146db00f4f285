"""What commands print for programs: one JSON object, with a schema, and nothing else on standard output."""

import argparse
import json

import pytest

import rtrun.cli
from rtfiles.command import called_as, parser_of
from rtfiles.start import commands_of
from rtrun.cli import main

LOG = "oneshot_timer_tests_l50_tm2000-measured.log"  # of 2014
# What each has besides `schema`, on the folders `runs`, `traced` and `archive` below.
COMMANDS = {
    "show runs": {"runs", "platform"},
    "verify runs": {"whole", "damaged", "repeated"},
    "verdict runs": {"groups", "left_out"},
    "gate runs": {"passed", "cases"},
    "claims runs": {"platform", "claims", "published"},
    "compare runs runs": set(),
    "why traced": {"outcome", "culprits", "outliers", "remedies", "periods", "problems"},
    "why runs": {"outcome", "outliers"},
    "history archive": {"points"},
    "trends archive": {"changes"},
    "bisect archive --by kernel --order kernels.txt": {"worse"},
    "plan": {"campaigns"},
    "plan demo": {"runs"},
    "run demo --collect-only": {"runs"},
    f"import {LOG} --platform hardware --results imported": {"runs", "refused"},
    "site archive --output public": {"files", "farm_not_known"},
    "notify lab.yml archive": {"wrong", "told", "known", "failures"},
}


@pytest.mark.parametrize("command", COMMANDS)
def test_it_is_one_object_with_a_schema(folder, capsys, monkeypatch, command):
    monkeypatch.chdir(folder)
    status = main([*command.split(), "--json"])
    printed = capsys.readouterr()
    data = json.loads(printed.out)
    assert status == (1 if command.startswith("gate") else 0), printed.err
    assert data["schema"] >= 1 and COMMANDS[command] <= data.keys()


def test_every_command_that_takes_json_is_here():
    """But for those that need a target: `tests/rtrun/targets` and `tests/suites` have them."""
    takes = {
        called_as(module.__name__)
        for module in commands_of("rtrun", rtrun.cli.COMMANDS)
        if "--json" in help_of(called_as(module.__name__))
    }
    assert takes == {command.split()[0] for command in COMMANDS} | {
        "probe", "check-rt", "observe", "influence", "farm", "quick"
    }  # fmt: skip


def help_of(name):
    parser = parser_of("rtrun", "", commands_of("rtrun", rtrun.cli.COMMANDS))
    (commands,) = (action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return commands[name].format_help()


def test_parts_of_an_outlier_add_up_and_a_damaged_run_is_told(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    main(["why", "traced", "--json"])
    (outlier,) = (outlier for outlier in json.loads(capsys.readouterr().out)["outliers"] if outlier["parts"])
    assert sum(part["length_ns"] for part in outlier["parts"]) == outlier["value_ns"]
    (path,) = (folder / "traced").rglob("*-trace-*.txt")
    path.write_bytes(path.read_bytes() + b"x")
    assert main(["verify", "traced", "--json"]) == 1
    (why,) = json.loads(capsys.readouterr().out)["damaged"].values()
    assert path.name in why and str(folder) not in why


def test_what_is_refused_or_fails_is_in_the_json_too(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert main(["import", LOG, "missing.log", "--platform", "hardware", "--results", "again", "--json"]) == 2
    printed = capsys.readouterr()
    data = json.loads(printed.out)
    ((run,), (refused,)) = data["runs"], data["refused"]
    assert (run["run"], run["file"], run["status"]) == (f"again/{LOG.removesuffix('.log')}", LOG, "ok")
    assert "the samples" in run["not_known"][0] and "missing.log" in refused and refused in printed.err
    assert main(["site", "archive", "--output", "pages", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert files[0] == "pages/index.html" and all((folder / name).is_file() for name in files)
