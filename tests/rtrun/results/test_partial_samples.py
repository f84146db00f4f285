"""What a suite that was cut off left of its samples."""

import numpy as np
import pytest
from written import write_npy

from rtrun.results.partial_samples import salvage


@pytest.fixture
def part(tmp_path):
    return tmp_path / "cyclic_timer_tests_l100_fq100.npy.part"


def rows_of(part):
    return np.load(part.with_suffix("")).tolist()


def test_whole_rows_are_kept_and_the_part_is_gone(part):
    write_npy(part, [(1, 2), (3, 4), (0, 5)], announced=100)
    with part.open("ab") as stream:
        stream.write(b"\x01" * 15)
    assert salvage(part) == 3
    assert rows_of(part) == [[1, 2], [3, 4], [0, 5]]
    assert not part.exists()


def test_space_that_was_never_filled_is_no_row(part):
    write_npy(part, [(1, 2), (0, 0), (3, 4), (0, 0), (0, 0)], announced=100)
    assert salvage(part) == 3
    assert rows_of(part) == [[1, 2], [0, 0], [3, 4]]


def test_no_more_than_was_announced(part):
    write_npy(part, [(1,), (2,), (3,)], announced=2)
    assert salvage(part) == 2
    assert rows_of(part) == [[1], [2]]


def test_a_part_of_nothing(part):
    write_npy(part, [(0, 0)], announced=100)
    assert salvage(part) == 0
    assert np.load(part.with_suffix("")).shape == (0, 2)


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY\x01\x00", b"\x93NUMPY\x01\x00\xff\xff{}\n", b"junk" * 100])
def test_what_is_no_part_stays_as_it_is(part, content):
    part.write_bytes(content)
    assert salvage(part) is None
    assert part.read_bytes() == content


def test_samples_that_are_there_are_not_overwritten(part):
    write_npy(part, [(1,)], announced=100)
    write_npy(part.with_suffix(""), [(7,), (8,)])
    assert salvage(part) is None
    assert rows_of(part) == [[7], [8]]
    assert part.exists()
