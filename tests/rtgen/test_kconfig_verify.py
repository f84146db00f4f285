"""Fragments against the real 6.1 RT Kconfig tree: what holds, and the reason for each thing that does not."""

import gzip
import re
import shutil
import subprocess

import pytest

from rtfiles.errors import UsageError
from rtgen.cli import main
from rtgen.kconfig import data as kconfig
from rtgen.kconfig import debian_source
from rtgen.kconfig.fragment import kernel_of, parse_fragment
from rtgen.kconfig.render import config_line, render
from rtgen.kconfig.tree import ARCHITECTURES, open_tree
from rtgen.kconfig.verify import merge, read_base, verify_config, verify_tree


@pytest.fixture(scope="session")
def data():
    return kconfig.load()


@pytest.fixture(scope="session")
def tree(data):
    return debian_source.open_debian(data)


@pytest.fixture
def copy(tree, tmp_path):
    """A copy of the tree that a test may break."""
    shutil.copytree(tree.source, tmp_path / "linux")
    return tmp_path / "linux"


BASES = [
    ("pandaboard-es", "omap2plus_defconfig"),
    ("pandaboard-es", "multi_v7_defconfig"),
    ("qemu-armv7", "qemu-armv7_defconfig"),
    ("arm", "omap2plus_defconfig"),
    ("arm64", "defconfig"),
    ("x86-64", "x86_64_defconfig"),
]


def test_the_bases_below_are_all_there_are(data):
    assert [(name, base) for name, machine in data.machines.items() for base in machine.bases] == BASES


def test_every_option_holds(tree, capsys):
    assert main(["kconfig", "verify", "--source", str(tree.source)]) == 0
    lines = capsys.readouterr().out.splitlines()
    holding = [int(match[1]) for line in lines if (match := re.search(r": all (\d+) options hold$", line))]
    assert len(holding) == len(lines) == len(BASES) and min(holding) > 50


@pytest.mark.boards  # Debian serves this version for some weeks only: beside the board that boots it
@pytest.mark.parametrize(("machine", "base"), BASES)
def test_every_option_holds_where_mainline_has_preempt_rt(data, machine, base):
    tree = debian_source.open_debian(data, "7.2")
    fragment = parse_fragment(render(data, machine, "7.2"), "rendered")
    verdict = verify_tree(data, tree, machine, base, fragment, None)
    assert verdict.mismatches == () and verdict.checked == len(fragment) > 50
    assert "CONFIG_PREEMPT_RT=y\n" in verdict.config and "CONFIG_SUSPEND=y" not in verdict.config


@pytest.mark.parametrize(
    ("machine", "base"),
    [("qemu-armv7", "qemu-armv7_defconfig"), ("arm64", "defconfig"), ("x86-64", "x86_64_defconfig")],
)
def test_without_the_fragment_the_base_is_not_fit(data, tree, machine, base):
    verdict = verify_tree(data, tree, machine, base, (), "nothing")
    assert {"PREEMPT_RT", "OSNOISE_TRACER"} <= {item.symbol for item in verdict.mismatches}
    assert all(
        item.reason.startswith(("not in nothing; ", "this tree lacks")) or item.want == "n"
        for item in verdict.mismatches
    )


def broken(data, tree, change, machine="pandaboard-es"):
    """The mismatches of a fragment whose text was changed, by symbol."""
    text = render(data, machine, "6.1")
    changed = change(text)
    assert changed != text
    fragment = parse_fragment(changed, "mine.cfg")
    base = data.machine(machine).bases[0]
    verdict = verify_tree(data, tree, machine, base, fragment, "mine.cfg")
    return {item.symbol: (item.want, item.got, item.reason) for item in verdict.mismatches}


def test_expert_dropped(data, tree):
    # omap2plus_defconfig and multi_v7_defconfig have EXPERT themselves.
    mismatches = broken(data, tree, lambda text: text.replace("CONFIG_EXPERT=y\n", ""), "qemu-armv7")
    assert mismatches["EXPERT"][:2] == ("y", "n") and mismatches["EXPERT"][2].startswith("not in mine.cfg; ")
    assert mismatches["PREEMPT_RT"] == ("y", "n", "unmet dependency EXPERT (is n)")


