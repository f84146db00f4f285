"""The suites on ROS 2: with the wheels of one release; by `make test-ros2` of two, and on a ROS 2 of this machine."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ports import free_domain, free_port, give_back_domain
from ros2 import wheels
from rtgen import suites as builder
from rtrun.cli import main

from .conftest import (
    Bench,
    Ended,
    check_outputs,
    check_that_skipped_periods_make_up_the_time,
    defaults_of,
    end,
    ended,
    is_measuring,
    wait_until,
)

pytestmark = pytest.mark.ros

# A ROS 2 of this machine, as /opt/ros/jazzy.
PREFIX = os.environ.get("RT_TESTS_ROS2", "")
OWN = [(PREFIX, name) for name in ("rcl", "rclcpp") if PREFIX and Path(PREFIX, f"lib/lib{name}.so").exists()]
TIMERS = {"oneshot_timer_tests": "l200_tm1000", "cyclic_timer_tests": "l200_fq1000"}


@pytest.fixture(
    params=[("kilted", "rcl"), pytest.param(("jazzy", "rcl"), marks=pytest.mark.ros2), *OWN],
    ids=lambda param: "-".join((Path(param[0]).name, param[1])),
    scope="module",
)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """The folder of a ROS 2, the suites built for it, and through which of its libraries they measure."""
    release, middleware = request.param
    prefix = Path(release) if release == PREFIX else wheels.installed(release)
    return prefix, builder.build("host", tmp_path_factory.mktemp("suites"), ros2=prefix), middleware


def set_up(prefix: Path) -> dict[str, str]:
    """The environment that a ROS 2 sets up."""
    command = ["sh", "-c", '. "$1" && env -0', "sh", str(prefix / "setup.sh")]
    lines = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.rstrip("\0").split("\0")
    return dict(line.split("=", 1) for line in lines)


@pytest.fixture
def bench(built: tuple[Path, Path, str], tmp_path: Path) -> Iterator[Bench]:
    """As that of roscpp, in a domain of its own."""
    prefix, suites, middleware = built
    (tmp_path / "out").mkdir()
    domain = free_domain()
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(tmp_path / "log")}
    own["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with ended(Bench(suites, tmp_path / "out", set_up(prefix) | own, [], middleware)) as bench:
        yield bench
    give_back_domain(domain)


def communicate(bench: Bench, *arguments: str, subscribers: int = 1) -> tuple[list[Ended], Ended]:
    """Subscribers, of several each with its prefix, and one publisher that waits for them; what all of them said."""
    own: list[list[str]] = [[]] if subscribers == 1 else [["-p", str(number)] for number in range(subscribers)]
    receivers = [bench.start("communication_tests_subscriber", *arguments, *prefix) for prefix in own]
    sender = bench.run("communication_tests_publisher", *arguments, "--subscribers", str(subscribers))
    return [end(receiver) for receiver in receivers], sender


def sent_by(bench: Bench, base: str) -> dict[str, Any]:
    sent: dict[str, Any] = json.loads((bench.folder / f"{base}-publisher.json").read_text())
    return sent


def quality(record: dict[str, Any]) -> tuple[str, str]:
    """The quality of service that the RMW says is in effect."""
    facts = record["in_effect"]["facts"]
    return facts["reliability"], facts["depth"]


def policies(record: dict[str, Any]) -> set[tuple[str, int]]:
    return {(thread["policy"], thread["priority"]) for thread in record["in_effect"]["threads"]}


@pytest.mark.root
@pytest.mark.parametrize("program", TIMERS)
def test_timers_with_every_thread_at_the_policy(bench: Bench, program: str) -> None:
    ended = bench.run(program, "-r", "200", "-s", "FIFO", "--priority", "80", "--cpu", "0")
    assert (ended.status, ended.err) == (0, "")
    base = f"{program}_{TIMERS[program]}-tnRTFIFO"
    record = check_outputs(bench.folder, base, bench.middleware)
    assert (record["complete"], record["counts"]["measured"], record["counts"]["not_fired"]) == (True, 200, 0)
    asked = {"repetitions": 200, "policy": "FIFO", "priority": 80, "cpu": "0"}
    assert record["requested"] == defaults_of(program, bench.middleware) | asked
    threads = record["in_effect"]["threads"]
    # Those of the RMW, and those that libraries started before the program began, as well.
    assert len(threads) > 5 and policies(record) == {("FIFO", 80)}
    assert {tuple(thread["cpus"]) for thread in threads} == {(0,)}
    rows = np.load(bench.folder / f"{base}.npy")
    if program == "cyclic_timer_tests":
        expected, real = rows[:, 1], rows[:, 2]
        assert (real >= expected).all() and (np.diff(expected) % 1_000_000 == 0).all(), "rcl's timers keep their grid"
    else:
        assert (rows[:, 3] >= 0).all(), "reported: no call before it was due"


def test_what_is_in_effect_is_told(bench: Bench, built: tuple[Path, Path, str]) -> None:
    assert bench.run("oneshot_timer_tests", "-r", "3").status == 0
    facts = check_outputs(bench.folder, "oneshot_timer_tests_l3_tm1000", bench.middleware)["in_effect"]["facts"]
    build = json.loads((built[1] / "build.json").read_text())["ros2"]
    assert facts["ros_distro"] == build["distro"]
    assert facts["rcl_version"] == build["rcl"]
    assert facts["domain_id"] == bench.environment["ROS_DOMAIN_ID"]
    assert facts["rmw"].startswith("rmw_") and re.fullmatch(r"\d+\.\d+\.\d+", facts["rmw_version"])
    assert facts.get("rclcpp_version") == (build["rclcpp"] if bench.middleware == "rclcpp" else None)


def test_a_timer_in_busy_mode(bench: Bench) -> None:
    assert bench.run("oneshot_timer_tests", "-r", "50", "-t", "500", "-b", "1").status == 0
    assert check_outputs(bench.folder, "oneshot_timer_tests_l50_tm500-bm", bench.middleware)["counts"]["measured"] == 50


@pytest.mark.root
def test_a_timer_that_is_asked_for_too_much_counts_what_it_skips(bench: Bench) -> None:
    assert bench.run("cyclic_timer_tests", "-r", "2000", "-f", "1000000", "-s", "FIFO").status == 0
    record = check_outputs(bench.folder, "cyclic_timer_tests_l2000_fq1000000-tnRTFIFO", bench.middleware)
    check_that_skipped_periods_make_up_the_time(record["rate"], 2000)


@pytest.mark.root
def test_messages_in_real_time(bench: Bench) -> None:
    (receiver,), sender = communicate(bench, "-r", "300", "-f", "500", "-s", "FIFO", "-l", "1000")
    assert (sender.status, sender.out, sender.err) == (0, "\tINFO: Done publishing...\n", "")
    assert (receiver.status, receiver.err) == (0, "")
    base = "ct_gnuplot_l300_fq500_pl1000-tnRTFIFO"
    assert bench.files() == sorted([f"{base}-publisher.json", f"{base}.json", f"{base}.log", f"{base}.npy"])
    record, sent = check_outputs(bench.folder, base, bench.middleware), sent_by(bench, base)
    # The publisher waited for its subscriber, and none of a thousand kept messages is lost.
    assert record["counts"] == {key: 300 if key in ("asked", "measured") else 0 for key in record["counts"]}
    rows = np.load(bench.folder / f"{base}.npy")
    assert rows[:, 2].tolist() == list(range(300))
    assert (sent["complete"], sent["counts"]) == (True, {"asked": 300, "sent": 300})
    achieved_hz = pytest.approx(299e9 / (rows[-1, 0] - rows[0, 0]), rel=1e-6)
    assert (sent["rate"]["asked_hz"], sent["rate"]["achieved_hz"]) == (500, achieved_hz)
    for written in (record, sent):
        assert policies(written) == {("FIFO", 95)} and written["in_effect"]["facts"]["rmw"] != ""
        assert quality(written) == ("reliable", "1000")


def test_several_subscribers_and_two_that_are_none(bench: Bench) -> None:
    """Nothing comes to one in another domain, nor to one that wants lost messages again, which are not sent again."""
    elsewhere = Bench(bench.suites, bench.folder, dict(bench.environment), bench.started, bench.middleware)
    elsewhere.environment["ROS_DOMAIN_ID"] = str(free_domain())
    deaf = {
        "elsewhere": elsewhere.start("communication_tests_subscriber", "--idle-timeout", "5", "-p", "elsewhere"),
        "wanting": bench.start("communication_tests_subscriber", "--idle-timeout", "5", "-p", "wanting"),
    }
    best_effort = ("--reliability", "best_effort", "--depth", "200")
    receivers, sender = communicate(bench, "-r", "200", *best_effort, subscribers=3)
    assert [program.status for program in (*receivers, sender)] == [0] * 4, sender.err
    for number in range(3):
        record = check_outputs(bench.folder, f"{number}ct_gnuplot_l200_fq1000_pl0", bench.middleware)
        assert (record["requested"]["reliability"], record["requested"]["depth"]) == ("best_effort", 200)
        assert quality(record) == ("best_effort", "200")
        assert record["counts"]["measured"] + record["counts"]["missing"] == 200
    for name, process in deaf.items():
        assert end(process).status == 0
        record = check_outputs(bench.folder, f"{name}ct_gnuplot_l1000_fq1000_pl0", bench.middleware)
        assert record["incomplete_reason"] == "nothing came for 5 s (0 publishers seen), no message came"


def test_what_a_short_history_loses_is_counted(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "3000", "-f", "1000", "--depth", "1")
    sender = bench.start(
        "communication_tests_publisher", "-r", "3000", "-f", "1000", "--depth", "1", "--subscribers", "1"
    )
    while receiver.poll() is None:  # it sleeps most of the time, while messages come and one is kept
        receiver.send_signal(signal.SIGSTOP)
        time.sleep(0.3)
        receiver.send_signal(signal.SIGCONT)
        time.sleep(0.1)
    assert (end(sender).status, end(receiver).status) == (0, 0)
    record = check_outputs(bench.folder, "ct_gnuplot_l3000_fq1000_pl0", bench.middleware)
    counts, rows = record["counts"], np.load(bench.folder / "ct_gnuplot_l3000_fq1000_pl0.npy")
    assert record["complete"] and counts["missing"] > 100
    assert counts["measured"] + counts["missing"] == 3000 and counts["duplicate"] == counts["out_of_order"] == 0
    assert sorted({*rows[:, 2].tolist(), *record["indices"]["missing"]})[:1000] == list(range(1000))


def test_publisher_killed(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "100000", "--idle-timeout", "3")
    sender = bench.start("communication_tests_publisher", "-r", "100000", "--subscribers", "1")
    wait_until(lambda: is_measuring(sender), sender)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(2)
    sender.kill()
    assert end(receiver).status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l100000_fq1000_pl0", bench.middleware)
    assert record["complete"] is False
    assert record["incomplete_reason"].startswith("nothing came for 3 s, last message seen: ")
    last = int(record["incomplete_reason"].rsplit(" ", 1)[1])
    assert 0 < record["counts"]["measured"] + record["counts"]["missing"] == last + 1 < 100000


def test_publisher_stopped_before_its_last_message(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "100000", "--idle-timeout", "20")
    sender = bench.start("communication_tests_publisher", "-r", "100000", "--subscribers", "1")
    wait_until(lambda: is_measuring(sender), sender)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(2)
    sender.send_signal(signal.SIGINT)
    stopped = end(sender)
    assert (stopped.status, stopped.out) == (1, "")
    assert re.fullmatch(r"\tERROR: ended by SIGINT after \d+ of 100000 messages\n", stopped.err)
    assert sent_by(bench, "ct_gnuplot_l100000_fq1000_pl0")["incomplete_reason"] == "ended by SIGINT"
    assert end(receiver).status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l100000_fq1000_pl0", bench.middleware)
    assert record["incomplete_reason"].startswith("the publisher left, last message seen: ")


def test_subscriber_killed(bench: Bench) -> None:
    receiver = bench.start("communication_tests_subscriber", "-r", "3000")
    sender = bench.start("communication_tests_publisher", "-r", "3000", "--subscribers", "1")
    wait_until(lambda: is_measuring(sender), sender)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(1)
    receiver.kill()
    assert end(sender) == Ended(0, "\tINFO: Done publishing...\n", "")
    assert sent_by(bench, "ct_gnuplot_l3000_fq1000_pl0")["counts"] == {"asked": 3000, "sent": 3000}


def test_a_publisher_that_waits_for_nobody_ends_on_a_signal(bench: Bench) -> None:
    sender = bench.start("communication_tests_publisher", "--subscribers", "1")
    wait_until(lambda: is_measuring(sender), sender)
    sender.terminate()
    assert end(sender) == Ended(1, "", "\tERROR: ended by SIGTERM after 0 of 1000 messages\n")


@pytest.mark.root
@pytest.mark.parametrize("payload", [1000, 1024 * 1024])
def test_fast_dds_by_itself_is_that_of_the_ros2(built: tuple[Path, Path, str], bench: Bench, payload: int) -> None:
    """Its programs find it where nothing is set up."""
    bench.middleware = "fastdds"
    bench.environment = {"ROS_DOMAIN_ID": bench.environment["ROS_DOMAIN_ID"]}
    (receiver,), sender = communicate(bench, "-r", "50", "-f", "50", "-s", "FIFO", "-l", str(payload))
    assert (sender.status, sender.err, receiver.status, receiver.err) == (0, "", 0, "")
    base = f"ct_gnuplot_l50_fq50_pl{payload}-tnRTFIFO"
    record = check_outputs(bench.folder, base, "fastdds")
    assert record["counts"]["measured"] + record["counts"]["missing"] == 50
    versions = {path.name.partition(".so.")[2] for path in built[0].glob("lib/libfast[dr]*s.so.*.*.*")}
    assert {record["in_effect"]["facts"]["fastdds_version"]} == versions
    assert policies(record) == policies(sent_by(bench, base)) == {("FIFO", 95)}
    assert any(thread["name"].startswith("dds.") for thread in record["in_effect"]["threads"])


SMALL = ("unshare", "--mount", "sh", "-c", 'mount -t tmpfs -o size=64k none /dev/shm && exec "$@"', "sh")


@pytest.mark.root
@pytest.mark.parametrize("through", ["rcl", "fastdds", "cyclonedds"])
@pytest.mark.parametrize("fault", ["shared memory full", "another publisher", "another subscriber"])
def test_counted_messages_add_up(bench: Bench, through: str, fault: str) -> None:
    """What came and what is missing are what was sent, or, of two publishers, what the last message said was sent."""
    bench.middleware = bench.middleware if through == "rcl" else through
    before = SMALL if fault == "shared memory full" else ()
    arguments = ("-r", "300", "-f", "200", "-l", "1000")
    receiver = bench.start("communication_tests_subscriber", *arguments, before=before)
    role = fault.removeprefix("another ")
    subscribers = "2" if role == "subscriber" else "1"
    if role in ("publisher", "subscriber"):
        own = ("--subscribers", "1") if role == "publisher" else ()
        bench.start(f"communication_tests_{role}", *arguments, "-p", "other", *own)
    sender = end(bench.start("communication_tests_publisher", *arguments, "--subscribers", subscribers, before=before))
    assert (sender.status, end(receiver).status) == (0, 0), sender.err
    base = "ct_gnuplot_l300_fq200_pl1000"
    record = check_outputs(bench.folder, base, bench.middleware)
    assert record["complete"] and record["counts"]["measured"] + record["counts"]["missing"] == 300
    assert (record["counts"]["duplicate"] > 0) == (role == "publisher")
    assert sent_by(bench, base)["counts"] == {"asked": 300, "sent": 300}


def test_a_router_that_ends(built: tuple[Path, Path, str], bench: Bench) -> None:
    """Fast DDS' discovery server, by which the two find each other: while they measure it is killed."""
    port = free_port()
    # Fast DDS 3 wants the number of its command "server" before.
    command = ["42"] if list(built[0].glob("lib/libfastdds.so.3*")) else []
    server = [built[0] / "bin/fast-discovery-server", *command, "-i", "0", "-l", "127.0.0.1", "-p", str(port)]
    router = subprocess.Popen(server, env=bench.environment, stdout=subprocess.PIPE, text=True)
    bench.started.append(router)
    bench.environment["ROS_DISCOVERY_SERVER"] = f"127.0.0.1:{port}"
    receiver = bench.start("communication_tests_subscriber", "-r", "3000", "-f", "500")
    sender = bench.start("communication_tests_publisher", "-r", "3000", "-f", "500", "--subscribers", "1")
    # One to which nothing comes wakes ten times a second.
    switches = re.compile(r"^voluntary_ctxt_switches:\s*(\d+)", re.MULTILINE)
    status = Path(f"/proc/{receiver.pid}/status")
    wait_until(lambda: int(switches.findall(status.read_text())[0]) > 500, receiver)
    assert router.poll() is None and sender.poll() is None
    router.kill()
    assert end(sender) == Ended(0, "\tINFO: Done publishing...\n", "")
    assert end(receiver).status == 0
    record = check_outputs(bench.folder, "ct_gnuplot_l3000_fq500_pl0", bench.middleware)
    assert record["complete"] and record["counts"]["measured"] + record["counts"]["missing"] == 3000
    assert sent_by(bench, "ct_gnuplot_l3000_fq500_pl0")["counts"] == {"asked": 3000, "sent": 3000}


