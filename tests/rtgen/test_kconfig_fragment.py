"""Config files of the kernel from anywhere: read within their limits, or refused with one line."""

import gzip
import os

import pytest

from rtfiles.errors import UsageError
from rtgen.kconfig.data import KernelOption
from rtgen.kconfig.fragment import CONFIG_BYTES_MAX, kernel_of, read_text
from rtgen.kconfig.verify import load_fragment


def test_what_grows_when_it_is_unpacked_is_refused(tmp_path):
    path = tmp_path / "config.gz"
    path.write_bytes(gzip.compress(b"\n" * CONFIG_BYTES_MAX))
    assert len(read_text(path)) == CONFIG_BYTES_MAX
    path.write_bytes(gzip.compress(b"\n" * (CONFIG_BYTES_MAX + 1)))
    with pytest.raises(UsageError, match="larger than 4194304 bytes when unpacked"):
        read_text(path)


@pytest.mark.parametrize("read", [read_text, load_fragment])
def test_what_is_large_or_no_file_is_refused_at_once(tmp_path, read):
    path = tmp_path / "config"
    path.write_bytes(b"\n" * (CONFIG_BYTES_MAX + 1))
    with pytest.raises(UsageError, match="larger than 4194304 bytes"):
        read(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(UsageError, match="not a regular file"):
        read(path)


def test_versions_have_digits_that_a_kernel_has():
    head = "# Linux/arm {} Kernel Configuration"
    assert kernel_of(head.format("6.1.0-rt")) == "6.1"
    for version in ("9" * 6000 + ".1", "\u0666.\u0661"):
        assert kernel_of(head.format(version)) is None
        with pytest.raises(ValueError, match="since"):
            KernelOption(symbol="A", value="y", reason="x", source="y", since=version)
