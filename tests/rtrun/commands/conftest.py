"""A folder with what commands print something of: runs, traced ones, a log of 2014, an archive."""

import shutil

import pytest
from report.campaigns import write_campaign
from traced import specimen, write_traced_run

from logs import LOGS_2014
from rtrun.cli import main

LOG = "oneshot_timer_tests_l50_tm2000-measured.log"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("json")
    write_campaign(folder / "runs", n=500)
    write_traced_run(folder / "traced", {1558: specimen(1558)}, [23166, 23175])
    shutil.copy(LOGS_2014 / LOG, folder)
    (folder / "lab.yml").write_text("schema: 1\nreceivers: [{name: log, kind: command, command: ['true']}]\n")
    (folder / "kernels.txt").write_text("6.1.0-rt\n6.6.30\n")
    assert main(["archive", "add", str(folder / "runs"), "--to", str(folder / "archive")]) == 0
    return folder
