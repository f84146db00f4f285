"""A target with processes of its own."""

import tempfile
from contextlib import ExitStack
from pathlib import Path, PurePosixPath

import pytest

from conftest import apart, serve, without_groups
from rtrun.targets.link import Link


@pytest.fixture
def remarks():
    return []


@pytest.fixture(params=[apart, without_groups], ids=["group", "secret"])
def place(request, tmp_path, remarks):
    """A target with processes of its own; what is run on it, and the folder of a program."""
    for name in ("sshd", "run"):
        (tmp_path / name).mkdir()
    with ExitStack() as stack:
        server = stack.enter_context(serve(tmp_path / "sshd", request.param()))
        stack.callback(server.process.kill)
        link = stack.enter_context(Link(server.target(tmp_path / "target"), remarks.append))
        yield link, PurePosixPath(tmp_path / "run"), request.param is apart


@pytest.fixture
def open_folder():
    """A folder that others may read. Those of pytest are closed again whenever another session of it begins."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)
