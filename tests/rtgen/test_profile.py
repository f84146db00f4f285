"""Profiles: what is read, and what is refused with file and key path."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from rtfiles.errors import UsageError
from rtgen.cli import main
from rtgen.commands import DEFAULT_PROFILE
from rtgen.profile import load_profile, profile_names, profile_path

ED25519 = f"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAI{'x' * 43}"


def changed(tmp_path: Path, *changes: tuple[str, object], base: str = DEFAULT_PROFILE) -> Path:
    """A copy of a profile with keys (dotted paths) changed; None removes one."""
    data = yaml.safe_load(profile_path(base).read_text())
    for dotted, value in changes:
        *path, last = dotted.split("/")
        node = data
        for key in path:
            node = node[key]
        if value is None:
            del node[last]
        else:
            node[last] = value
    file = tmp_path / "mine.yml"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def test_every_profile_loads():
    assert profile_names() == [
        "kirkstone-noetic", "scarthgap-base", "scarthgap-humble", "scarthgap-jazzy", "scarthgap-noetic", "thesis-2014",
        "wrynose-base", "wrynose-lyrical", "wrynose-noetic",
    ]  # fmt: skip
    for name in profile_names():
        profile, release = load_profile(name)
        assert profile.ros_distro in release.ros_distros
    assert list(load_profile(DEFAULT_PROFILE)[0].machines) == [
        "pandaboard-es", "qemuarm", "qemuarm64", "qemux86-64", "beaglebone-yocto", "genericarm64", "genericx86-64",
        "raspberrypi4-64", "raspberrypi5",
    ]  # fmt: skip


def test_thesis_profile_has_every_version_of_table_3_2_1():
    profile, _ = load_profile("thesis-2014")
    commits = {name: repository.commit for name, repository in profile.repositories.items()}
    assert commits == {
        "poky": "8e410e9e46e3335458a7747cdd32e05f5c19ccbb",
        "meta-openembedded": "40e0f371f3eb1628655c484feac0cebf810737b4",
        "meta-ros": "f6ce8dddab4e8c7bedf5adb31c541adbc3941f94",
        "meta-ti": "aacecf01794687af7c78cf98a979a3db8b69938a",
    }
    kernel = profile.machines["pandaboard"].kernel
    assert kernel.source is not None
    assert (kernel.source.branch, kernel.source.commit) == (
        "ti-ubuntu-3.4-1485",
        "b3d5eeb10553e4bc0c3f250a4d06d43c4ab397a9",
    )
    assert kernel.source.rt_patch.endswith("patch-3.4.9-rt17.patch.gz")
    assert profile.suites is not None
    assert profile.suites.commit == "a3f87bb3c259a9482a104b7346f38a1126be2821"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("release", "dunfel")], "release: unknown release 'dunfel', known: kirkstone, scarthgap, wrynose, dora"),
        ([("ros_distro", "hydro")], "ros_distro: 'hydro' is not supported with scarthgap, allowed: noetic, humble"),
        ([("machines/beagleboard", {"kernel": {"recipe": "linux-yocto-rt", "version": "6.6", "rt": "branch"},
                                    "serial_console": {"device": "ttyS2", "baud": 115200}})],
         "machines.beagleboard: 'beagleboard' is not supported with scarthgap, allowed: pandaboard-es, qemuarm"),
        ([("machines/qemuarm/kernel/version", "6.18")], "machines.qemuarm.kernel.version: '6.18' is not supported"),
        ([("machines/qemuarm/kernel/recipe", "linux-yocto")], "kernel.recipe: 'linux-yocto' is not supported"),
        ([("machines/qemuarm/kernel/rt", "patch")], "machines.qemuarm.kernel: rt: patch and source belong together"),
        ([("repositories/meta-ros/commit", "0b0756d1")], "meta-ros.commit: '0b0756d1' is not a commit of 40"),
        ([("repositories/meta-ros/commit", "G" * 40)], "is not a commit of 40 lower-case hex digits"),
        ([("repositories/meta-ros/url", "/home/me/meta-ros")], "is not an http(s) or git address"),
        ([("repositories/meta-ros", None)], "repositories: no repository has the layer 'meta-ros1-noetic'"),
        ([("ros_distro", "jazzy")], "no repository has the layer 'meta-ros2-jazzy', scarthgap needs it"),
        ([("machine", "qemuarm")], "unknown key 'machine', did you mean 'machines'? allowed: schema, summary, release"),
        ([("image/packages", ["htop; rm -rf /"])], "image.packages.0: 'htop; rm -rf /' is not a name"),
        ([("machines/pandaboard-es/serial_console/baud", "115200")], "machines.pandaboard-es.serial_console.baud: "),
        ([("machines/pandaboard-es/boot_arguments", ['a" b'])], "is not one boot argument"),
        ([("ssh/authorized_keys", ["-----BEGIN OPENSSH PRIVATE KEY-----"])],
         "ssh.authorized_keys.0: not a public key of the kinds ssh-ed25519, ecdsa-sha2-nistp256, ecdsa-"),
        ([("ssh/authorized_keys", ["ssh-ed25519 x"])], "ssh.authorized_keys.0: not a public key of the kinds"),
        ([("ssh/authorized_keys", [f"{ED25519} ${{HOME}}"])], "is not one line of printable text without $"),
        ([("ssh/authorized_keys", [f"{ED25519}\nx"])], "is not one line of printable text"),
        ([("repositories/meta-ros/branch", "a;b")], "repositories.meta-ros.branch: 'a;b' is not a branch of letters"),
        ([("repositories/meta-ros/layers", ["../x"])], "meta-ros.layers.0: '../x' is not a folder in the repository"),
        ([("repositories/meta-ros/layers", ["a: b"])], "meta-ros.layers.0: 'a: b' is not a folder in the repository"),
        ([("repositories/meta-rt-tests", {"url": "https://localhost/a", "commit": "a" * 40})],
         "repositories.meta-rt-tests: the name of the rendered layer, choose another"),
        ([("image/name", "rt_tests")], "image.name: 'rt_tests' is not a name of lower-case letters, digits and . + -"),
        ([("repositories/meta-ros/url", "https://localhost/ü")], "/ü' is not an http(s) or git address"),
        ([("machines/qemuarm/sd_card", {"boot_size_mib": 64, "root_extra_mib": 0})],
         "machines.qemuarm.sd_card: meta describes the card of qemuarm, leave it out"),
        ([("repositories/meta-raspberrypi", None)],
         "machines.raspberrypi5: no repository has its layer 'meta-raspberrypi', add one under repositories or leave"),
        ([("machines/genericx86-64/boot_arguments", ["quiet"])],
         "machines.genericx86-64.boot_arguments: its boot loader takes none from Yocto's settings, leave it out"),
        ([("ssh/server", "telnet")], "ssh.server: "),
    ],
)  # fmt: skip
def test_what_does_not_exist_is_refused(tmp_path, changes, message):
    file = changed(tmp_path, *changes)
    with pytest.raises(UsageError) as caught:
        load_profile(str(file))
    assert message in str(caught.value)
    assert all(line.startswith(f"{file}:") for line in str(caught.value).splitlines())


SOURCE = {
    "url": "git://localhost/linux.git",
    "branch": "main",
    "commit": "b" * 40,
    "rt_patch": "https://localhost/rt.patch",
}
SUITES = {"url": "https://localhost/suites", "branch": "main", "commit": "c" * 40, "version": "0.1.2"}


@pytest.mark.parametrize(
    ("base", "changes", "message"),
    [
        ("thesis-2014", [("machines/pandaboard/kernel/rt", "branch"), ("machines/pandaboard/kernel/source", None)],
         "machines.pandaboard.kernel.rt: 'branch' is not supported with dora, allowed: patch"),
        (DEFAULT_PROFILE, [("machines/qemuarm/kernel/rt", "patch"), ("machines/qemuarm/kernel/source", SOURCE)],
         "machines.qemuarm.kernel.rt: 'patch' is not supported with scarthgap, allowed: branch"),
        ("kirkstone-noetic", [("machines/qemuarm/kernel/version", "5.10")],
         "machines.qemuarm.kernel.version: '5.10' is not supported with kirkstone, allowed: 5.15"),
        ("thesis-2014", [("suites", {**SUITES, "branch": "a b"})], "suites.branch: 'a b' is not a branch of letters"),
        ("thesis-2014", [("machines/pandaboard/kernel/source/branch", 'a"b')], "source.branch: 'a\"b' is not a branch"),
        ("wrynose-noetic", [("suites", SUITES)], "suites: those of this repository are built in wrynose, leave it out"),
        ("thesis-2014", [("ssh/authorized_keys", [ED25519])], "keys.0: not a public key of the kinds ssh-rsa, or"),
        ("thesis-2014", [("suites", None)], "suites: those of this repository do not build in dora, give others"),
        (DEFAULT_PROFILE, [("repositories/bitbake", None)], "repositories: BitBake is missing, name a repository"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_release_is_refused(tmp_path, base, changes, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        load_profile(str(changed(tmp_path, *changes, base=base)))


def test_a_card_on_a_release_without_wic(tmp_path):
    card = ("machines/pandaboard/sd_card", {"boot_size_mib": 64, "root_extra_mib": 0})
    with pytest.raises(UsageError, match=r"machines\.pandaboard\.sd_card: dora has no image type wic"):
        load_profile(str(changed(tmp_path, card, base="thesis-2014")))


def test_a_key_given_twice(tmp_path):
    file = tmp_path / "twice.yml"
    file.write_text(profile_path(DEFAULT_PROFILE).read_text() + "release: kirkstone\n")
    with pytest.raises(UsageError, match=r"twice\.yml:\d+: key 'release' is given twice"):
        load_profile(str(file))


def test_an_unknown_name():
    with pytest.raises(UsageError, match="unknown profile 'dora', known: kirkstone-noetic, scarthgap-base,"):
        load_profile("dora")


KEYS = [
    ("ed25519", 256),
    *(("ecdsa", bits) for bits in (256, 384, 521)),
    *(("rsa", bits) for bits in (1024, 1040, 3072)),
]


@pytest.mark.parametrize(("kind", "bits"), KEYS)
def test_keys_that_ssh_keygen_makes(tmp_path, kind, bits):
    """A whole one is taken, with any comment; one that was cut off is not (RSA's: three of four)."""
    comment = "it's (mine): a+b \u00fc"
    argv = ["ssh-keygen", "-q", "-t", kind, "-b", str(bits), "-N", "", "-C", comment, "-f", tmp_path / "key"]
    subprocess.run(argv, check=True)
    key = (tmp_path / "key.pub").read_text().strip()
    assert key.endswith(f" {comment}")
    whole = " ".join(key.split()[:2])
    profile, _ = load_profile(str(changed(tmp_path, ("ssh/authorized_keys", [key, whole]))))
    assert profile.ssh.authorized_keys == (key, whole)
    for cut in (1, 2, 3):
        cut_off = whole[:-cut]
        with pytest.raises(UsageError, match=r"ssh\.authorized_keys\.0: not a public key"):
            load_profile(str(changed(tmp_path, ("ssh/authorized_keys", [cut_off]))))


@pytest.mark.parametrize("file", ["/proc/mine.yml", f"{'x' * 256}.yml"])
def test_a_profile_that_cannot_be_written(file, capsys):
    assert main(["new-profile", file]) == 3
    assert capsys.readouterr().err.startswith(f"rtgen: {file}: ")


def test_list_derive_and_show(tmp_path, capsys):
    assert main(["profiles"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert len(out) == len(profile_names())
    assert [line.split()[0] for line in out if "(default)" in line] == [DEFAULT_PROFILE]

    mine = tmp_path / "mine.yml"
    assert main(["new-profile", str(mine), "--from", "kirkstone-noetic"]) == 0
    assert load_profile(str(mine))[0] == load_profile("kirkstone-noetic")[0]
    assert main(["new-profile", str(mine)]) == 2
    (tmp_path / "link.yml").symlink_to("nowhere")
    assert main(["new-profile", str(tmp_path / "link.yml")]) == 2
    assert main(["new-profile", str(tmp_path / "mine.yaml")]) == 2
    capsys.readouterr()

    assert main(["explain", str(mine)]) == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert shown["release"] == "kirkstone"
    assert shown["layers"][0] == "openembedded-core/meta"
    assert shown["fragments"]["pandaboard-es"] == "kconfig/fragments/pandaboard-es-5.15.cfg"
    assert "meta-rt-tests/conf/layer.conf" in shown["files"]
