"""Files of known programs that hold no histogram: named, with how to measure instead."""

from pathlib import Path

import pytest

from logs import LOGS_2014
from rtfiles.errors import UsageError
from rtrun.results.importers import unreadable
from rtrun.results.importers.detect import read

FILES = LOGS_2014.parent / "unreadable"
OF_RT_TESTS = "pmqtest, ptsematest, sigwaittest or svsematest"
PROGRAMS = {
    "cyclictest-": "cyclictest without -h",
    "pmqtest": OF_RT_TESTS,
    "ptsematest": OF_RT_TESTS,
    "sigwaittest": OF_RT_TESTS,
    "svsematest": OF_RT_TESTS,
    "signaltest": "signaltest",
    "timerlat-top": "rtla timerlat top",
    "osnoise-hist": "rtla osnoise hist",
    "osnoise-top": "rtla osnoise top",
    "oslat": "oslat",
    "hwlatdetect": "hwlatdetect",
    "performance_test": "performance_test",
}


def program_of(path: Path) -> str:
    return next(program for beginning, program in PROGRAMS.items() if path.name.startswith(beginning))


@pytest.mark.parametrize("path", sorted(FILES.iterdir()), ids=lambda path: path.name)
def test_the_program_is_named_and_how_to_measure(path):
    with pytest.raises(UsageError) as refused:
        read(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: it is from {program_of(path)}, which ")
    assert "easure with" in message


def test_each_kind_has_a_file():
    assert {program_of(path) for path in FILES.iterdir()} == {kind.program for kind in unreadable.KINDS}


def test_the_command_line_of_another_program_is_none_of_its_arguments(tmp_path):
    text = (FILES / "pmqtest.json").read_text()
    (tmp_path / "x.json").write_text(text.replace("pmqtest -t1", "/usr/bin/pmqtest --json=/tmp/cyclictest/oslat -t1"))
    with pytest.raises(UsageError, match="it is from pmqtest"):
        read(tmp_path / "x.json")


def test_unknown_text_is_no_program():
    assert unreadable.recognise("hello") is None
    assert unreadable.recognise('"cmdline:": "' + "/" * 100_000) is None
    assert unreadable.recognise("T: 0 (" + " " * 100_000) is None
