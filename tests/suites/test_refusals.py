"""What the programs refuse to do, and how they say so: no ROS master needed, nothing written."""

import re
from pathlib import Path

import pytest

from .conftest import PROGRAMS, Bench, options_of

NOTHING = ("--bounding-set=-all", "--inh-caps=-all", "--ambient-caps=-all")
# Root with just one of its capabilities, and no limits that would do instead.
ONLY_MEMORY = ("prlimit", "--rtprio=0", "setpriv", "--securebits=+noroot", *(f"{word},+ipc_lock" for word in NOTHING))
ONLY_PRIORITY = (
    *("prlimit", "--memlock=65536", "setpriv", "--securebits=+noroot"),
    *(f"{word},+sys_nice" for word in NOTHING),
)


@pytest.fixture
def offline(suites: Path, tmp_path: Path) -> Bench:
    """A bench without a ROS master: whoever asks one would wait for ever."""
    folder = tmp_path / "out"
    folder.mkdir()
    return Bench(suites, folder, {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin"}, [])


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_and_suites_yml_agree(offline: Bench, program: str) -> None:
    ended = offline.run(program, "--help")
    assert (ended.status, ended.err) == (0, "")
    lines = dict(re.findall(r"^  (-{1,2}[\w-]+) (.*)$", ended.out, re.M))
    options = options_of(program)
    assert set(lines) == {option["flag"] for option in options.values()} | {"--help", "--version"}
    for option in options.values():
        takes, description = re.fullmatch(r"(\S+) +(.*)", lines[option["flag"]]).groups()  # type: ignore[union-attr]
        if option["type"] == "int":
            assert takes == f"{option['min']}..{option['max']}"
        elif option["type"] == "choice":
            assert takes == "|".join(option["choices"])
        default = re.fullmatch(r".*? \[(.*)\]", description)
        assert (default[1] if default else "") == str(option["default"] if option["default"] is not None else "")


@pytest.mark.parametrize("program", PROGRAMS)
def test_version(offline: Bench, program: str) -> None:
    ended = offline.run(program, "--version")
    assert (ended.status, ended.out) == (0, f"{program} 0.1.0\n")


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-x"], "unknown option '-x'; {program} --help lists what there is"),
        (["extra"], "unknown option 'extra'; {program} --help lists what there is"),
        (["-r"], "-r takes 1..100000000, got nothing"),
        (["-r", "many"], "-r takes an integer from 1 to 100000000, got 'many'"),
        (["-r", "0"], "-r takes an integer from 1 to 100000000, got '0'"),
        (["-s", "EDF"], "-s takes 0|RR|FIFO, got 'EDF'"),
        (["--priority=99"], "--priority takes an integer from 1 to 98, got '99'"),
    ],
)
def test_bad_options(offline: Bench, program: str, arguments: list[str], message: str) -> None:
    ended = offline.run(program, *arguments)
    assert (ended.status, ended.out) == (2, "")
    assert ended.err == f"\tERROR: {message.format(program=program)}\n"
    assert offline.files() == []


def test_output_folder_is_looked_at_first(offline: Bench) -> None:
    ended = offline.run("cyclic_timer_tests", "--out-dir", "nowhere")
    assert ended.status == 2
    assert ended.err == (
        "\tERROR: output folder 'nowhere' (--out-dir, -p) must exist and be writable: No such file or directory\n"
    )


@pytest.mark.root
@pytest.mark.parametrize("program", PROGRAMS)
def test_missing_right_to_real_time(offline: Bench, program: str) -> None:
    ended = offline.run(program, "-s", "RR", before=ONLY_MEMORY)
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith(
        "\tERROR: cannot run with policy RR at priority 95: it needs the capability CAP_SYS_NICE or RLIMIT_RTPRIO"
    )
    assert ended.err.count("\n") == 1
    assert offline.files() == []


@pytest.mark.root
@pytest.mark.parametrize("program", PROGRAMS)
def test_missing_right_to_lock_memory(offline: Bench, program: str) -> None:
    ended = offline.run(program, "-s", "FIFO", before=ONLY_PRIORITY)
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith(
        "\tERROR: cannot lock memory: it needs the capability CAP_IPC_LOCK or a larger RLIMIT_MEMLOCK (now 65536 bytes)"
    )
    assert offline.files() == []


@pytest.mark.root
@pytest.mark.parametrize(
    ("place", "option", "message"),
    [
        (
            "/sys/kernel",
            ("--break-trace", "100"),
            "--break-trace and --trace-threshold need tracefs mounted and the right to write to it: ",
        ),
        (
            "/dev",
            ("--cpu-dma-latency", "0"),
            "cannot hold /dev/cpu_dma_latency at 0 us: --cpu-dma-latency needs root and a kernel with CONFIG_CPU_IDLE",
        ),
    ],
)
def test_what_the_kernel_does_not_offer(offline: Bench, place: str, option: tuple[str, str], message: str) -> None:
    # A mount namespace of its own, in which it is not there.
    hidden = ("unshare", "--mount", "sh", "-c", f'mount -t tmpfs none {place} && exec "$@"', "sh")
    ended = offline.run("oneshot_timer_tests", *option, before=hidden)
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith(f"\tERROR: {message}")
    assert offline.files() == []


def test_too_many_samples_for_the_memory(offline: Bench) -> None:
    if available_bytes() > 100_000_000 * 32:
        # Room for all of them here: a limit on the address space stands in for less memory.
        ended = offline.run("oneshot_timer_tests", "-r", "100000000", before=("prlimit", "--as=1000000000"))
        assert ended.err == "\tERROR: not enough memory for so many samples; ask for fewer with -r\n"
    else:
        ended = offline.run("oneshot_timer_tests", "-r", "100000000")
        assert ended.err.startswith("\tERROR: the samples need 3200 MB of memory, ")
    assert (ended.status, ended.out) == (1, "")
    assert offline.files() == []


def available_bytes() -> int:
    meminfo = Path("/proc/meminfo").read_text()
    return int(re.search(r"^MemAvailable:\s*(\d+) kB$", meminfo, re.M)[1]) * 1024  # type: ignore[index]
