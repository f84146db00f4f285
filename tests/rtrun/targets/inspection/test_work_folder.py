"""The work folder on a target: every command refuses one that others can change, before anything is written there."""

import os
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest

from conftest import serve
from rtrun.cli import main
from rtrun.targets.address import ThisMachine
from rtrun.targets.deploy import ON_TARGET, deploy
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts, work_folder
from rtrun.targets.link import Link

TOP = Path(__file__).parents[4]
OTHER = 12345
as_root = pytest.mark.root("gives folders to another user, and becomes him")
CAMPAIGN = "schema: 1\nname: tiny\nruns: [{suite: cyclic_timer_tests, repetitions: 100, frequency_hz: 100}]\n"
COMMANDS = {
    "probe": ["probe", "--target", "target.yml"],
    "run": ["run", "campaign.yml", "--target", "target.yml", "--results", "results"],
    "observe": ["observe", "--target", "target.yml", "--for", "1s", "--results", "results"],
    "observe --list": ["observe", "--target", "target.yml", "--list"],
    "quick": ["quick", "--target", "target.yml", "--deadline", "1ms"],
    "build-suites": ["build-suites", str(TOP / "recipes-tests"), "--target", "target.yml"],
}
# Modules that put files on a target, which they may do once the folder was looked at.
DEPLOYING = {"commands/observe.py", "commands/probe.py", "execution/preparation.py", "targets/building.py"}


@as_root
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_a_folder_of_another_user(tmp_path, monkeypatch, capsys, command):
    work = tmp_path / "work"
    work.mkdir()
    os.chown(work, OTHER, OTHER)
    (tmp_path / "target.yml").write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {work}\n")
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    monkeypatch.chdir(tmp_path)
    assert main(COMMANDS[command]) == 3
    out, err = capsys.readouterr()
    assert f"{work}: others could replace what this user runs from there: {work} belongs to user {OTHER}: name" in (
        out + err
    )
    assert list(work.iterdir()) == []


def test_whoever_deploys_has_looked_before():
    """What is not among the commands above would be found here."""
    runner = TOP / "runner/rtrun"
    texts = {path.relative_to(runner).as_posix(): path.read_text() for path in runner.rglob("*.py")}
    deploying = {name for name, text in texts.items() if "deploy.deploy(" in text}
    assert deploying == DEPLOYING
    for name in deploying:
        assert 0 < texts[name].index("inspection.inspect(link)") < texts[name].index("deploy.deploy("), name


@as_root
def test_a_program_that_another_user_has_put_there_is_not_run(link, target):
    """He owned the folder when the scripts were copied, and has replaced one since."""
    facts.inspect(link)
    scripts = Path(deploy(link, ON_TARGET, "scripts"))
    for path in (scripts, *scripts.iterdir()):
        os.chown(path, OTHER, OTHER)
    with pytest.raises(TargetError, match=f"holds something that belongs to user {OTHER}: name a new folder"):
        facts.inspect(link)


@pytest.mark.sshd
@as_root
def test_a_restart_that_empties_tmp_lets_nobody_take_its_place(target, tmp_path):
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(0o1777)
    here = replace(target, work_dir=PurePosixPath(tmp_path / "tmp/x"))
    with Link(here, print) as link:
        facts.inspect(link)
        subprocess.run(["rm", "-r", str(here.work_dir)], check=True)
        Path(here.work_dir).mkdir()
        os.chown(here.work_dir, OTHER, OTHER)
        with pytest.raises(TargetError, match=f"root runs from there: {here.work_dir} belongs to user {OTHER}"):
            facts.inspect(link)


@pytest.fixture
def open_folder():
    """A folder of root's that other users may look into, which they may not in those of pytest."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@as_root
@pytest.mark.parametrize("is_there", [False, True])
def test_a_user_who_may_not_write_there(open_folder, is_there):
    """As robot, where root has made /var/lib/rt-tests, or nobody has."""
    work = open_folder / "work"
    script = work_folder.SCRIPT.read_text()
    if is_there:
        subprocess.run(["sh", "-s", str(work)], input=script, text=True, check=True)
    for shell in (["dash"], ["busybox", "sh"]):
        argv = ["setpriv", f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups", *shell, "-s", str(work)]
        done = subprocess.run(argv, input=script, capture_output=True, text=True, check=True, cwd="/")
        assert (done.stdout, done.stderr) == (f"readonly {work}\n", "")


@pytest.mark.parametrize(
    ("refusal", "message"),
    [
        ("readonly /var/lib/rt-tests\n", "robot may not make or fill /var/lib/rt-tests: name a folder that robot may "
         "write to in a target file, as 'work_dir: /home/robot/rt-tests', or log in as root"),
        ("unsafe /opt can be written by every user\n", "others could replace what robot runs from there: /opt can be "
         "written by every user: name a new folder"),
    ],
)  # fmt: skip
def test_the_remedy_is_one_for_who_logs_in(target, refusal, message):
    class Answering:
        def __init__(self):
            self.target = replace(target, address=replace(target.address, user="robot"))

        def check(self, argv, stdin):
            return refusal

    with pytest.raises(TargetError) as raised:
        work_folder.make(Answering())
    assert message in str(raised.value)


@pytest.mark.sshd
@pytest.mark.parametrize("kind", ["ssh", "local"])
def test_nothing_is_made_that_others_can_write_to(target, tmp_path, kind):
    """Whatever the umask of a login is there."""
    before = os.umask(0)
    try:
        (tmp_path / "sshd").mkdir(mode=0o700)
        with serve(tmp_path / "sshd") as server:
            there = replace(target, address=server.address if kind == "ssh" else ThisMachine())
            with Link(there, print) as link:
                facts.inspect(link)
                scripts = Path(deploy(link, ON_TARGET, "scripts"))
                link.check(["sh", "-c", f"umask; : >{scripts}/made"])
                facts.inspect(link)
    finally:
        os.umask(before)
    paths = list(Path(there.work_dir).rglob("*"))
    assert scripts / "made" in paths and all(path.stat().st_mode & 0o022 == 0 for path in paths)


def test_some_that_ask_at_the_same_time_do_not_disturb_each_other(tmp_path):
    """As three `rtrun observe` that are started together."""
    ask = 'for _ in $(seq 40); do sh "$0" "$1"; done'
    argv = ["sh", "-c", ask, work_folder.SCRIPT, str(tmp_path / "work")]
    asking = [subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) for _ in range(4)]
    assert [process.communicate(timeout=100)[0] for process in asking] == [""] * 4
    assert sorted(path.name for path in (tmp_path / "work").iterdir()) == [
        ".rt-tests", "master", "objects", "runs", "suites"
    ]  # fmt: skip
