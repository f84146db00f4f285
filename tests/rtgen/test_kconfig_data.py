"""The options as data: what is rendered for which kernel, and what is refused."""

import shutil

import pytest

from rtfiles.errors import UsageError
from rtgen.cli import main
from rtgen.kconfig import data as kconfig
from rtgen.kconfig.fragment import parse_fragment, values
from rtgen.kconfig.render import fragment_path, render


@pytest.fixture(scope="module")
def data():
    return kconfig.load()


@pytest.fixture
def copy(data, tmp_path):
    """A copy of kconfig/ that a test may break."""
    folder = tmp_path / "kconfig"
    shutil.copytree(data.folder, folder)
    return folder


def rendered(data, machine, kernel):
    return values(parse_fragment(render(data, machine, kernel), "rendered"))


def test_committed_fragments_are_as_rendered(data):
    wanted = [(machine, kernel) for machine in data.machines for kernel in data.kernels_of(machine)]
    for machine, kernel in wanted:
        assert fragment_path(data, machine, kernel).read_text() == render(data, machine, kernel)
    committed = {path.name for path in (data.folder / "fragments").iterdir()}
    assert committed == {f"{machine}-{kernel}.cfg" for machine, kernel in wanted}


def test_rt_is_preempt_rt_full_on_3_4_and_preempt_rt_with_expert_later(data):
    old, new = rendered(data, "pandaboard-es", "3.4"), rendered(data, "pandaboard-es", "6.1")
    assert old["PREEMPT_RT_FULL"] == "y" and "PREEMPT_RT" not in old
    assert new["PREEMPT_RT"] == "y" and new["EXPERT"] == "y" and "PREEMPT_RT_FULL" not in new


def test_3_4_gets_the_memory_that_rt_full_allows(data):
    old, new = rendered(data, "pandaboard-es", "3.4"), rendered(data, "pandaboard-es", "6.1")
    assert (old["SLAB"], old["HIGHMEM"], old["VMSPLIT_2G"]) == ("y", "n", "y")
    assert old["RT_GROUP_SCHED"] == "n"
    assert (new["VMSPLIT_3G_OPT"], new["SLUB_CPU_PARTIAL"]) == ("y", "n")
    assert not {"SLAB", "VMSPLIT_2G"} & new.keys() and not {"SLUB_CPU_PARTIAL", "OSNOISE_TRACER"} & old.keys()


def test_options_of_removed_and_later_symbols_follow_the_version(data):
    assert "SLUB_CPU_PARTIAL" in rendered(data, "pandaboard-es", "6.18")
    assert "SLUB_CPU_PARTIAL" not in rendered(data, "pandaboard-es", "7.1")
    assert "NO_HZ" in rendered(data, "pandaboard-es", "3.4")
    assert rendered(data, "pandaboard-es", "7.1")["HZ_PERIODIC"] == "y"


def test_sleep_states_can_be_forbidden_where_there_are_any(data):
    """/dev/cpu_dma_latency needs CPU_IDLE; on OMAP4 leaving such a state takes a millisecond."""
    wanted = {machine: rendered(data, machine, "6.6")["CPU_IDLE"] for machine in data.machines}
    assert wanted == {"pandaboard-es": "n", "qemu-armv7": "n", "arm": "n", "arm64": "y", "x86-64": "y"}


def test_version_numbers_compare_as_numbers():
    option = kconfig.KernelOption(symbol="X", value="y", reason="r", source="s", since="6.2")
    assert option.holds_for("6.12") and not option.holds_for("6.1")


@pytest.mark.parametrize("kernel", ["3.4", "6.1", "6.6", "6.12", "6.18"])
def test_head_names_the_patch_series_before_7_1(data, kernel):
    head = render(data, "pandaboard-es", kernel).split("\n\n")[0]
    assert f"only with the patch series {kernel}-rt" in head


def test_head_names_no_patch_series_from_7_1_on(data):
    assert "no patch series is needed" in render(data, "pandaboard-es", "7.1").split("\n\n")[0]


@pytest.mark.parametrize("machine", ["arm64", "x86-64"])
def test_other_architectures_need_a_patch_series_before_6_12_only(data, machine):
    heads = {kernel: render(data, machine, kernel).split("\n\n")[0] for kernel in data.kernels_of(machine)}
    with_series = [kernel for kernel, head in heads.items() if "only with the patch series" in head]
    assert with_series == ["5.15", "6.1", "6.6"]
    assert all("no patch series is needed" in heads[kernel] for kernel in heads if kernel not in with_series)


def test_options_of_32_bit_arm_are_not_rendered_for_others(data):
    assert {"NR_CPUS", "CPUFREQ_DT", "CPU_IDLE", "ARM_ERRATA_754322"} <= rendered(data, "pandaboard-es", "6.12").keys()
    for machine in ("arm64", "x86-64"):
        of_arm = {"NR_CPUS", "CPUFREQ_DT", "CPU_FREQ_GOV_SCHEDUTIL", "VMSPLIT_3G_OPT"}
        assert not of_arm & rendered(data, machine, "6.12").keys()
        assert rendered(data, machine, "6.12")["PREEMPT_RT"] == "y"


