"""The files of machines: what they may say, and that they alone know the machines."""

import re
from pathlib import Path

import pytest
import yaml

from rtfiles.errors import UsageError
from rtgen import cli
from rtgen.board import machine

TOP = Path(__file__).parents[2]
PROGRAMS = (TOP / "tools", TOP / "runner")
# Machines of BitBake are rendered from profiles; one of them has the name of a board.
OF_BITBAKE = (TOP / "tools/rtgen/layer", TOP / "tools/rtgen/profile.py")


def code() -> list[Path]:
    files = [path for top in PROGRAMS for kind in ("*.py", "*.sh", "*.cmake") for path in top.rglob(kind)]
    return [path for path in files if not any(path.is_relative_to(place) for place in OF_BITBAKE)]


def naming(files: list[Path], names: list[str]) -> list[str]:
    """The files that hold one of the names as a word, but for the examples of commands."""
    examples = re.compile(r"^EXAMPLES = \(.*?^\)", re.M | re.S)
    pattern = re.compile(rf"(?<![\w-])({'|'.join(map(re.escape, names))})(?![\w-])")
    return [
        f"{path}: {match[0]}"
        for path in files
        for match in [pattern.search(examples.sub("", path.read_text()))]
        if match
    ]


def test_no_code_names_a_machine(tmp_path: Path) -> None:
    names = list(machine.machines())
    assert len(code()) > 100
    assert naming(code(), names) == []
    file = tmp_path / "one.py"
    file.write_text(f'if machine == "{names[0]}":\n    pass\n')
    assert naming([file], names) == [f"{file}: {names[0]}"]


def test_one_machine_is_the_default() -> None:
    assert [name for name, described in machine.machines().items() if described.default] == ["qemu-armv7"]
    assert machine.default_machine() == "qemu-armv7"


@pytest.mark.parametrize(("defaults", "named"), [([], "none has"), (["one", "two"], "one, two have")])
def test_no_default_and_two_are_refused(tmp_path: Path, defaults: list[str], named: str) -> None:
    data = yaml.safe_load((machine.HERE / "machines/qemu-armv7.yml").read_text())
    for name in ("one", "two", "three"):
        (tmp_path / f"{name}.yml").write_text(yaml.safe_dump(data | {"default": name in defaults}))
    with pytest.raises(UsageError) as error:
        machine.machines(tmp_path)
    assert str(error.value) == f"{tmp_path}: default: true belongs into the file of one machine, {named} it"


def test_machines_are_listed_one_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["board", "machines"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(machine.machines())
    assert all(len(line) <= 120 for line in lines)
    assert [line.split()[0] for line in lines if line.endswith("(default)")] == ["qemu-armv7"]


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("architecture", "vax", "architecture: unknown architecture 'vax', known: "),
        ("architecture", None, "architecture: is missing"),
        ("kernel", "linux image", "kernel: 'linux image' is not a name of letters, digits and . _ + -"),
        ("kernel", "--option", "kernel: '--option' is not a name"),
        ("summary", "", "summary: '' is not one line of text"),
        ("cmdline", "console=ttyS0\nquiet", "cmdline: 'console=ttyS0\\nquiet' is not one line"),
        ("dtb", "../vmlinuz", "dtb: '../vmlinuz' is not a name"),
        ("modules", {}, "modules: takes 1 or more entries"),
        ("modules", ["ext4"], "modules: takes a mapping of keys to values"),
        ("qemu", {"binary": "qemu"}, None),
        ("colour", "red", "unknown key 'colour', allowed: summary, "),
    ],
)
def test_nonsense_is_named_with_file_and_key(tmp_path: Path, key: str, value: object, expected: str | None) -> None:
    data = yaml.safe_load((machine.HERE / "machines/qemu-armv7.yml").read_text())
    data[key] = value
    if value is None:
        del data[key]
    path = tmp_path / "board.yml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(UsageError) as error:
        machine.machines(tmp_path)
    lines = str(error.value).splitlines()
    messages = [re.sub(f"^{re.escape(str(path))}(:[0-9]+)?: ", "", line) for line in lines]
    if expected is None:
        assert messages == [f"qemu.{name}: is missing" for name in ("arguments", "disk_device", "network_device")]
    else:
        (message,) = messages
        assert message.startswith(expected)
