"""The layer's own shell code, run by the real BitBake: who may log in, and whether the kernel options took effect."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.bitbake

KEY = f"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAI{'Kq0x' * 11}"[:-1] + " somebody@host"
OTHER = f"ssh-rsa AAAAB3NzaC1yc2EAAAADAQABAAABgQC{'x' * 180}="
NO_KEY = "RT_TESTS_AUTHORIZED_KEYS has a line that is not a public key of the kinds ssh-ed25519, ecdsa-"


def image(make_build, keys: str, features: str = "") -> tuple[Path, object]:
    local = f'RT_TESTS_AUTHORIZED_KEYS = "{keys}"\n' + features
    build = make_build("scarthgap-noetic", "qemuarm", local=local)
    root = build.folder / "tmp/work/rt-tests-image/1.0/rootfs"
    (root / "etc/ssh").mkdir(parents=True)
    (root / "etc/ssh/sshd_config").write_text("Include /etc/ssh/sshd_config.d/*.conf\nPermitRootLogin yes\n")
    return root, build


def policy(build):
    return build.try_bitbake(functions=[["rt-tests-image", "rt_tests_ssh_policy"]])


def output_of(build, done):
    logs = build.folder.glob("tmp/work/rt-tests-image/*/temp/log.*")
    return done.stdout + done.stderr + "".join(log.read_text() for log in logs)


def test_keys_and_no_password(make_build):
    root, build = image(make_build, f"{KEY}\\n{OTHER}\\n")
    done = policy(build)
    assert done.returncode == 0, done.stderr
    keys = root / "home/root/.ssh/authorized_keys"
    assert keys.read_text() == f"{KEY}\n{OTHER}\n"
    assert keys.stat().st_mode & 0o777 == 0o600
    assert keys.parent.stat().st_mode & 0o777 == 0o700
    config = (root / "etc/ssh/sshd_config").read_text().splitlines()
    assert config[:2] == ["PermitRootLogin without-password", "PasswordAuthentication no"]
    assert not (root / "etc/default").exists()


@pytest.mark.parametrize("program", [None, "/usr/sbin/dropbearmulti"])
def test_dropbear_takes_no_password(make_build, program):
    """Its own default is -w (no root), under systemd without an init script; a link to what is on the target counts."""
    root, build = image(make_build, KEY)
    (root / "usr/sbin").mkdir(parents=True)
    dropbear = root / "usr/sbin/dropbear"
    if program:
        dropbear.symlink_to(program)
    else:
        dropbear.touch()
    assert policy(build).returncode == 0
    assert (root / "etc/default/dropbear").read_text() == 'DROPBEAR_EXTRA_ARGS="-s"\n'


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        (f"{KEY}\n{OTHER}", [KEY, OTHER]),
        (f"# laptop\r\n \t{KEY} \r\n\r\n#{KEY}\r\n{OTHER}\r\n", [KEY, OTHER]),
        (f'{KEY} it\'s (a) + b: `c` "d" \\new <e>\n{OTHER}', [f'{KEY} it\'s (a) + b: `c` "d" \\new <e>', OTHER]),
        (f"\\n{KEY}\\n\\n {OTHER}\\n", [KEY, OTHER]),
    ],
)
def test_keys_come_from_the_environment(make_build, monkeypatch, given, kept):
    monkeypatch.setenv("RT_TESTS_AUTHORIZED_KEYS", given)
    monkeypatch.setenv("BB_ENV_PASSTHROUGH_ADDITIONS", "RT_TESTS_AUTHORIZED_KEYS")
    build = make_build("scarthgap-noetic", "qemuarm")
    done = policy(build)
    assert done.returncode == 0, done.stderr
    keys = build.folder / "tmp/work/rt-tests-image/1.0/rootfs/home/root/.ssh/authorized_keys"
    assert keys.read_text().splitlines() == kept


@pytest.mark.parametrize(("keys", "message"), [(OTHER, ""), (KEY, "not a public key of the kinds ssh-rsa, or not")])
def test_servers_of_2014_know_rsa_only(make_build, keys, message):
    build = make_build("thesis-2014", "pandaboard", f'RT_TESTS_AUTHORIZED_KEYS = "{keys}"\n', separator=":")
    done = policy(build)
    assert (done.returncode == 0) == (not message)
    assert message in output_of(build, done)


@pytest.mark.parametrize(
    ("keys", "features", "message"),
    [
        ("", "", "no key could log in: put one of the kinds ssh-ed25519, ecdsa-"),
        ("", "", "(without kas: if BB_ENV_PASSTHROUGH_ADDITIONS names it)"),
        ("-----BEGIN OPENSSH PRIVATE KEY-----", "", NO_KEY),
        ("ssh-ed25519 AAAA; rm -rf $(HOME)", "", NO_KEY),
        (f"{KEY}\\nssh-ed25519 x", "", NO_KEY),
        (KEY.replace(" somebody", "x somebody"), "", NO_KEY),
        (OTHER[:-2], "", NO_KEY),
        (f"{KEY}\\nsk-ssh-ed25519@openssh.com AAAA", "", NO_KEY),
        (
            KEY,
            'IMAGE_FEATURES += "read-only-rootfs"\n',
            "new SSH host keys at every boot: take it out, or add overlayfs",
        ),
        (KEY, 'IMAGE_FEATURES += "read-only-rootfs overlayfs-etc stateless-rootfs"\n', "new SSH host keys"),
    ],
)
def test_an_image_nobody_should_have_is_not_built(make_build, keys, features, message):
    _, build = image(make_build, keys, features)
    done = policy(build)
    assert done.returncode != 0
    assert message in output_of(build, done)


@pytest.mark.parametrize("features", ["read-only-rootfs overlayfs-etc", "overlayfs-etc", "stateless-rootfs"])
def test_an_image_that_keeps_its_host_keys_is_built(make_build, features):
    _, build = image(make_build, KEY, f'IMAGE_FEATURES += "{features}"\n')
    done = policy(build)
    assert done.returncode == 0, output_of(build, done)


def test_command_line_of_2014_reaches_the_kernel(make_build):
    """meta-ti's defconfig leaves it to the boot loader; Kconfig takes the last line."""
    build = make_build("thesis-2014", "pandaboard", separator=":")
    folder = build.folder / "tmp/work/linux-omap4/3.4"
    folder.mkdir(parents=True)
    (folder / "defconfig").write_text("# CONFIG_CMDLINE_EXTEND is not set\nCONFIG_CMDLINE_FROM_BOOTLOADER=y\n")
    (folder / "rt-tests-pandaboard.cfg").write_text("CONFIG_HZ=1000\n")
    done = build.try_bitbake(tasks=[["linux-omap4", "do_configure"]])
    assert done.returncode == 0, done.stderr
    last = {re.sub(r"# | is not set|=.*", "", line): line for line in (folder / "defconfig").read_text().splitlines()}
    assert last["CONFIG_CMDLINE_EXTEND"] == "CONFIG_CMDLINE_EXTEND=y"
    assert last["CONFIG_CMDLINE_FROM_BOOTLOADER"] == "# CONFIG_CMDLINE_FROM_BOOTLOADER is not set"
    assert last["CONFIG_HZ"] == "CONFIG_HZ=1000"


