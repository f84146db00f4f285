"""Real servers for the tests: an sshd on loopback with keys of its own."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
import xmlrpc.client
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import settings

from ports import free_port
from rtrun.targets.address import Address
from rtrun.targets.config import Target

# A shell that starts us in the background lets us, and all we start, ignore Ctrl-C; the tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Beside one another tests get the width of the terminal that they were started in; what they print has a fixed one.
os.environ.pop("COLUMNS", None)

# How long an example takes is up to what else runs on the machine.
settings.register_profile("no-deadline", deadline=None)
settings.load_profile("no-deadline")

# What there is once, by the marker of the tests that use it. Where tests run beside one another, those of a
# group follow each other on one worker; so do the tests of a file that share a fixture, which is made once then.
GROUPS = {
    "qemu": "board",  # an emulated board keeps both CPUs busy
    "trace": "trace",  # of the machine's kernel
}

# The files whose tests build what the cache lacks, or wait while another worker does; longer ones say so themselves.
HERE = Path(__file__).parent
BUILDING = (
    "rtgen/test_board_build.py",
    "rtgen/test_kconfig_verify.py",
    "rtgen/test_kernel.py",
    "rtgen/test_suites.py",
    "suites/",
    "test_wheel.py",
)
BUILD_S = 1200

BOOT_ID = "/proc/sys/kernel/random/boot_id"
SSHD = shutil.which("sshd", path="/usr/sbin:/usr/bin:/sbin") or "/usr/sbin/sshd"


def group_of(item: pytest.Item) -> str | None:
    """The group of a test, None where it shares nothing."""
    if named := item.get_closest_marker("xdist_group"):
        return str(named.args[0])
    for name, group in GROUPS.items():
        if item.get_closest_marker(name):
            return group
    fixtures = item._fixtureinfo.name2fixturedefs.values()
    is_shared = any(fixture[-1].scope in ("module", "class") for fixture in fixtures)
    return item.nodeid.partition("::")[0] if is_shared else None


def sees_pids_of_the_kernel() -> bool:
    """Whether pids here are those that the kernel traces: of its first namespace (PROC_PID_INIT_INO)."""
    try:
        return str(Path("/proc/1/ns/pid").readlink()) == "pid:[4026531836]"
    except OSError:
        return True  # nobody but root may know


@pytest.fixture
def pids_of_the_kernel() -> None:
    """Skips where pids are those of a container."""
    if not sees_pids_of_the_kernel():
        pytest.skip("a container with pids of its own")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Give builds their time, and put each test into its group where tests run beside one another."""
    for item in items:
        is_building = item.path.relative_to(HERE).as_posix().startswith(BUILDING)
        if is_building and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(BUILD_S))
        is_traced = (group_of(item) or "").endswith("trace")
        root = item.get_closest_marker("root")
        if os.geteuid() != 0 and (is_traced or root):
            why = root.args[0] if root and root.args else "needs root"
            item.add_marker(pytest.mark.skip(reason=why))
        if is_traced and not sees_pids_of_the_kernel():
            item.add_marker(
                pytest.mark.skip(reason="a container with pids of its own: the kernel traces those of its host")
            )
    if not hasattr(config, "workerinput"):
        return
    groups = {item: group_of(item) for item in items}
    for item, group in groups.items():
        if group and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(group))
    # The long ones begin first, so that none is left over when the other workers have nothing to do.
    ranks = {name: rank for rank, name in enumerate(GROUPS.values())}
    items.sort(key=lambda item: ranks.get(groups[item] or "", len(ranks) + (groups[item] is None)))


@dataclass(frozen=True)
class Sshd:
    """A running sshd and what a client needs to log in."""

    port: int
    key: Path
    host_key: str
    user: str
    folder: Path
    process: subprocess.Popen[bytes]
    host: str

    @property
    def address(self) -> Address:
        return Address(host=self.host, port=self.port, user=self.user, key=self.key, host_key=self.host_key)

    def target(self, work_dir: Path, *, suites: Path | None = None, master_port: int = 11311) -> Target:
        """A target behind it, called loopback."""
        return Target(
            name="loopback",
            address=self.address,
            suites=suites,
            work_dir=PurePosixPath(work_dir),
            setup=None,
            master_port=master_port,
            reconnect_s=20,
        )


@pytest.fixture(scope="session")
def sshd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sshd]:
    """A real OpenSSH server for this user, with forwarding, on a port of its own."""
    with serve(tmp_path_factory.mktemp("sshd")) as server:
        yield server


