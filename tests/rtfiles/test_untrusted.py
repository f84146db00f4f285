"""What comes from a file or a target: whatever it is, it is read within its limits or it is an error of one line."""

import os
import sys

import pytest

from measured import measured
from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtfiles.untrusted import (
    JSON_DEPTH_MAX,
    LINE_CHARACTERS_MAX,
    lines_of,
    parse_json,
    read_bytes,
    read_end,
    real_number,
    whole_number,
)


class Record(Config):
    name: str
    count: int


def test_json_within_the_limits(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"name": "\\u00e4", "count": 9223372036854775807}')
    assert read_json(path, Record) == Record(name="ä", count=2**63 - 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000 + "]" * 100_000, "deep"),
        ("[" * (JSON_DEPTH_MAX + 1) + "]" * (JSON_DEPTH_MAX + 1), "nested more than 32 deep"),
        ("[" + "9" * 6000 + "]", "at most 20 digits"),
        ("[" + "9" * 20 + "]", "from -9223372036854775808 to"),
        ("[1e9999]", "finite number"),
        ("[NaN]", "expected a number, got 'NaN'"),
        ("[-Infinity]", "expected a number"),
        ('["\\ud800"]', "half of a character"),
        ('{"\\udc80": 1}', "half of a character"),
        ("[" + "[]," * 600_000 + "[]]", "more than 500000 values"),
        ("[" + " " * (17 << 20) + "]", "larger than 16777216 bytes"),
        ("", "Expecting value"),
        ("[1", "Expecting"),
    ],
)
def test_json_beyond_the_limits(text, message):
    with pytest.raises(UsageError, match=f"^x.json: .*{message}") as caught:
        parse_json(text, "x.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("word", ["²", "٣", "9" * 6000, "", " 1", "1 ", "1\n", "+1", "1_0", "0x1", "1.0", "-1"])
def test_no_whole_number(word):
    with pytest.raises(ValueError, match="whole number"):
        whole_number(word, lowest=0)


@pytest.mark.parametrize("word", ["inf", "nan", "1e999", "", " 1", "1_0", "٣", "9" * 6000, "1e99999999"])
def test_no_real_number(word):
    with pytest.raises(ValueError, match="number"):
        real_number(word)


def test_numbers():
    assert (whole_number("007"), whole_number("-9223372036854775808")) == (7, -(2**63))
    assert (real_number("0.50"), real_number("1E-3"), real_number("12")) == (0.5, 0.001, 12.0)


def test_only_regular_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, "/dev/zero"):
        with pytest.raises(UsageError, match=r"not a regular file|s a directory"):
            read_bytes(type(tmp_path)(path), max_bytes=10)
    with pytest.raises(UsageError, match="No such file"):
        read_bytes(tmp_path / "nothing", max_bytes=10)
    with pytest.raises(UsageError, match="null"):
        read_bytes(tmp_path / "a\0b", max_bytes=10)
    (tmp_path / "large").write_bytes(b"x" * 11)
    with pytest.raises(UsageError, match="larger than 10 bytes"):
        read_bytes(tmp_path / "large", max_bytes=10)


def test_the_memory_that_json_takes_is_limited():
    """The most wasteful text that is still taken."""
    code = """
from rtfiles.untrusted import parse_json
assert len(parse_json('[' + ','.join(['{"":[]}'] * 160_000) + ']', "x")) == 160_000
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    # 65 on x86-64 with Python 3.11, 2026-11-26; five times the items would take 281.
    assert measured([sys.executable, "-c", code], env=environment).peak_mib < 100


def test_the_end_of_a_file_of_any_size(tmp_path):
    path = tmp_path / "console.log"
    for content, end in ((b"", b""), (b"abc", b"abc"), (b"abcdef", b"cdef")):
        path.write_bytes(content)
        assert read_end(path, max_bytes=4) == end


def test_lines_come_without_their_ends_and_not_too_long():
    assert list(lines_of("a\r\n\nb c", "x")) == ["a", "", "b c"]
    assert list(lines_of("a\n", "x")) == ["a"]
    with pytest.raises(UsageError, match="x:2: a line of more than 262144 characters"):
        list(lines_of("a\n" + "b" * (LINE_CHARACTERS_MAX + 1), "x"))
