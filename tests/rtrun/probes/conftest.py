"""This machine as a target whose programs are observed."""

import dataclasses

import pytest
from probes.standin import build, skip_without_trace

from rtrun.targets.address import ThisMachine
from rtrun.targets.link import Link


@pytest.fixture(scope="session")
def standin(tmp_path_factory):
    """The path of the stand-in, beside its libraries."""
    return build(tmp_path_factory.mktemp("standin"))


@pytest.fixture
def here(loopback):
    """A link to this machine, of `kind: local`. Skips without probes."""
    skip_without_trace()
    with Link(dataclasses.replace(loopback, address=ThisMachine()), print) as link:
        yield link
