"""A target behind the real sshd, for everything that needs no board."""

from dataclasses import replace

import pytest
from faulty import write_faulty_suites
from report.campaigns import write_campaign

from conftest import BOOT_ID, seeing, serve
from ports import free_port
from rtrun.targets.link import Link


@pytest.fixture
def loopback(sshd, tmp_path):
    return sshd.target(tmp_path / "target")


@pytest.fixture
def rebooting(loopback, tmp_path):
    """A target whose boot id changes when it is restarted: its sshd sees a file of ours instead of the kernel's."""
    boot = tmp_path / "boot_id"
    boot.write_text("00000000-0000-0000-0000-000000000001\n")

    def restart(_):
        number = int(boot.read_text().rpartition("-")[2]) + 1
        boot.write_text(f"00000000-0000-0000-0000-{number:012}\n")

    (tmp_path / "sshd").mkdir()
    with serve(tmp_path / "sshd", seeing({BOOT_ID: boot})) as server:
        yield replace(loopback, address=server.address, restart=restart)


@pytest.fixture
def without_locks(loopback, tmp_path):
    """A target whose kernel lacks FILE_LOCKING, as far as its shells can see."""
    (tmp_path / "sshd").mkdir()
    flock = tmp_path / "flock"
    flock.write_text("#!/bin/sh\necho 'flock: Function not implemented' >&2\nexit 1\n")
    flock.chmod(0o755)
    with serve(tmp_path / "sshd", seeing({"/usr/bin/flock": flock})) as server:
        yield replace(loopback, address=server.address)


@pytest.fixture
def suites_folder(tmp_path):
    return tmp_path / "suites"


@pytest.fixture
def wishes(suites_folder):
    """What the stand-in for a suite in `suites_folder` shall do."""
    return write_faulty_suites(suites_folder)


@pytest.fixture
def bare_target(loopback, suites_folder, wishes):
    """A target with the stand-in, on which no ROS master runs."""
    return replace(loopback, suites=suites_folder, master_port=free_port())


@pytest.fixture
def ready_target(bare_target, ros_master):
    """A target with the stand-in, on which a ROS master runs."""
    return replace(bare_target, master_port=ros_master)


@pytest.fixture
def target(loopback):
    return loopback


@pytest.fixture
def remarks():
    return []


@pytest.fixture
def link(target, remarks):
    with Link(target, remarks.append) as link:
        yield link


@pytest.fixture(scope="session")
def campaign(tmp_path_factory):
    """A campaign that several tests read; none of them writes into its folder."""
    return write_campaign(tmp_path_factory.mktemp("results") / "board", n=4000)


@pytest.fixture(scope="session")
def emulated(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("results") / "emulated", n=500, platform="emulated")
