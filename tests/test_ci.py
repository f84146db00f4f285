"""docs/ci.md: the shell of each recipe does what it is to do, and leaves what the recipe publishes.

Stand-ins are `make`, `python3 -m venv`, `pip`, and `rtrun run`, which leaves a made-up campaign; every other command
is the real one.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from report.campaigns import write_campaign

TOP = Path(__file__).parents[1]
PAGE = (TOP / "docs" / "ci.md").read_text()
GITHUB, GITLAB, LAVA, PAGES = (
    yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.M | re.S)
)
RTRUN = f"""#!/bin/sh
if [ "$1" = run ]; then
    [ -f "$2" ] && [ -f "$4" ] && [ "$5" = --results ] && mkdir -p results && cp -r made "$6"
else
    exec {sys.executable} -m rtrun.cli "$@"
fi
"""
NOTE = '#!/bin/sh\necho "$(basename "$0") $*" >>calls\n'


@pytest.fixture
def checkout(tmp_path):
    for name in ("campaigns", "targets"):
        (tmp_path / name).symlink_to(TOP / name)
    scripts = {
        ".venv/bin/rtrun": RTRUN,
        ".venv/bin/pip": NOTE,
        "bin/make": NOTE,
        "bin/python3": NOTE,
        "bin/lava-test-case": NOTE,
    }
    for name, text in scripts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    write_campaign(tmp_path / "made", n=500)
    for folder in sorted((tmp_path / "made").iterdir())[2:]:
        shutil.rmtree(folder)
    return tmp_path


def run(checkout, shell, steps, variables):
    """Run steps of a recipe, each as its CI does; the archive is of the test. Return the last exit status."""
    words = {name: str(value) for name, value in variables.items()} | {"ARCHIVE": str(checkout / "archive")}
    environment = os.environ | words | {"PATH": f"{checkout / 'bin'}:{os.environ['PATH']}"}
    environment |= {
        "PYTHONPATH": f"{TOP / 'tools'}:{TOP / 'runner'}",
        "GITHUB_SHA": "c0ffee",
        "CI_COMMIT_SHA": "c0ffee",
    }
    for step in steps:
        done = subprocess.run(
            [*shell, step], cwd=checkout, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            return done.returncode, done.stdout + done.stderr
    return 0, ""


def check_published(checkout):
    assert "board suites MACHINE=qemu-x86_64" in (checkout / "calls").read_text()
    suites = ElementTree.parse(checkout / "gate.xml").getroot()
    assert int(suites.attrib["tests"]) > 0
    assert (checkout / "public" / "report.html").stat().st_size > 100_000
    assert "real-time history" in (checkout / "public" / "history" / "index.html").read_text().lower()
    assert list((checkout / "archive" / "runs").rglob("*.parquet"))


def test_github(checkout):
    """With a deadline that does not hold the gate fails, and the rest is published."""
    steps = [step for step in GITHUB["jobs"]["measure"]["steps"] if "run" in step]
    always = [step["run"] for step in steps if step.get("if") == "always()"]
    first = [step["run"] for step in steps if step.get("if") != "always()"]
    variables = GITHUB["env"] | {"DEADLINE": "1us", "PROBABILITY": "0.05"}
    shell = ("bash", "-e", "-o", "pipefail", "-c")
    status, output = run(checkout, shell, first, variables)
    assert status == 1 and "REFUTED" in output, output
    assert run(checkout, shell, always, variables) == (0, "")
    check_published(checkout)


def test_what_is_installed_is_the_checkout():
    """A copy of the package would be in its place, and rtgen needs the checkout."""
    assert re.findall(r"pip install .*'\.\[.*", PAGE) == ["pip install --quiet --editable '.[archive]'"] * 2


def test_gitlab_does_the_same():
    job = GITLAB["measure"]
    steps = [step["run"].splitlines() for step in GITHUB["jobs"]["measure"]["steps"] if "run" in step]
    commands = [line for step in steps for line in step]
    lines = [*job["script"], *job["after_script"]]
    assert [line.replace("CI_COMMIT_SHA", "GITHUB_SHA") for line in lines] == commands
    assert GITLAB["variables"] == GITHUB["env"]
    assert job["artifacts"]["reports"]["junit"] == "gate.xml" and job["artifacts"]["when"] == "always"


def test_lava(checkout):
    assert LAVA["metadata"]["format"] == "Lava-Test Test Definition 1.0"
    assert run(checkout, ("sh", "-c"), LAVA["run"]["steps"], LAVA["params"]) == (0, "")
    make, *calls = (checkout / "calls").read_text().splitlines()
    assert make == "make suites MACHINE=host"
    form = re.compile(r"lava-test-case [\w.-]+ --result (pass|fail)( --measurement -?[0-9.e+]+ --units us)?", re.ASCII)
    assert calls and all(form.fullmatch(call) for call in calls)
    names = [call.split()[1] for call in calls]
    assert len(names) == len(set(names))
    assert sum("-p99 " in call and " us" in call for call in calls) >= 2


def test_lava_is_told_that_the_campaign_failed(checkout):
    (checkout / "made").rename(checkout / "gone")
    run(checkout, ("sh", "-c"), LAVA["run"]["steps"][:2], LAVA["params"])
    assert "lava-test-case campaign --result fail" in (checkout / "calls").read_text()


def test_the_pages_become_a_site(checkout):
    (checkout / "docs").symlink_to(TOP / "docs")
    (checkout / ".venv/bin/sphinx-build").symlink_to(Path(sys.executable).with_name("sphinx-build"))
    steps = [step["run"] for step in PAGES["jobs"]["pages"]["steps"] if "run" in step]
    assert run(checkout, ("bash", "-e", "-o", "pipefail", "-c"), steps, {}) == (0, "")
    assert (checkout / "calls").read_text().splitlines()[1].endswith("--requirement tools/python-packages.txt")
    built = {str(path.relative_to(checkout / "public")) for path in (checkout / "public").rglob("*.html")}
    assert built >= {str(path.relative_to(TOP / "docs").with_suffix(".html")) for path in (TOP / "docs").rglob("*.md")}
    pages = "".join((checkout / "public" / name).read_text() for name in built)
    assert not re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="https?:', pages)
