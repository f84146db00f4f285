"""Every option that is a time takes the same units, through one reader."""

import argparse

import pytest

from rtfiles.command import parser_of
from rtfiles.start import commands_of
from rtrun.cli import COMMANDS, GROUPS

NS = {"90s": 90 * 10**9, "5m": 300 * 10**9, "8h": 28_800 * 10**9, "2d": 172_800 * 10**9, "1w": 604_800 * 10**9}


def actions(parser, words=()):
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, subparser in action.choices.items():
                yield from actions(subparser, (*words, name))
        elif action.type is not None:
            yield (*words, action.option_strings[0] if action.option_strings else action.dest), action


def test_every_time_has_the_same_units():
    parser = parser_of("rtrun", "x", commands_of("rtrun", COMMANDS), GROUPS)
    times = {words: action.type for words, action in actions(parser) if action.metavar == "TIME"}
    days = {words: action.type for words, action in actions(parser) if action.metavar == "AGE"}
    moments = {("archive", "annotate", "--from"), ("archive", "annotate", "--to")}
    assert {("archive", "compact", "--grace"), ("observe", "--for"), ("quick", "--for")} <= times.keys()
    assert days.keys() == {("archive", "retain", "age")}
    for words, read in times.items():
        if words not in moments:
            assert {text: read(text) for text in NS} == NS, words
    for read in days.values():
        assert [read(text) for text in ("48h", "2d", "1w", "2880m", "forever")] == [2, 2, 7, 2, None]
        for text in ("90s", "forever ", "31y", "0d", "-1d"):
            with pytest.raises(argparse.ArgumentTypeError):
                read(text)
