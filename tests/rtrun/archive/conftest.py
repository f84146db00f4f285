"""Archives for tests are written without waiting for the disk: none of them has to outlive a power cut."""

from unittest import mock

import pytest


@pytest.fixture(autouse=True)
def disk_that_is_not_waited_for():
    with mock.patch("os.fsync"):
        yield