def kernel(make_build, config: str):
    build = make_build("scarthgap-noetic", "pandaboard-es")
    fragment = build.layer / "recipes-kernel/linux/files/rt-tests-pandaboard-es.cfg"
    fragment.write_text("# a comment\nCONFIG_PREEMPT_RT=y\nCONFIG_HZ=250\n\n# CONFIG_CPU_IDLE is not set\n")
    folder = build.folder / "tmp/work/linux-yocto-rt/6.6"
    (folder / "build").mkdir(parents=True)
    (folder / "build/.config").write_text(config)
    (folder / "rt-tests-pandaboard-es.cfg").write_text(fragment.read_text())
    return build.try_bitbake(tasks=[["linux-yocto-rt", "do_rt_tests_config_check"]])


@pytest.mark.parametrize(
    "config",
    [
        "CONFIG_PREEMPT_RT=y\nCONFIG_HZ=250\n# CONFIG_CPU_IDLE is not set\n",
        "CONFIG_HZ=250\nCONFIG_PREEMPT_RT=y\n",  # an option that does not exist is off
    ],
)
def test_options_that_took_effect(make_build, config):
    done = kernel(make_build, config)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("config", "missing"),
    [
        ("CONFIG_HZ=250\n", "[CONFIG_PREEMPT_RT=y]"),
        ("# CONFIG_PREEMPT_RT is not set\nCONFIG_HZ=2500\n", "[CONFIG_PREEMPT_RT=y] [CONFIG_HZ=250]"),
        ("CONFIG_PREEMPT_RT=y\nCONFIG_HZ=250\nCONFIG_CPU_IDLE=y\n", "[# CONFIG_CPU_IDLE is not set]"),
    ],
)
def test_an_option_that_was_dropped_fails_the_build(make_build, config, missing):
    done = kernel(make_build, config)
    assert done.returncode != 0
    assert f"not in the final .config: {missing}" in done.stderr