# What is done to the rendered fragment of the PandaBoard, and the message about it: wanted, got, and why.
MISTAKES = [
    (r"^CONFIG_HOTPLUG_CPU=y$", "", "HOTPLUG_CPU", "y", "n",
     r"not in mine.cfg; is not set, and its default is n.*PM_SLEEP_SMP \(is n\)"),
    (r"\Z", "CONFIG_ARM_ERRATA_743622=y\n", "ARM_ERRATA_743622", "y", "n", r"unmet dependency !ARCH_MULTIPLATFORM$"),
    (r"\Z", "CONFIG_PREMPT_RT=y\n", "PREMPT_RT", "y", "nothing", r"undefined symbol .*, did you mean 'PREEMPT_RT'\?$"),
    (r"\Z", "# CONFIG_KSMM is not set\n", "KSMM", "n", "nothing", r"undefined symbol in .*, did you mean 'KSM'\?$"),
    (r"\Z", "CONFIG_HZ_1000=y\n", "HZ_250", "y", "n", r'choice lost: HZ_1000 was chosen in "Timer frequency"$'),
    (r"\Z", "# CONFIG_PM_OPP is not set\n", "PM_OPP", "n", "y", r"selected by .*ARCH_OMAP4 \(is y\)"),
    (r"^# CONFIG_KSM is not set$", "CONFIG_KSM=y", "KSM", "n", "y", r"mine\.cfg:\d+ says y; "),
    (r"^CONFIG_USB=y$", "CONFIG_USB=m", "USB_EHCI_HCD", "y", "m", r"unmet dependency USB \(is m\)$"),
    (r"^CONFIG_NR_CPUS=2$", "CONFIG_NR_CPUS=99", "NR_CPUS", "2", None, r"mine\.cfg:\d+ says 99; "),
]  # fmt: skip


def test_each_mistake_in_a_fragment_is_named_with_its_reason(data, tree):
    def with_mistakes(text):
        for pattern, replacement, *_ in MISTAKES:
            text, count = re.subn(pattern, replacement, text, count=1, flags=re.M)
            assert count == 1, pattern
        return text

    mismatches = broken(data, tree, with_mistakes)
    for _, _, symbol, want, got, reason in MISTAKES:
        wanted, present, message = mismatches[symbol]
        assert wanted == want and got in (None, present) and re.match(reason, message), (symbol, mismatches[symbol])
    assert len(mismatches) < len(MISTAKES) + 5, mismatches.keys()


def test_tree_without_the_rt_patches(data, copy):
    arch = copy / "arch/arm/Kconfig"
    arch.write_text(re.sub(r"\tselect ARCH_SUPPORTS_RT.*\n", "", arch.read_text()))
    fragment = parse_fragment(render(data, "pandaboard-es", "6.1"), "rendered")
    verdict = verify_tree(data, open_tree(copy), "pandaboard-es", "omap2plus_defconfig", fragment, None)
    mismatches = {item.symbol: item.reason for item in verdict.mismatches}
    assert mismatches["PREEMPT_RT"].startswith("this tree lacks the patch series 6.1-rt")


