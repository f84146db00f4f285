"""The real apt and mmdebstrap against a Debian mirror on loopback whose index and files do not belong together."""

import functools
import hashlib
import http.server
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rtfiles.errors import InfrastructureError
from rtgen import debian
from rtgen.board import disk, packages
from rtgen.board.kernel import debian_kernel
from rtgen.board.machine import find
from rtgen.kconfig import data as kconfig
from rtgen.kconfig import debian_source

RELEASE = "bookworm"
PACKAGE = "linux-source-6.1"
VERSION = "6.1.0-1"
INDEX = f"/dists/{RELEASE}/main/binary-armhf/Packages"
ARCHIVE = f"/pool/{PACKAGE}_{VERSION}_all.deb"
# Whether a file is served with a size that is not the index's, by how often it was asked for and what caches were told.
FAULTS: dict[str, Callable[[int, str], bool]] = {
    "once": lambda asked, _: asked == 1,
    "until asked past caches": lambda _, cache_control: "no-cache" not in cache_control,
    "always": lambda *_: True,
}


class Mirror(http.server.ThreadingHTTPServer):
    """A release with one package; `fault` concerns the file `at` this path."""

    fault: Callable[[int, str], bool]
    at: str
    asked: int

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(http.server.SimpleHTTPRequestHandler):
    server: Mirror

    def do_GET(self) -> None:
        if self.path == self.server.at:
            self.server.asked += 1
            if self.server.fault(self.server.asked, self.headers["Cache-Control"] or ""):
                content = Path(self.translate_path(self.path)).read_bytes() + b"\n"
                self.send_response(200)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)
                return
        super().do_GET()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the mirror, made by Debian's own tools."""
    top, content = tmp_path_factory.mktemp("mirror"), tmp_path_factory.mktemp("content")
    (content / "DEBIAN").mkdir()
    (content / "DEBIAN/control").write_text(
        f"Package: {PACKAGE}\nVersion: {VERSION}\nArchitecture: all\nMaintainer: Nobody <no@body>\nDescription: -\n"
    )
    (content / "usr/src").mkdir(parents=True)
    (content / "usr/src/file").write_text("from the package")
    for file in (INDEX, ARCHIVE):
        (top / file[1:]).parent.mkdir(parents=True)
    subprocess.run(["dpkg-deb", "--root-owner-group", "--build", content, top / ARCHIVE[1:]], check=True)
    index = subprocess.run(["dpkg-scanpackages", "pool"], cwd=top, check=True, capture_output=True).stdout
    names = []
    # This machine's architecture, too: `apt-get download` is for that one.
    for architecture in ("armhf", subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip()):
        names.append(f"main/binary-{architecture}/Packages")
        (top / f"dists/{RELEASE}/{names[-1]}").parent.mkdir(exist_ok=True)
        (top / f"dists/{RELEASE}/{names[-1]}").write_bytes(index)
    sums = "".join(f" {hashlib.sha256(index).hexdigest()} {len(index)} {name}\n" for name in names)
    (top / f"dists/{RELEASE}/Release").write_text(
        f"Codename: {RELEASE}\nDate: Mon, 01 Jan 2024 00:00:00 UTC\nComponents: main\nSHA256:\n{sums}"
    )
    return top


