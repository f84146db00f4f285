"""Commands, options and files completed by the real shells, from what the programs print."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

# A word typed at the end of a line, and what completes it.
BASH = """
source {script}
COMP_WORDS=({words}) COMP_CWORD={last}
_shtab_{program} {program} "${{COMP_WORDS[-1]}}" "${{COMP_WORDS[-2]}}"
echo "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module", params=["rtrun", "rtgen"])
def program(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def script(program: str, shell: str, folder: Path) -> Path:
    argv = [sys.executable, "-m", f"{program}.cli", "--print-completion", shell]
    file = folder / f"{program}.{shell}"
    file.write_text(subprocess.run(argv, check=True, capture_output=True, text=True).stdout)
    return file


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("rtrun ver", "verdict verify"),
        ("rtrun run cam", "campaign.yml"),
        ("rtrun run campaign.yml --tar", "--target --targets"),
        ("rtrun probe --target boards/", "boards/a.yml"),
        ("rtrun report --format ju", "junit"),
        ("rtgen board b", "build"),
    ],
)
def test_bash_completes(tmp_path: Path, line: str, expected: str) -> None:
    (tmp_path / "boards").mkdir()
    for name in ("campaign.yml", "boards/a.yml"):
        (tmp_path / name).touch()
    program = line.split()[0]
    text = BASH.format(script=script(program, "bash", tmp_path), words=line, last=line.count(" "), program=program)
    done = subprocess.run(
        ["bash", "--norc", "-c", text], cwd=tmp_path, check=True, capture_output=True, text=True, env=os.environ
    )
    assert done.stdout.split() == expected.split()


def test_zsh_takes_it(tmp_path: Path, program: str) -> None:
    file = script(program, "zsh", tmp_path)
    subprocess.run(["zsh", "-n", file], check=True)
    text = f'autoload -Uz compinit; compinit -u -D; eval "$(cat {file})"; print $_comps[{program}]'
    done = subprocess.run(["zsh", "-f", "-c", text], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == (f"_shtab_{program}\n", "")
