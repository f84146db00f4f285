"""Campaigns that several tests read; none of them writes into these folders."""

import pytest
from report.campaigns import write_campaign


@pytest.fixture(scope="session")
def campaign(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("results") / "board", n=4000)


@pytest.fixture(scope="session")
def emulated(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("results") / "emulated", n=500, platform="emulated")