@pytest.fixture
def mirror(release: Path) -> Iterator[Mirror]:
    with Mirror(("127.0.0.1", 0), functools.partial(Handler, directory=str(release))) as server:
        server.asked = 0
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("at", [INDEX, ARCHIVE])
def test_a_mirror_in_the_middle_of_an_update_is_asked_again_past_caches(
    mirror: Mirror, at: str, fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mirror.at, mirror.fault = at, FAULTS[fault]
    # What it serves is not signed.
    source = debian.PackageSource(release=RELEASE, mirror=f"[trusted=yes] {mirror.address}")
    if fault == "always":
        with pytest.raises(InfrastructureError) as raised:
            debian.extract([PACKAGE], tmp_path, "armhf", source)
        assert str(raised.value).startswith(f"cannot download {mirror.address}{at}: File has unexpected size (")
        assert str(raised.value).endswith("(past caches, too: try again later)")
        assert "\n" not in str(raised.value)
        assert list(tmp_path.iterdir()) == []
    else:
        debian.extract([PACKAGE], tmp_path, "armhf", source)
        assert (tmp_path / "usr/src/file").read_text() == "from the package"
        assert debian.installed(tmp_path) == {PACKAGE: VERSION}
        # A setting for this download is none for the board.
        assert list(tmp_path.glob("etc/apt/apt.conf.d/*")) == []
    assert "downloading again, past caches" in capsys.readouterr().err
    assert mirror.asked == 2


def test_a_release_is_asked_for_by_its_other_name(
    mirror: Mirror, release: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its own name leads to files that do not belong together, past caches, too; only while it is that one."""
    monkeypatch.setattr(debian, "OTHER_NAMES", {RELEASE: "other", "next": "other"})
    other = release / "dists" / "other"
    other.symlink_to(RELEASE)
    try:
        mirror.at, mirror.fault = INDEX, FAULTS["always"]
        source = debian.PackageSource(release=RELEASE, mirror=f"[trusted=yes] {mirror.address}")
        debian.extract([PACKAGE], tmp_path, "armhf", source)
        assert (tmp_path / "usr/src/file").read_text() == "from the package"
        (release / "dists" / "next").symlink_to(RELEASE)
        mirror.at = INDEX.replace(RELEASE, "next")
        source = debian.PackageSource(release="next", mirror=source.mirror)
        with pytest.raises(InfrastructureError, match=f"^cannot download {mirror.address}{mirror.at}: "):
            debian.extract([PACKAGE], tmp_path, "armhf", source)
    finally:
        for link in (other, release / "dists" / "next"):
            link.unlink(missing_ok=True)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_source_of_a_kernel_is_asked_for_again_past_caches(
    mirror: Mirror, release: Path, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mirror.at, mirror.fault = ARCHIVE, FAULTS[fault]
    unsigned = tmp_path / "apt.conf"
    unsigned.write_text('Acquire::AllowInsecureRepositories "true"; APT::Get::AllowUnauthenticated "true";\n')
    monkeypatch.setenv("APT_CONFIG", str(unsigned))
    monkeypatch.setenv("LC_ALL", "C.UTF-8")
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(debian_source, "source", lambda: debian.PackageSource(release=RELEASE, mirror=mirror.address))
    archive, pinned = release / ARCHIVE[1:], kconfig.load().source()
    checksum = hashlib.sha256(archive.read_bytes()).hexdigest()
    tree = pinned.tree.model_copy(update={"package": PACKAGE, "file": archive.name, "sha256": checksum})
    pinned = pinned.model_copy(update={"version": VERSION, "suites": [RELEASE], "tree": tree, "patches": None})
    if fault == "always":
        with pytest.raises(InfrastructureError, match=f"^cannot download {mirror.address}{ARCHIVE}: .*past caches"):
            debian_source.downloads(pinned)
    else:
        assert (debian_source.downloads(pinned) / archive.name).read_bytes() == archive.read_bytes()
    assert mirror.asked == 2


def test_a_root_file_system_is_made_of_the_packages_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For other drivers, another kernel or changed files of ours; no mirror is asked."""
    machine, source = find("qemu-armv7"), packages.source(None)
    names, dropped = disk.package_names(machine, source.release), packages.packages().dropped
    held = packages.unpacked(names, machine.architecture, source, dropped)
    kernel = debian_kernel(machine.kernel, machine, source)

    def unreachable(*_: object) -> None:
        raise InfrastructureError("a mirror is asked")

    monkeypatch.setattr(debian, "extract", unreachable)
    (tmp_path / "disk").mkdir()
    disk.build(machine.model_copy(update={"modules": {}}), [kernel], source, tmp_path / "disk")
    assert debian.installed(tmp_path / "disk") == debian.installed(held)
