"""The check of words finds what people read, and nothing else."""

from pathlib import Path

import pytest

from words import found, patterns


@pytest.mark.parametrize(
    ("name", "text", "lines"),
    [
        ("page.md", "It is said.\n\n    it is said\n```\nit is said\n```\nNow `it is said`.\n", [1]),
        ("module.py", '"""It\nis said."""\n\nX = "it is said"\n"""It is said."""\nY = 1  # it is said\n', [2, 5, 6]),
        ("script.sh", "#!/bin/sh\n# it is said\necho 'it is said'\n", [2]),
        ("core.cpp", "/* It is said.\n * it was said */\nint is;  // it is said\n", [1, 2, 3]),
        ("file.yml", "key: it is said\n# it is said\n", [2]),
        ("recipe.yml.j2", "key: it is said  # it is said\n", [1]),
    ],
)
def test_a_word_in_a_file(tmp_path: Path, name, text, lines):
    (tmp_path / name).write_text(text)
    findings = [line for line in found([tmp_path / name]) if "is reported" in line]
    assert sorted(int(line.rpartition(f"{name}:")[2].partition(":")[0]) for line in findings) == lines


def test_each_pattern_has_something_better():
    assert len(patterns()) > 20 and all(better for _, better in patterns())
