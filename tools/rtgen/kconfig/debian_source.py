"""The pinned Debian kernels: a tree, and the RT patches from the same version of the source package.

Debian's ``linux-source`` packages do not contain the RT patches; the packaging part of the source package does, in
``debian/patches-rt``. Both must have the same version, or the patches do not apply. apt uses its own folder for the
download, and leaves the machine's package lists and sources as they are.
"""

import hashlib
import os
import re
import shutil
import tarfile
from collections.abc import Mapping
from pathlib import Path

from rtfiles import cache
from rtfiles.errors import InfrastructureError
from rtgen.debian import ENGLISH, download, failed_download, source
from rtgen.kconfig.data import Data, DebianSource
from rtgen.kconfig.tree import PATTERNS, Tree, open_tree, wanted
from rtgen.process import run

_SERIES = "debian/patches-rt"


def open_debian(data: Data, version: str | None = None) -> Tree:
    """The files that Kconfig reads of a pinned kernel's tree with its RT patches; the version is as in `Data.source`.

    The first time, this downloads 140 MB and takes half a minute. Raises UsageError for a version that is not pinned,
    InfrastructureError when Debian no longer serves it, or when a checksum is wrong.
    """
    pinned = data.source(version)

    def build(folder: Path) -> None:
        unpack(pinned, folder, whole=False)

    key = cache.digest([pinned.model_dump_json(), *PATTERNS, Path(__file__)])
    folder = cache.entry("kernel-kconfig", key, build)
    return open_tree(folder / "linux", f"debian {pinned.source} {pinned.version}")


def unpack(pinned: DebianSource, folder: Path, *, whole: bool) -> Path:
    """Unpack the pinned kernel with its RT patches to ``folder/linux``: all files or those that Kconfig reads."""
    files = downloads(pinned)
    packed = folder / "package"
    packed.mkdir()
    run(["dpkg-deb", "--extract", str(files / pinned.tree.file), str(packed)])
    archive = next((packed / "usr/src").glob("linux-source-*.tar.xz"))
    tree = folder / "linux"
    tree.mkdir()
    if whole:
        run(["tar", "-x", "-f", str(archive), "-C", str(tree), "--strip-components=1", "--no-same-owner"])
    else:
        _extract_wanted(archive, tree)
    if pinned.patches is not None:
        apply_patches(files / pinned.patches.file, packed, tree, whole=whole)
    shutil.rmtree(packed)
    return tree


def apply_patches(packaging: Path, folder: Path, tree: Path, *, whole: bool) -> None:
    """Apply the RT patches of a packaging archive to a whole tree, or to the files that Kconfig reads.

    The archive is unpacked into `folder`.
    """
    run(["tar", "-x", "-f", str(packaging), "-C", str(folder), "--no-same-owner", _SERIES])
    patches = folder / _SERIES
    for name in (patches / "series").read_text(encoding="utf-8").split("\n"):
        if name and not name.startswith("#"):
            text = (patches / name).read_bytes()
            if not whole:
                text = sections(text)
            if text:
                run(["patch", "-d", str(tree), "-p1", "--silent", "--force", "--no-backup-if-mismatch"], stdin=text)


def sections(patch: bytes) -> bytes:
    """The sections of a git patch whose file `tree.wanted` selects."""
    parts = re.split(rb"^(?=diff --git )", patch, flags=re.M)[1:]
    kept = []
    for part in parts:
        match = re.match(rb"diff --git a/\S+ b/(\S+)", part)
        if match and wanted(match[1].decode()):
            kept.append(part)
    return b"".join(kept)


def downloads(pinned: DebianSource) -> Path:
    """The folder with the pinned files, from the cache or downloaded and compared with their checksums."""

    def build(folder: Path) -> None:
        apt = folder / "apt"
        options = _private_apt(apt, pinned)
        package = f"{pinned.tree.package}={pinned.version}"

        def attempt(settings: Mapping[str, str]) -> None:
            command = ["apt-get", *options, *(f"-o{name}={value}" for name, value in settings.items())]
            environment = {**os.environ, **ENGLISH}
            run([*command, "update", "--error-on=any"], environment=environment)
            run([*command, "download", package], folder=folder, environment=environment)
            if pinned.patches is not None:
                packaging = f"{pinned.source}={pinned.version}"
                command += ["source", "--diff-only", "--download-only", packaging]
                run(command, folder=folder, environment=environment)

        try:
            download(attempt)
        except InfrastructureError as error:
            if failed := failed_download(str(error)):
                raise InfrastructureError(failed) from error
            served = run(["apt-cache", *options, "madison", str(pinned.tree.package)])
            versions = dict.fromkeys(line.split("|")[1].strip() for line in served.splitlines() if "|" in line)
            instead = f" (served: {', '.join(versions)}; pin one in kconfig/sources.yml)" if versions else ""
            raise InfrastructureError(f"{package} cannot be downloaded: {_apt_error(str(error))}{instead}") from error
        for file in filter(None, (pinned.tree, pinned.patches)):
            checksum = _sha256(folder / file.file)
            if checksum != file.sha256:
                raise InfrastructureError(f"{file.file}: sha256 is {checksum}, kconfig/sources.yml pins {file.sha256}")
        shutil.rmtree(apt)

    return cache.entry("kernel-source", cache.digest([pinned.model_dump_json(), "1"]), build)


def _apt_error(output: str) -> str:
    """The reason in the output of an apt that failed: its first line that begins with ``E:``, or all of it."""
    match = re.search(r"^\s*E: (.*)$", output, re.M)
    return match[1] if match else output


def _private_apt(folder: Path, pinned: DebianSource) -> list[str]:
    """Make folders and lists for apt in this folder; returns the options that make apt-get use them."""
    mirror = source().mirror
    if mirror is None:
        raise InfrastructureError("the kernel's source comes from Debian, but apt on this machine has no Debian mirror")
    (folder / "lists/partial").mkdir(parents=True)
    (folder / "archives/partial").mkdir(parents=True)
    (folder / "status").touch()
    keyring = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
    signed = f"[signed-by={keyring}] " if keyring.is_file() else ""
    (folder / "sources.list").write_text(
        "".join(f"{kind} {signed}{mirror} {suite} main\n" for suite in pinned.suites for kind in ("deb", "deb-src")),
        encoding="utf-8",
    )
    settings = {
        "Dir::State": folder, "Dir::State::status": folder / "status", "Dir::State::Lists": folder / "lists",
        "Dir::Cache": folder, "Dir::Etc::SourceList": folder / "sources.list", "Dir::Etc::SourceParts": "/dev/null",
        "Dir::Etc::Preferences": "/dev/null", "Dir::Etc::PreferencesParts": "/dev/null",
        "Acquire::Languages": "none", "APT::Sandbox::User": "",
        # A mirror's copy of a suite may be older than the suite allows. The checksums decide.
        "Acquire::Check-Valid-Until": "false",
    }  # fmt: skip
    return [f"-o{key}={value}" for key, value in settings.items()]


def _extract_wanted(archive: Path, tree: Path) -> None:
    with tarfile.open(archive, "r|xz") as stream:
        # Debian 12's Python 3.11.2 has no filters yet; the archive's checksum was right.
        stream.extraction_filter = getattr(tarfile, "data_filter", lambda member, _: member)
        for member in stream:
            _, _, name = member.name.partition("/")
            if (member.isfile() or member.issym()) and wanted(name):
                member.name = name
                stream.extract(member, tree)


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
