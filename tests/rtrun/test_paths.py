"""docs/house.md, Two paths through the runner: whose functions a campaign and its report run is what the page names."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from report.campaigns import latencies, oneshot_run, write_campaign

import rtrun

TOP = Path(__file__).parents[2]
# Functions alone: a module that is only imported, for a type or a number, need not be read.
FOLLOWED = """
import sys, threading

opened = set()


def follow(frame, event, _):
    # Neither bodies of modules and classes nor what dataclasses write.
    code = frame.f_code
    is_function = code.co_flags & 0x01 and not code.co_qualname.startswith("<")
    if event == "call" and is_function and code.co_filename.endswith(".py"):
        opened.add(frame.f_globals.get("__name__", ""))


from rtrun.cli import main
threading.setprofile(follow)
sys.setprofile(follow)
status = main(sys.argv[2:])
sys.setprofile(None)
with open(sys.argv[1], "w") as file:
    print(*sorted(opened), sep="\\n", file=file)
sys.exit(status)
"""


def named(command):
    """The modules that the table of a command names."""
    section = (TOP / "docs/house.md").read_text().partition("## Two paths through the runner")[2].partition("\n## ")[0]
    table = section.partition(f"\n`rtrun {command}`")[2].partition("\n`rtrun ")[0]
    return re.findall(r"`([\w/]+)`", table)


def followed(folder, *argv):
    done = subprocess.run([sys.executable, "-c", FOLLOWED, "opened", *argv], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    names = (folder / "opened").read_text().split()
    return {name.removeprefix("rtrun.").replace(".", "/") for name in names if name.startswith("rtrun.")}


@pytest.mark.parametrize("command", ["run", "report"])
def test_every_module_that_is_named_is_there_once(command):
    names = named(command)
    assert len(names) == len(set(names)) > 50
    assert [name for name in names if not (Path(rtrun.__file__).parent / f"{name}.py").is_file()] == []


def test_every_home_of_a_noun_is_there():
    table = (TOP / "docs/house.md").read_text().partition("## The nouns")[2].partition("\n## ")[0]
    homes = re.findall(r"`([\w/.]+)`", table)
    assert 30 < len(homes) < 45, "one screen"
    assert [home for home in homes if not (TOP / home).exists() and not (TOP / "runner/rtrun" / home).exists()] == []


@pytest.mark.ros
def test_whoever_follows_a_campaign_and_its_report_reads_what_is_named(tmp_path, suites_folder, wishes, ros_master):
    (tmp_path / "campaign.yml").write_text(
        "schema: 1\nname: tiny\nruns: [{suite: cyclic_timer_tests, repetitions: 100, frequency_hz: 100}]\n"
    )
    (tmp_path / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites_folder}\nwork_dir: {tmp_path}/work\n"
        f"ros_master_port: {ros_master}\n"
    )
    opened = followed(tmp_path, "run", "campaign.yml", "--target", "target.yml", "--results", "results")
    assert opened == set(named("run"))
    for number in range(10):
        oneshot_run(tmp_path / "ten", f"{number:03}", latencies(3000, number), attempt=f"a{number}")
    write_campaign(tmp_path / "thesis", n=2000)
    opened = set().union(
        *(followed(tmp_path, "report", folder, "--deadline", "400us") for folder in ("results", "ten", "thesis"))
    )
    assert opened == set(named("report"))