def test_a_kernel_that_is_too_old_for_the_machine(data):
    with pytest.raises(UsageError, match=r"^arm64 has fragments from kernel 5\.15 on, not for 3\.4$"):
        render(data, "arm64", "3.4")


def test_a_fragment_sets_what_is_wanted_and_nothing_else(data):
    for machine in data.machines:
        for kernel in data.kernels_of(machine):
            assert rendered(data, machine, kernel) == data.wanted(machine, kernel)


@pytest.mark.parametrize(
    ("kernel", "nearest"),
    [
        ("2.6", "3.4"),
        ("4.19", "5.15"),
        ("5.10", "5.15"),
        ("5.19", "6.1"),
        ("6.8", "6.6"),
        ("6.9", "6.6"),  # as near as 6.12
        ("6.10", "6.12"),
        ("7.0", "7.1"),  # two after 6.18
        ("8.3", "7.2"),
    ],
)
def test_the_nearest_data_of_a_kernel(data, kernel, nearest):
    basis = data.basis(kernel)
    assert (basis.options_of, basis.rt_of) == (kernel, nearest)
    assert basis.remark(kernel) == f" (by the data of {nearest}, the nearest)"


def test_a_kernel_with_data_is_its_own_basis(data):
    for kernel in data.kernels:
        basis = data.basis(kernel)
        assert (basis.options_of, basis.rt_of, basis.remark(kernel)) == (kernel, kernel, "")


def test_what_a_kernel_without_data_cannot_have_is_not_asked_of_it(data):
    """The options say since when they exist: those of its nearest data may be newer than the kernel."""
    assert {"OSNOISE_TRACER", "SLUB_CPU_PARTIAL"} <= data.wanted("arm64", "5.15").keys()
    assert "OSNOISE_TRACER" not in data.wanted("arm64", "5.10")
    assert "SLUB_CPU_PARTIAL" not in data.wanted("arm64", "7.0")


def test_errata_that_a_multiplatform_kernel_cannot_have_are_never_rendered(data):
    for kernel in data.kernels:
        assert not {"ARM_ERRATA_743622", "ARM_ERRATA_751472"} & rendered(data, "pandaboard-es", kernel).keys()


def test_unknown_kernel_and_machine_list_the_known_ones(capsys):
    assert main(["kconfig", "render", "--check", "--machine", "pandaboard-es", "--kernel", "5.10"]) == 2
    known = "3.4, 5.15, 6.1, 6.6, 6.12, 6.18, 7.1, 7.2"
    assert capsys.readouterr().err == f"rtgen: unknown kernel '5.10', did you mean '5.15'? known: {known}\n"
    assert main(["kconfig", "render", "--check", "--machine", "beagle", "--kernel", "6.1"]) == 2
    assert (
        capsys.readouterr().err
        == "rtgen: unknown machine 'beagle', known: pandaboard-es, qemu-armv7, arm, arm64, x86-64\n"
    )


def test_check_shows_the_drift_and_writes_nothing(copy, monkeypatch, capsys):
    monkeypatch.setattr(kconfig.load, "__defaults__", (copy,))
    path = copy / "fragments/pandaboard-es-6.1.cfg"
    path.write_text(path.read_text().replace("CONFIG_HZ_250=y", "CONFIG_HZ_100=y"))
    changed = path.read_text()
    assert main(["kconfig", "render", "--check"]) == 1
    out = capsys.readouterr().out
    assert "-CONFIG_HZ_100=y\n+CONFIG_HZ_250=y\n" in out and "kconfig/fragments/pandaboard-es-6.1.cfg" in out
    assert path.read_text() == changed
    assert main(["kconfig", "render", "--machine", "pandaboard-es", "--kernel", "6.1"]) == 0
    assert main(["kconfig", "render", "--check"]) == 0


def test_an_option_given_twice_is_refused(copy):
    path = copy / "options/power.yml"
    path.write_text(path.read_text() + "  - {symbol: KSM, value: n, source: s, reason: r}\n")
    with pytest.raises(UsageError, match=r"memory\.yml: KSM is given twice to pandaboard-es 3\.4.*power\.yml"):
        kconfig.load(copy)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{symbol: CONFIG_foo, value: y, source: s, reason: r}", "options.5.symbol"),
        ("{symbol: FOO, value: maybe, source: s, reason: r}", r"options\.5\.value: a value is y, m, n, a number"),
        ("{symbol: FOO, value: y, source: s}", "options.5.reason"),
        ("{symbol: FOO, value: y, source: s, reason: r, since: 6}", "options.5.since"),
    ],
)
def test_a_malformed_option_is_refused_with_its_place(copy, line, message):
    path = copy / "options/validation.yml"
    path.write_text(path.read_text() + f"  - {line}\n")
    with pytest.raises(UsageError, match=rf"validation\.yml:[0-9]+: {message}"):
        kconfig.load(copy)


def test_a_machine_with_an_unknown_concern_is_refused(copy):
    path = copy / "machines.yml"
    path.write_text(path.read_text().replace("programs, board]", "programs, bored]"))
    message = (
        r"machines\.yml: machines\.pandaboard-es\.concerns: unknown concern 'bored', did you mean 'board'\? known: arm,"
    )
    with pytest.raises(UsageError, match=message):
        kconfig.load(copy)
