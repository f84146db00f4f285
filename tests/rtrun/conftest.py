"""A target behind the real sshd, for everything that needs no board."""

from pathlib import PurePosixPath

import pytest

from rtrun.link import Link
from rtrun.target import Target


@pytest.fixture
def loopback(sshd, tmp_path):
    return Target(
        name="loopback",
        emulated=False,
        address=sshd.address,
        suites=None,
        work_dir=PurePosixPath(tmp_path / "target"),
        ros_setup=None,
        ros_master_port=11311,
        reconnect_s=20,
        boot_s=0,
        console=None,
        failure=lambda: None,
    )


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