def test_command_on_a_broken_fragment(data, tree, tmp_path, capsys):
    mine = tmp_path / "mine.cfg"
    mine.write_text(render(data, "qemu-armv7", "6.1").replace("CONFIG_EXPERT=y\n", ""))
    arguments = ["kconfig", "verify", "--source", str(tree.source), "--fragment", str(mine), "--machine", "qemu-armv7"]
    assert main(arguments) == 1
    assert "PREEMPT_RT: wanted y, is n: unmet dependency EXPERT (is n)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CONFIG_A=y\nCONFIG_A=n\n", ":2: CONFIG_A is given twice, first in line 1: keep one"),
        ("# fine\nPREEMPT_RT=y\n", ":2: 'PREEMPT_RT=y' is not a config line, write CONFIG_NAME=value"),
        ("CONFIG_A=yes\n", ":1: 'CONFIG_A=yes' is not a config line"),
        ("CONFIG_A = y\n", ":1: 'CONFIG_A = y' is not a config line"),
        ("# CONFIG_A not set\n", ":1: '# CONFIG_A not set' is not a config line"),
        ("#CONFIG_A is not set\n", ":1: '#CONFIG_A is not set' is not a config line"),
        ('CONFIG_A="open\n', ":1: "),
    ],
)
def test_a_bad_line_of_a_fragment_is_named(tmp_path, text, message, capsys):
    path = tmp_path / "bad.cfg"
    path.write_text(text)
    assert main(["kconfig", "verify", "--source", "debian", "--machine", "qemu-armv7", "--fragment", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"rtgen: {path}{message}") and error.count("\n") == 1


def test_expanded_config_is_no_base(data, copy):
    finished = copy / "arch/arm/configs/omap2plus_defconfig"
    finished.write_text(
        "#\n# Automatically generated file; DO NOT EDIT.\n# Linux/arm 6.1.176 Kernel Configuration\n#\n"
    )
    with pytest.raises(UsageError, match=r"omap2plus_defconfig:2: this is a finished \.config, not a defconfig"):
        read_base(data, open_tree(copy), ARCHITECTURES["arm"], "omap2plus_defconfig")


@pytest.mark.parametrize("missing", ["Kconfig", "scripts/kconfig/conf.c", "Makefile"])
def test_no_kernel_tree(copy, missing, capsys):
    (copy / missing).unlink()
    assert main(["kconfig", "verify", "--source", str(copy)]) == 2
    assert capsys.readouterr().err == f"rtgen: {copy}: not a kernel tree, it has no {missing}\n"


@pytest.mark.parametrize("file", ["Makefile", "localversion-rt", "arch/arm/configs/omap2plus_defconfig"])
def test_a_tree_with_what_is_no_text(copy, capsys, file):
    (copy / file).write_bytes(b"\xff")
    assert main(["kconfig", "verify", "--source", str(copy), "--machine", "arm"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("rtgen: ") and error.endswith(f"/{file}: not UTF-8 text\n")


def test_a_tree_of_a_version_without_data(copy, capsys):
    makefile = copy / "Makefile"
    makefile.write_text(makefile.read_text().replace("PATCHLEVEL = 1\n", "PATCHLEVEL = 2\n", 1))
    verify = ["kconfig", "verify", "--source", str(copy), "--machine", "qemu-armv7"]
    assert main(verify) == 0
    expected = (
        r"^qemu-armv7, Linux 6\.2\.\S+ \(by the data of 6\.1, the nearest\), qemu-armv7_defconfig: all \d+ options"
    )
    assert re.search(expected, capsys.readouterr().out, re.M)
    assert main([*verify, "--kernel", "5.15"]) == 0
    assert " (by the data of 5.15), qemu-armv7_defconfig: all " in capsys.readouterr().out
    assert main([*verify, "--kernel", "6.2"]) == 2
    assert "unknown kernel '6.2', did you mean '6.12'? known: 3.4, 5.15, 6.1" in capsys.readouterr().err


def test_a_tree_is_not_written_to(copy, data):
    before = sorted(path for path in copy.rglob("*"))
    subprocess.run(["chmod", "-R", "a-w", copy], check=True)
    verify_tree(data, open_tree(copy), "qemu-armv7", "qemu-armv7_defconfig", (), "nothing")
    assert sorted(path for path in copy.rglob("*")) == before


def test_missing_defconfig_lists_what_there_is(tree):
    with pytest.raises(UsageError, match=r"has no panda_defconfig for arm, it has: .*omap2plus_defconfig"):
        tree.defconfig("panda_defconfig", ARCHITECTURES["arm"])


def test_the_fragment_has_the_last_word_in_a_merge():
    base = parse_fragment("CONFIG_A=y\nCONFIG_B=m\n", "base")
    assert merge(base, parse_fragment("# CONFIG_A is not set\n", "f")) == "CONFIG_B=m\n# CONFIG_A is not set\n"


@pytest.fixture(scope="module")
def finished(data, tree):
    fragment = parse_fragment(render(data, "qemu-armv7", "6.1"), "rendered")
    return verify_tree(data, tree, "qemu-armv7", "qemu-armv7_defconfig", fragment, None).config


class TestFinishedConfig:
    """`--config`: a .config, a /boot/config, a /proc/config.gz."""

    def test_holds_packed_and_plain(self, finished, tmp_path, capsys):
        plain, packed = tmp_path / ".config", tmp_path / "config.gz"
        plain.write_text(finished)
        packed.write_bytes(gzip.compress(finished.encode()))
        for path in (plain, packed):
            assert main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(path)]) == 0
        assert capsys.readouterr().out.count("options hold") == 2

    def test_names_what_differs_and_why_it_matters(self, data, finished):
        text = finished.replace("CONFIG_PREEMPT_RT=y\n", "# CONFIG_PREEMPT_RT is not set\n")
        text = text.replace("# CONFIG_KSM is not set", "CONFIG_KSM=y")
        verdict = verify_config(data, "qemu-armv7", text, "theirs")
        mismatches = {item.symbol: (item.want, item.got) for item in verdict.mismatches}
        assert mismatches == {"PREEMPT_RT": ("y", "n"), "KSM": ("n", "y")}
        assert "merged pages fault again" in verdict.mismatches[-1].reason

    @pytest.mark.parametrize("symbol", ["FILE_LOCKING", "FUTEX", "UNIX", "PROC_SYSCTL", "UPROBE_EVENTS"])
    def test_a_kernel_that_cannot_run_the_programs(self, data, finished, symbol):
        """Such a kernel once passed: its target then said "flock: Function not implemented"."""
        text = finished.replace(f"CONFIG_{symbol}=y\n", f"# CONFIG_{symbol} is not set\n")
        (mismatch,) = verify_config(data, "qemu-armv7", text, "theirs").mismatches
        assert (mismatch.symbol, mismatch.want, mismatch.got) == (symbol, "y", "n")

    @pytest.mark.parametrize(
        ("machine", "head", "remark"),
        [
            ("arm64", "Linux/arm64 5.10.104-tegra", "arm64, Linux 5.10 (by the data of 5.15, the nearest), "),
            ("x86-64", "Linux/x86 6.8.1", "x86-64, Linux 6.8 (by the data of 6.6, the nearest), "),
            ("x86-64", "Linux/x86_64 7.0.0-rc1", "x86-64, Linux 7.0 (by the data of 7.1, the nearest), "),
            ("arm", "Linux/arm 6.1.176", "arm, Linux 6.1, "),
        ],
    )
    def test_every_kernel_is_compared_with_the_nearest_data(self, data, tmp_path, capsys, machine, head, remark):
        """A Jetson's, and those of Ubuntu 24.04 and 26.04."""
        kernel = kernel_of(f"# {head} Kernel Configuration\n")
        lines = [config_line(*pair) for pair in data.wanted(machine, kernel).items()]
        path = tmp_path / "config"
        path.write_text("\n".join([f"# {head} Kernel Configuration", *lines, ""]))
        verify = ["kconfig", "verify", "--machine", machine, "--config", str(path)]
        assert main(verify) == 0
        assert capsys.readouterr().out == f"{remark}{path}: all {len(lines)} options hold\n"
        path.write_text(path.read_text().replace("CONFIG_PREEMPT_RT=y\n", ""))
        assert main(verify) == 1
        out = capsys.readouterr().out
        assert f"{remark}{path}: 1 of {len(lines)} options do not hold\n  PREEMPT_RT: wanted y, is n: " in out

    def test_an_option_selects_the_data(self, data, finished, tmp_path, capsys):
        path = tmp_path / ".config"
        path.write_text(finished)
        verify = ["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(path), "--kernel"]
        assert main([*verify, "3.4"]) == 1
        out = capsys.readouterr().out
        assert "qemu-armv7, Linux 6.1 (by the data of 3.4), " in out and "PREEMPT_RT_FULL: wanted y, is n" in out
        assert main([*verify, "6.1"]) == 0
        assert f"qemu-armv7, Linux 6.1, {path}: all " in capsys.readouterr().out
        assert main([*verify, "5.10"]) == 2
        assert "unknown kernel '5.10', did you mean '5.15'? known: 3.4, 5.15, 6.1" in capsys.readouterr().err

    def test_cut_gzip(self, finished, tmp_path, capsys):
        path = tmp_path / "config.gz"
        path.write_bytes(gzip.compress(finished.encode())[:100])
        assert main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(path)]) == 2
        assert capsys.readouterr().err == f"rtgen: {path}: neither a text nor a whole gzip file\n"

    def test_a_fragment_is_no_finished_config(self, data, tmp_path, capsys):
        path = tmp_path / "fragment"
        path.write_text(render(data, "qemu-armv7", "6.1"))
        assert main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(path)]) == 2
        assert f"{path}:1: not a finished .config" in capsys.readouterr().err


