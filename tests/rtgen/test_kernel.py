"""The kernel build, short of building: the pinned source, its patches, and what is refused."""

import hashlib
import re

import pytest

from rtfiles.errors import InfrastructureError, UsageError
from rtgen import kernel
from rtgen.cli import main
from rtgen.debian import PackageSource
from rtgen.kconfig import data as kconfig
from rtgen.kconfig import debian_source
from rtgen.kconfig.verify import Mismatch, Verification, verify_config


@pytest.fixture(scope="module")
def data():
    return kconfig.load()


def test_only_sections_for_kconfig_are_taken_from_a_patch():
    patch = (
        b"From: someone\nSubject: x\n\ndiff --git a/kernel/sched/core.c b/kernel/sched/core.c\n--- a\n+++ b\n@@\n-a\n"
        b"diff --git a/arch/arm/Kconfig b/arch/arm/Kconfig\n--- c\n+++ d\n@@\n+diff --git is quoted here\n"
        b"diff --git a/localversion-rt b/localversion-rt\nnew file mode 100644\n--- /dev/null\n+++ e\n@@\n+-rt64\n"
    )
    kept = debian_source.sections(patch)
    assert kept.startswith(b"diff --git a/arch/arm/Kconfig") and b"core.c" not in kept
    assert b"+diff --git is quoted here\n" in kept and kept.endswith(b"+-rt64\n")


def test_the_tree_has_the_rt_patches_of_the_pinned_version(data):
    tree = debian_source.open_debian(data)
    assert (tree.release, tree.kernel) == (data.source().release, "6.1")
    assert "ARCH_SUPPORTS_RT" in (tree.source / "arch/arm/Kconfig").read_text()


def test_a_version_that_debian_does_not_serve(data, monkeypatch, tmp_path):
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path))
    gone = data.source().model_copy(update={"version": "6.1.1-1"})
    with pytest.raises(InfrastructureError) as raised:
        debian_source.downloads(gone)
    reason = re.escape("Version '6.1.1-1' for 'linux-source-6.1' was not found")
    instead = r"\(served: 6\.1\.[^;]+; pin one in kconfig/sources\.yml\)"
    assert re.fullmatch(rf"linux-source-6\.1=6\.1\.1-1 cannot be downloaded: {reason} {instead}", str(raised.value))
    assert [path for path in (tmp_path / "kernel-source").iterdir() if not path.name.endswith(".lock")] == []


def test_a_mirror_without_the_suites_is_one_clear_line(data, monkeypatch, tmp_path, capsys):
    """The real apt finds an empty mirror."""
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "cache"))
    mirror = tmp_path / "mirror"
    mirror.mkdir()
    monkeypatch.setattr(debian_source, "source", lambda: PackageSource(release="bookworm", mirror=f"file://{mirror}"))
    assert main(["kernel", "build", "--machine", "qemu-armv7", "--kernel", "7.2"]) == 3
    pinned = data.source("7.2")
    reason = f"The repository 'file:{mirror} {pinned.suites[0]} Release' does not have a Release file."
    expected = f"rtgen: {pinned.tree.package}={pinned.version} cannot be downloaded: {reason}\n"
    assert capsys.readouterr().err == expected


def test_a_file_with_another_checksum_is_refused(data, monkeypatch, tmp_path):
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path))

    def other_bytes(_command, folder=None, **_):
        if folder:
            (folder / data.source().tree.file).write_bytes(b"other")

    monkeypatch.setattr(debian_source, "run", other_bytes)
    digest = hashlib.sha256(b"other").hexdigest()
    with pytest.raises(
        InfrastructureError, match=f"{data.source().tree.file}: sha256 is {digest}, kconfig/sources.yml pins"
    ):
        debian_source.downloads(data.source())


def test_options_that_do_not_hold_are_not_built(data):
    wrong = Mismatch(symbol="PREEMPT_RT", want="y", got="n", reason="unmet dependency EXPERT (is n)")
    verdict = Verification(subject="qemu-armv7", checked=1, mismatches=(wrong,), config="")
    with pytest.raises(UsageError, match="qemu-armv7: options do not hold: PREEMPT_RT"):
        kernel.build(data, "qemu-armv7", verdict)


def test_unknown_machine(capsys):
    assert main(["kernel", "build", "--machine", "beagle"]) == 2
    assert (
        capsys.readouterr().err
        == "rtgen: no kernel is built for machine beagle, only for pandaboard-es, qemu-armv7, vexpress-a9\n"
    )


@pytest.mark.parametrize("version", ["6.6", ""])
def test_a_version_without_a_pinned_source(version, capsys):
    assert main(["kernel", "build", "--machine", "qemu-armv7", "--kernel", version]) == 2
    expected = f"rtgen: no source of kernel {version!r} is pinned in kconfig/sources.yml, pinned: 6.1, 7.2\n"
    assert capsys.readouterr().err == expected
    assert main(["board", "build", "--machine", "qemu-armv7", "--kernel", version]) == 2
    expected = f"rtgen: --kernel: unknown kernel {version!r}, known: debian, both, built, 6.1, 7.2\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize("kernel", ["built", "7.2"])
def test_a_board_whose_kernel_rtgen_does_not_build(kernel, capsys):
    assert main(["board", "build", "--machine", "qemu-x86_64", "--kernel", kernel]) == 2
    expected = "no kernel is built for machine qemu-x86_64, only for pandaboard-es, qemu-armv7, vexpress-a9"
    assert capsys.readouterr().err == f"rtgen: {expected}\n"


def test_each_pinned_kernel_has_preempt_rt(data):
    for version, source in data.sources.items():
        assert version in data.kernels and source.release.startswith(f"{version}.")
        assert (source.patches is None) == (data.kernel(version).rt_series is None)


def test_boards_run_the_kernel_of_their_fragment(data):
    assert data.fragment_of("vexpress-a9") == data.fragment_of("qemu-armv7") == "qemu-armv7"
    assert data.fragment_of("pandaboard-es") == "qemu-armv7"


# Debian serves 7.2 for some weeks only: beside the board that boots it.
@pytest.mark.parametrize("version", [None, pytest.param("7.2", marks=pytest.mark.boards)])
def test_the_kernel_of_several_boards_has_what_each_of_them_needs(data, version):
    config = kernel.plan(data, "qemu-armv7", version).config
    boards = [board for board in data.machine("qemu-armv7").boards if board in data.machines]
    assert boards == ["pandaboard-es"]
    for board in boards:
        verdict = verify_config(data, board, config, ".config")
        assert verdict.mismatches == () and verdict.checked > 70