def seeing(files: Mapping[str, Path]) -> tuple[str, ...]:
    """What runs a command that sees each of these files instead of the one at that path. Skips where it cannot."""
    mounts = [f'mount --bind "${2 * number + 1}" "${2 * number + 2}"' for number in range(len(files))]
    script = " && ".join([*mounts, f"shift {2 * len(files)}", 'exec "$@"'])
    words = [word for path, file in files.items() for word in (str(file), path)]
    wrapper = ("unshare", "--mount", "sh", "-c", script, "sh", *words)
    if subprocess.run([*wrapper, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this user may not mount in a namespace of its own")
    return wrapper


def apart() -> tuple[str, ...]:
    """What runs a command whose processes see, and can signal, none but their own. Skips where it cannot."""
    wrapper = ("unshare", "--pid", "--fork", "--mount-proc", "--kill-child")
    if subprocess.run([*wrapper, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this user may not make a namespace of processes")
    return wrapper


def without_groups() -> tuple[str, ...]:
    """As `apart`, and the command sees no control groups."""
    return (*apart(), "unshare", "--mount", "sh", "-c", 'mount -t tmpfs tmpfs /sys/fs/cgroup && exec "$@"', "sh")


@contextlib.contextmanager
def kernel_threads_hidden(folder: Path) -> Iterator[tuple[str, ...]]:
    """What runs a command in a folder where it sees no process but those run so, as in a container. Skips as above.

    Mounts that are made later are not seen there.
    """
    argv = ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child", "sh", "-c", "echo begun; exec sleep infinity"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as holder:
        try:
            if holder.stdout is None or holder.stdout.readline() != b"begun\n":
                pytest.skip("this user may not make namespaces")
            first = Path(f"/proc/{holder.pid}/task/{holder.pid}/children").read_text().strip()
            yield ("nsenter", f"--target={first}", "--pid", "--mount", f"--wd={folder}")
        finally:
            holder.kill()


@pytest.fixture(scope="session")
def sampler_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program rt_tests_sampler for this machine, compiled without a warning."""
    source = Path(__file__).parents[1] / "recipes-tests" / "rt_tests_sampler" / "src" / "main.c"
    program = tmp_path_factory.mktemp("sampler") / "rt_tests_sampler"
    subprocess.run(["cc", "-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-o", program, source], check=True)
    return program


@contextlib.contextmanager
def serve(folder: Path, wrapper: tuple[str, ...] = (), host: str = "127.0.0.1") -> Iterator[Sshd]:
    """Run an OpenSSH server whose files are in a folder; `wrapper` is the command that runs it, `host` its address."""
    for name in ("host_key", "client_key"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    shutil.copy(folder / "client_key.pub", folder / "authorized_keys")
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)
    port = free_port(host)
    # SHLVL: bash takes itself for no login, and does not read this user's .bashrc at every command.
    (folder / "config").write_text(
        f"""Port {port}
ListenAddress {host}
HostKey {folder}/host_key
AuthorizedKeysFile {folder}/authorized_keys
PidFile none
StrictModes no
UsePAM no
PasswordAuthentication no
PermitRootLogin prohibit-password
MaxStartups 100
SetEnv SHLVL=1
"""
    )
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([*wrapper, SSHD, "-D", "-e", "-f", folder / "config"], stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + 30
        while True:
            try:
                socket.create_connection((host, port), timeout=1).close()
                break
            except OSError:
                assert process.poll() is None and time.monotonic() < deadline, (folder / "log").read_text()
                time.sleep(0.02)
        yield Sshd(
            port=port,
            key=folder / "client_key",
            host_key=" ".join((folder / "host_key.pub").read_text().split()[:2]),
            user=subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip(),
            folder=folder,
            process=process,
            host=host,
        )
    finally:
        process.terminate()
        process.wait(60)


@pytest.fixture(scope="session")
def ros_master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of a real ROS master on loopback, started once for all tests."""
    port = free_port()
    folder = tmp_path_factory.mktemp("rosmaster")
    environment = os.environ | {"ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder)}
    with (folder / "log").open("wb") as log:
        argv = ["rosmaster", "--core", "-p", str(port)]
        process = subprocess.Popen(argv, env=environment, stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + 60
        while True:
            try:
                with xmlrpc.client.ServerProxy(f"http://127.0.0.1:{port}") as master:
                    master.getPid("/tests")
                break
            except OSError:
                assert process.poll() is None and time.monotonic() < deadline, (folder / "log").read_text()
                time.sleep(0.05)
        yield port
    finally:
        process.terminate()
        process.wait(60)