def test_device_tree_compiles_and_gives_a_fine_clock(data, tree, tmp_path):
    """The PandaBoard's change on top of the tree's own omap4-panda-es.dts, through cpp and dtc, as kbuild does it."""
    original = next(tree.source.glob("arch/arm/boot/dts/**/omap4-panda-es.dts"))
    includes = ["-I", original.parent, "-I", tree.source / "include"]
    changed = data.folder / "devicetree/omap4-panda-es-rt.dts"
    cpp = ["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", *includes, changed]
    text = subprocess.run(cpp, check=True, capture_output=True).stdout
    dtb = tmp_path / "rt.dtb"
    subprocess.run(
        ["dtc", "-q", "-i", original.parent, "-I", "dts", "-O", "dtb", "-o", dtb, "-"], input=text, check=True
    )

    def get(node, name, kind="s"):
        done = subprocess.run(["fdtget", "-t", kind, dtb, node, name], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else None

    source = subprocess.run(["dtc", "-q", "-I", "dtb", "-O", "dts", dtb], check=True, capture_output=True, text=True)
    counter = re.search(r"counter@0 \{.*?\};", source.stdout, re.S)
    assert counter and 'compatible = "ti,omap-counter32k"' in counter[0] and 'status = "disabled"' in counter[0]
    assert get("/local-timer@48240600", "always-on") == ""
    assert get("/", "compatible").startswith("ti,omap4-panda-es")
