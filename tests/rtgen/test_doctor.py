"""Whether a host can build an image: each thing that prevents it is named with its remedy."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from rtgen import doctor
from rtgen.checkout import checkout
from rtgen.cli import main
from rtgen.doctor import GIB, Host
from rtgen.profile import load_profile, load_releases, profile_names

NEEDS = doctor.load_needs()
BUILD = doctor.load_build(load_profile("scarthgap-jazzy")[0])
GOOD = Host(
    folder=Path("/home/me/yocto"),
    versions={name: program.version for name, program in NEEDS.programs.items()},
    locales=frozenset({"C", "en_US.utf8"}),
    free_bytes=200 * GIB,
    memory_bytes=16 * GIB,
    free_memory_bytes=12 * GIB,
    open_files=1024,
    user_namespaces=True,
    root=False,
    proxies={},
)


def findings(**changes):
    found = doctor.judge(dataclasses.replace(GOOD, **changes), NEEDS, BUILD)
    return [(finding.fatal, finding.what, finding.remedy) for finding in found]


def test_a_good_host():
    assert findings() == []


def without(*programs):
    return {name: version for name, version in GOOD.versions.items() if name not in programs}


@pytest.mark.parametrize(
    ("changes", "fatal", "what", "remedy"),
    [
        ({"versions": without("lz4c", "zstd", "pzstd")}, True, "not installed: lz4c, pzstd, zstd",
         "sudo apt-get install lz4 zstd"),
        ({"versions": {**GOOD.versions, "gcc": "7.5.0"}}, True, "gcc is version 7.5.0, BitBake needs 8.0",
         "buildtools"),
        ({"locales": frozenset({"C", "C.utf8"})}, True, "locale en_US.UTF-8", "localedef -i en_US -f UTF-8"),
        ({"root": True}, True, "you are root", "build as another user"),
        ({"user_namespaces": False}, True, "user namespaces", "kernel.apparmor_restrict_unprivileged_userns=0"),
        ({"folder": Path("/home/me/my yocto")}, True, "/home/me/my yocto has ' ' in its path", "no blank, + or @"),
        ({"folder": Path("/home/me/c++")}, True, "/home/me/c++ has '+' in its path", "no blank, + or @"),
        ({"free_bytes": 60 * GIB}, False, "60 GiB are free in /home/me/yocto, a first build needs 90 GiB",
         "rm-work.yml"),
        ({"free_bytes": 39 * GIB}, True, "39 GiB are free", "on a larger disk"),
        ({"memory_bytes": 4 * GIB}, False, "4.0 GiB of memory, 8 GiB are the least", 'BB_NUMBER_THREADS = "2"'),
        ({"open_files": 256}, False, "a process may open 256 files only", "ulimit -n 1024"),
        ({"proxies": {"http_proxy": "a", "GIT_PROXY_COMMAND": "x"}}, False, "https_proxy is not", "export"),
        ({"proxies": {"http_proxy": "a", "https_proxy": "a"}}, False, "git:// addresses", "GIT_PROXY_COMMAND"),
    ],
)  # fmt: skip
def test_what_prevents_or_spoils_a_build(changes, fatal, what, remedy):
    ((is_fatal, message, advice),) = findings(**changes)
    assert is_fatal == fatal and what in message and remedy in advice


def test_versions_compare_as_numbers_and_fatal_findings_come_first():
    assert findings(versions={**GOOD.versions, "gcc": "12.2.0", "git": "2.39"}) == []
    found = findings(memory_bytes=GIB, root=True)
    assert [fatal for fatal, _, _ in found] == [True, False]


def test_a_host_with_8_gib_has_a_little_less():
    assert findings(memory_bytes=int(7.6 * GIB)) == []


def test_this_host_is_looked_at(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("http_proxy", "http://localhost:1")
    monkeypatch.delenv("https_proxy", raising=False)
    status = main(["doctor", str(tmp_path)])
    out = capsys.readouterr().out.splitlines()
    assert status == int("cannot build" in out[0])
    assert any(line.startswith("  note: http_proxy is set and https_proxy is not") for line in out)
    assert out[-1].startswith(f"Looked at: {len(NEEDS.programs)} programs, locale")
    host = doctor.inspect(tmp_path, NEEDS)
    assert host.versions.keys() == {name for name in NEEDS.programs if shutil.which(name)}
    assert host.versions["git"] and host.versions["tar"] and host.memory_bytes > 0 and host.free_bytes > 0


def test_what_a_build_takes_is_that_of_the_profile(tmp_path, capsys):
    main(["doctor", str(tmp_path), "--profile", "scarthgap-base"])
    out = capsys.readouterr().out
    build = doctor.load_build(load_profile("scarthgap-base")[0])
    assert f"A first build of scarthgap-base: {build.recipes} recipes in {build.tasks} tasks; by estimate" in out
    assert f" {build.gib} GiB ({build.rm_work_gib} GiB with kas/rm-work.yml) and {build.hours} hours" in out
    assert "\nHere: " in out and f"a first build needs {BUILD.gib} GiB" not in out
    main(["doctor", str(tmp_path), "--profile", "scarthgap-base", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["build"] == build.model_dump() and 0 < printed["free_memory_bytes"] <= printed["memory_bytes"]


def test_every_release_and_ros_says_what_a_build_takes():
    """Also those that only a profile of a user names."""
    for name, release in load_releases().items():
        for ros in release.ros_distros:
            data = load_profile(profile_names()[0])[0].model_copy(update={"release": name, "ros_distro": ros})
            assert doctor.load_build(data).gib > doctor.load_build(data).rm_work_gib > 0


def test_the_docs_tell_what_every_build_takes():
    """The only other place of these numbers."""
    text = (checkout() / "docs/layer.md").read_text()
    for name in profile_names():
        build = doctor.load_build(load_profile(name)[0])
        numbers = [
            build.recipes or "",
            build.tasks or "",
            build.counted,
            f"{build.gib} ({build.rm_work_gib})",
            build.hours,
        ]
        assert f"| {name} | {' | '.join(map(str, numbers))} |\n" in text


def test_a_program_that_is_not_there(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["doctor", str(tmp_path)]) == 1
    assert f"  mend: not installed: {', '.join(NEEDS.programs)}" in capsys.readouterr().out


def test_a_folder_that_is_not_there(tmp_path, capsys):
    assert main(["doctor", str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err == f"rtgen: {tmp_path / 'none'}: not a folder\n"