@pytest.mark.parametrize("program", ["cyclic_timer_tests", "communication_tests_subscriber"])
def test_an_rmw_that_is_not_installed(bench: Bench, program: str) -> None:
    bench.environment["RMW_IMPLEMENTATION"] = "rmw_nobodys_cpp"
    refused = bench.run(program, "-r", "10")
    assert refused.status != 0 and refused.out == ""
    (line,) = filter(None, refused.err.splitlines())
    assert "rmw_nobodys_cpp" in line
    assert bench.files() == []


CAMPAIGN = """
schema: 1
name: two
order: interleaved
seed: 7
common: {{policy: FIFO, repetitions: 300, frequency_hz: 50, domain_id: {domain}}}
runs:
  - {{suite: communication_tests, middleware: [roscpp, {middleware}], subscribers: 2, depth: 300}}
  - {{suite: cyclic_timer_tests, middleware: [roscpp, {middleware}]}}
  - {{suite: oneshot_timer_tests, middleware: [roscpp, {middleware}]}}
  - {{suite: cyclic_timer_tests, middleware: {middleware}, rmw: rmw_nobodys_cpp}}
"""


@pytest.mark.root
def test_a_campaign_on_ros_1_and_2(
    built: tuple[Path, Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prefix, suites, middleware = built
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    domain = free_domain()
    Path("campaign.yml").write_text(CAMPAIGN.format(domain=domain, middleware=middleware))
    Path("target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\nros_master_port: {free_port()}\n"
        f"ros_setup: {prefix}/setup.sh\n"
    )
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 3
    records = {path.parent.name[:3]: json.loads(path.read_text()) for path in Path("results/two").glob("*/run.json")}
    assert {number for number, record in records.items() if record["status"] == "ok"} == set(records) - {"007"}
    assert "rmw_nobodys_cpp" in records["007"]["reason"]
    version = json.loads((suites / "build.json").read_text())["ros2"][middleware]
    for number in ("002", "004", "006"):
        assert records[number]["parameters"]["domain_id"] == domain
        assert records[number]["target"]["middleware_version"] == version
    assert "domain_id" not in records["001"]["parameters"]
    capsys.readouterr()
    assert main(["verdict", "results/two", "--deadline", "1s"]) in (0, 1)
    assert f"middleware={middleware}" in capsys.readouterr().out
    assert main(["report", "results/two", "--output", "report.html"]) == 0
    assert f"middleware={middleware}" in Path("report.html").read_text()
    capsys.readouterr()
    assert main(["compare", "results/two", "--by", "middleware"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"A: roscpp, B: {middleware}\n") and "only in" not in out, out
    assert all(suite in out for suite in ("communication", "cyclic_timer", "oneshot_timer"))


APART = """. {prefix}/setup.sh
for ROS_DOMAIN_ID in {domains}; do mkdir {folder}/$ROS_DOMAIN_ID 2>/dev/null && break; done
export ROS_DOMAIN_ID
"""


@pytest.mark.slow  # a minute, for which it waits
def test_discovery_that_never_completes(
    built: tuple[Path, Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Publisher and subscriber are in two domains: the run ends, and its reason says whom each of them saw."""
    prefix, suites, middleware = built
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    Path("campaign.yml").write_text(
        f"schema: 1\nname: apart\nruns: [{{suite: communication_tests, middleware: {middleware}, repetitions: 100}}]\n"
    )
    domains = " ".join(str(free_domain()) for _ in range(3))  # of the sampler as well
    apart = APART.format(prefix=prefix, domains=domains, folder=tmp_path)
    Path("setup.sh").write_text(apart)
    Path("target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\nros_setup: {tmp_path}/setup.sh\n"
    )
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 3
    (path,) = Path("results/apart").glob("*/run.json")
    reason = json.loads(path.read_text())["reason"]
    assert "0 of 1 subscribers were connected after 60 s; ct_gnuplot_l100_fq1000_pl0: ended by SIGTERM" in reason, (
        reason
    )
    assert reason.endswith(" (0 publishers seen), no message came")
