"""docs/ci.md and docs/lab.md: the shell of each recipe does what it is to do, and leaves what the recipe publishes.

Stand-ins are `make`, `python3 -m venv`, `pip`, and `rtrun run`, which leaves a made-up campaign; every other command
is the real one.
"""

import http.server
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import urllib.parse
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from report.campaigns import write_campaign

import rtrun.cli
from rtfiles.command import parser_of
from rtfiles.start import commands_of

TOP = Path(__file__).parents[1]
PAGE = (TOP / "docs" / "ci.md").read_text()
GITHUB, GITLAB, LAVA, PAGES = (
    yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.M | re.S)
)
LAB = (TOP / "docs" / "lab.md").read_text()
LAB_GITHUB, LAB_GITLAB = (yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```$", LAB, re.M | re.S))
BLOCKS = re.findall(r"^```ini\n(.*?)^```$", LAB, re.M | re.S)
(NIGHTLY,) = re.findall(r"^```sh\n(.*?)^```$", LAB, re.M | re.S)
UNITS = ("rt-nightly.service", "rt-nightly.timer", "rt-check.service", "rt-check.timer")
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


@pytest.fixture
def lab(checkout):
    """The folder of docs/lab.md, whose `rtrun run` leaves the campaign in the folder that it is given last."""
    rtrun = checkout / ".venv/bin/rtrun"
    measure = 'for last; do :; done; mkdir -p results && cp -r made "$last"; exit "${MEASURED:-0}"'
    rtrun.write_text(f'#!/bin/sh\n[ $1 = run ] && {{ {measure}; }}\nexec {sys.executable} -m rtrun.cli "$@"\n')
    (checkout / "bin/rtrun").symlink_to(rtrun)
    (checkout / "bin/gh").write_text('#!/bin/sh\necho "$*" >gh; cat >>gh\n')
    (checkout / "bin/gh").chmod(0o755)
    receiver = {"name": "log", "kind": "command", "command": ["tee", "told"]}
    (checkout / "receivers.yml").write_text(yaml.safe_dump({"schema": 1, "receivers": [receiver]}))
    return checkout


def in_folder(lab, text):
    return text.replace("/srv/rt-lab", str(lab))


def test_a_night_is_measured_kept_shown_and_told(lab):
    (lab / "nightly").write_text(in_folder(lab, NIGHTLY))
    # What was measured before it failed is kept, and the service has failed.
    status, printed = run(lab, ("sh",), [str(lab / "nightly")], {"MEASURED": 3})
    assert status == 3 and printed.endswith("0 things wrong\n"), printed
    assert list((lab / "archive" / "runs").glob("*.parquet")) and (lab / "public" / "boards.html").is_file()


def test_systemd_takes_the_units(lab, tmp_path_factory):
    folder = tmp_path_factory.mktemp("units")
    (lab / "nightly").touch(0o755)
    for name, block in zip(UNITS, BLOCKS, strict=True):
        assert f"`{name}`" in LAB or f"/{name}`" in LAB
        (folder / name).write_text(in_folder(lab, block))
        for when in re.findall("^OnCalendar=(.*)$", block, re.M):
            assert "Next elapse" in subprocess.check_output(["systemd-analyze", "calendar", when], text=True)
    done = subprocess.run(
        ["systemd-analyze", "verify", *map(str, folder.iterdir())], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


NIGHTS = """#!/bin/sh
echo "$(id -un) $PWD $*" >>calls
# The first night fails.
[ "$1" != run ] || [ "$(grep -c ' run ' calls)" -gt 1 ]
"""


@pytest.mark.slow
def test_systemd_starts_what_it_missed_and_what_failed(tmp_path):
    """systemd itself, in a container of this machine's own files: at its boot the machine was off for two nights."""
    upper, root = tmp_path / "upper", tmp_path / "root"
    units, folder = upper / "etc/systemd/system", upper / "srv/rt-lab"
    files = {units / name: block for name, block in zip(UNITS, BLOCKS, strict=True)} | {
        # What the test cannot wait for.
        units / "rt-nightly.timer.d/now.conf": "[Timer]\nRandomizedDelaySec=0\n",
        units / "rt-nightly.service.d/now.conf": "[Service]\nRestartSec=1s\n",
        units / "rt-lab.target": "[Unit]\nRequires=basic.target\nWants=rt-nightly.timer rt-check.timer\n",
        upper / "etc/sysusers.d/rtlab.conf": "u rtlab - - /srv/rt-lab\n",
        upper / "etc/tmpfiles.d/rtlab.conf": "Z /srv/rt-lab - rtlab rtlab\n",
        folder / "nightly": NIGHTLY,
        folder / ".venv/bin/rtrun": NIGHTS,
        upper / "var/lib/systemd/timers/stamp-rt-nightly.timer": "",
        upper / "var/lib/systemd/timers/stamp-rt-check.timer": "",
    }
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o755 if path.is_relative_to(folder) else 0o644)
        if path.name.startswith("stamp-"):
            os.utime(path, times=(time.time() - 2 * 86400,) * 2)
    for name in ("root", "work"):
        (tmp_path / name).mkdir()
    boot = (
        f"mount -t overlay overlay -o lowerdir=/,upperdir={upper},workdir={tmp_path}/work {root} && "
        f"exec systemd-nspawn --register=no --keep-unit --private-network -D {root} --boot --machine rt-lab "
        "systemd.unit=rt-lab.target systemd.mask=timers.target"
    )
    with (tmp_path / "console").open("w") as console:
        container = subprocess.Popen(
            ["unshare", "--mount", "sh", "-c", boot], stdin=subprocess.DEVNULL, stdout=console, stderr=console
        )
        try:
            calls = seen(folder / "calls", 12, container)
        finally:
            container.terminate()
            container.wait(60)
    night = ["run", "archive", "archive", "site", "notify"]
    assert sorted(command for _, _, command in calls) == sorted([*night, *night, "farm", "notify"])
    assert {(user, where) for user, where, _ in calls} == {("rtlab", "/srv/rt-lab")}


def seen(calls, number, container):
    """User, folder and command of so many calls, once they are there."""
    lines = []
    while len(lines) < number and container.poll() is None:
        time.sleep(0.2)
        lines = calls.read_text().splitlines() if calls.exists() else []
    return [line.split()[:3] for line in lines]


@pytest.fixture
def ci(lab):
    """The same with an rtrun that writes down what it is called with, and whose gate fails."""
    (lab / ".venv/bin/rtrun").write_text(
        '#!/bin/sh\necho "$*" >>rtrun\n[ $1 = gate ] || exit 0\necho "WORSE  p50"\nexit 1\n'
    )
    yield lab
    parser = parser_of("rtrun", "", commands_of("rtrun", rtrun.cli.COMMANDS))
    calls = [parser.parse_args(line.split()) for line in (lab / "rtrun").read_text().splitlines()]
    assert [call.command for call in calls] == ["run", "gate", "archive", "notify"]


def test_github_comments_what_is_worse(ci):
    measure, gate, comment, keep = (step for step in LAB_GITHUB["jobs"]["measure"]["steps"] if "run" in step)
    assert "failure()" in comment["if"] and "head.repo" in LAB_GITHUB["jobs"]["measure"]["if"]
    shell = ("bash", "-e", "-o", "pipefail", "-c")
    variables = {"TARGET": "lab.yml", "PULL_REQUEST": 7}
    assert run(ci, shell, [measure["run"], gate["run"]], variables)[0] == 1
    assert run(ci, shell, [comment["run"], keep["run"]], variables) == (0, "")
    assert (ci / "gh").read_text() == "pr comment 7 --body-file -\n    WORSE  p50\n"


def test_gitlab_comments_what_is_worse(ci):
    """By the real curl, to a server of our own."""
    posted = []

    class Api(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            posted.append((self.path, self.headers["PRIVATE-TOKEN"], urllib.parse.parse_qs(body)["body"][0]))
            self.send_response(201)
            self.end_headers()

        def log_message(self, *_):
            pass

    job = LAB_GITLAB["measure"]
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Api) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        variables = {
            "TARGET": "lab.yml", "CI_JOB_STATUS": "failed", "CI_MERGE_REQUEST_IID": 7, "CI_PROJECT_ID": 3,
            "CI_API_V4_URL": f"http://127.0.0.1:{server.server_port}/api/v4", "LAB_TOKEN": "t",
            "CI_PIPELINE_SOURCE": "schedule",
        }  # fmt: skip
        assert run(ci, ("bash", "-e", "-c"), job["script"], variables)[0] == 1
        assert run(ci, ("bash", "-e", "-c"), job["after_script"], variables) == (0, "")
        server.shutdown()
    assert posted == [("/api/v4/projects/3/merge_requests/7/notes", "t", "    WORSE  p50\n")]
