"""`make test-archive`: a history of 10 000 runs of 30 boards in object storage, with every request counted."""

import json
import logging
import os
import subprocess
import sys

import boto3
import pytest
from archive.archived import write_course
from moto.server import ThreadedMotoServer

from ports import free_port

REQUESTS_MAX = 300
BOARDS, DAYS = 30, 167  # with two runs a day


class Counted(logging.Handler):
    """Counts the requests that a server of werkzeug has answered."""

    def __init__(self):
        super().__init__(logging.INFO)
        self.count = 0

    def emit(self, record):
        self.count += '" 2' in record.getMessage()


@pytest.fixture
def requests():
    counted, log = Counted(), logging.getLogger("werkzeug")
    log.setLevel(logging.INFO)
    log.addHandler(counted)
    log.propagate = False
    yield counted
    log.removeHandler(counted)


@pytest.fixture
def bucket(monkeypatch, requests):
    """An empty bucket of a real server of the protocol, for this process and those that it starts."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=free_port())
    server.start()
    _, port = server.get_host_and_port()
    for name, value in (("ENDPOINT_URL", f"http://127.0.0.1:{port}"), ("DEFAULT_REGION", "us-east-1"),
                        ("ACCESS_KEY_ID", "id"), ("SECRET_ACCESS_KEY", "key")):  # fmt: skip
        monkeypatch.setenv(f"AWS_{name}", value)
    client = boto3.client("s3")
    client.create_bucket(Bucket="lab")
    yield client
    server.stop()


def rtrun(requests, *words):
    """What a command prints, and how many requests it made."""
    before = requests.count
    argv = [sys.executable, "-m", "rtrun.cli", *map(str, words)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, requests.count - before


def history(requests, archive):
    printed, count = rtrun(requests, "history", archive, "--by", "kernel", "--json")
    points = json.loads(printed)["points"]
    return sum(point["n"] for point in points), sum(len(point["run_keys"]) for point in points), count


def upload(client, folder):
    for path in folder.rglob("*"):
        if path.is_file():
            client.upload_file(str(path), "lab", f"archive/{path.relative_to(folder)}")


def test_few_files_and_many_answer_alike(bucket, requests, tmp_path):
    """Added, asked, put together and cleared there, run by run."""
    upload(bucket, write_course(tmp_path / "archive", [100.0] * 20))
    before = history(requests, "s3://lab/archive")
    assert before[:2] == (40 * 4000, 40)
    printed, _ = rtrun(requests, "archive", "compact", "s3://lab/archive")
    assert printed.startswith("80 files put into 2, 0 removed")
    assert history(requests, "s3://lab/archive")[:2] == before[:2]
    printed, _ = rtrun(requests, "archive", "compact", "s3://lab/archive", "--grace", "1ns")
    assert printed.startswith("0 files put into 0, 80 removed")
    after = history(requests, "s3://lab/archive")
    assert after[:2] == before[:2] and after[2] < 20 < 80 < before[2]


def test_a_history_of_10_000_runs_takes_few_requests(bucket, requests, tmp_path, monkeypatch):
    archive = tmp_path / "archive"
    with monkeypatch.context() as hurry:
        hurry.setattr(os, "fsync", lambda handle: None)  # 20 000 files on a disk
        for board in range(BOARDS):
            write_course(archive, [100.0] * DAYS, machine=f"board-{board:02}", seed=board + 1)
    rtrun(requests, "archive", "compact", archive)
    rtrun(requests, "archive", "compact", archive, "--grace", "1ns")
    upload(bucket, archive)
    n, runs, count = history(requests, "s3://lab/archive")
    assert (n, runs) == (2 * BOARDS * DAYS * 4000, 2 * BOARDS * DAYS)
    print(f"{count} requests for a history of {runs} runs")
    assert 10 < count <= REQUESTS_MAX
