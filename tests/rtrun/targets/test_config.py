"""Target files: what is refused, and in which words."""

import shutil
from pathlib import Path

import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.targets.config import connect, read_target
from rtrun.targets.inspection.facts import Equipment, check_suites

SSH = "schema: 1\nname: board\nkind: ssh\nhost: 127.0.0.1\n"


def read(folder: Path, text: str):
    path = folder / "target.yml"
    path.write_text(text)
    return read_target(path)


@pytest.mark.parametrize("kind", ["[ssh]", "{ssh: 1}", "", "serial", "1"])
def test_a_kind_that_is_none(tmp_path, kind):
    with pytest.raises(UsageError, match=r"target.yml:3: kind: (is missing|unknown kind .*), allowed: ssh, qemu"):
        read(tmp_path, SSH.replace("kind: ssh", f"kind: {kind}"))


@pytest.mark.parametrize("host", ["a..b", ".a", "x" * 64, '""', "a b", "a/b", '"a\\u0000b"'])
def test_a_host_that_none_can_be(tmp_path, host):
    with pytest.raises(UsageError, match="host: expected the name or the address of a host"):
        read(tmp_path, SSH.replace("127.0.0.1", host))


@pytest.mark.parametrize("host", ["board", "board.local", "10.0.0.1", "fe80::1%eth0", "rt_board-1.", "bücher.example"])
def test_hosts(tmp_path, host):
    assert read(tmp_path, SSH.replace("127.0.0.1", host)).host == host


@pytest.mark.parametrize("folder", ["/tmp/../../etc", "/tmp/..", "/tmp/./x", "/tmp//x", "//"])
def test_a_work_dir_that_leads_elsewhere(tmp_path, folder):
    with pytest.raises(UsageError, match="work_dir: "):
        read(tmp_path, SSH + f"work_dir: {folder}\n")


def test_a_work_dir(tmp_path):
    assert read(tmp_path, SSH + "work_dir: /var/lib/.x/rt.tests\n").work_dir == "/var/lib/.x/rt.tests"


def test_a_folder_that_is_none_of_suites(tmp_path):
    config = read(tmp_path, SSH + "suites: there\n")
    there = tmp_path / "there"
    # Only where suites are used they are asked for: an observation has none.
    with connect(config, tmp_path, tmp_path / "log") as target:
        assert target.suites == there
    equipment = Equipment(
        middlewares={}, programs={}, built_with={}, cpus=1, free_bytes=0, architecture=None, debian=None
    )
    with pytest.raises(UsageError, match="there: no such folder"):
        check_suites(there, target, equipment)
    (there / "lib").mkdir(parents=True)
    with pytest.raises(UsageError, match=r"there: has no build\.json"):
        check_suites(there, target, equipment)
    (there / "build.json").write_text("{}")
    check_suites(there, target, equipment)


@pytest.mark.parametrize(
    ("text", "name", "login"),
    [
        ("board", "board", ("board", None, None)),
        ("board:2222", "board-2222", ("board", 2222, None)),
        ("root@10.0.0.7:22", "10.0.0.7-22", ("10.0.0.7", 22, "root")),
        ("me@there@bücher.example", "b-cher.example", ("bücher.example", None, "me@there")),
        ("[fe80::1]:22", "fe80-1-22", ("fe80::1", 22, None)),
        ("root@fe80::1%eth0", "fe80-1-eth0", ("fe80::1%eth0", None, "root")),
        ("::1", "1", ("::1", None, None)),
    ],
)
def test_a_login_instead_of_a_file(tmp_path, monkeypatch, text, name, login):
    monkeypatch.chdir(tmp_path)
    config = read_target(Path(text))
    assert (config.name, (config.host, config.port, config.user)) == (name, login)


@pytest.mark.parametrize(
    "text",
    [
        "root@", "@board", "board:", "board:0", "board:65536", "board:22:22", "[::1", "[board]:22", "a b:22", "a b",
        "board:22x", "x..y", "root@\x1b[2J:22", "[::1]:", "board:٢٢",
    ],
)  # fmt: skip
def test_a_login_that_is_none(tmp_path, monkeypatch, capsys, text):
    monkeypatch.chdir(tmp_path)
    assert main(["probe", "--target", text]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "\x1b" not in error and text.replace("\x1b", "?") in error


@pytest.mark.parametrize("text", ["missing.yml", "missing.yaml", "folder/missing"])
def test_what_names_a_file_is_no_login(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="No such file"):
        read_target(Path(text))
    Path("board").write_text(SSH)
    assert read_target(Path("board")).host == "127.0.0.1", "a file of that name comes first"


@pytest.mark.sshd
def test_a_login_is_enough_to_ask_a_board(sshd, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    Path(".ssh").mkdir()
    Path(".ssh/known_hosts").write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    shutil.copy(sshd.key, ".ssh/id_ed25519")
    login = f"{sshd.user}@127.0.0.1:{sshd.port}"
    assert main(["check-rt", "--target", login]) in (0, 1), capsys.readouterr().err
    assert capsys.readouterr().out.startswith(f"127.0.0.1-{sshd.port} ({login}): ")


def probe(sshd, folder: Path, *more: str) -> int:
    known = folder / "known_hosts"
    known.write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    lines = [f"port: {sshd.port}", f"user: {sshd.user}", f"key: {sshd.key}", "known_hosts: known_hosts"]
    (folder / "target.yml").write_text(SSH + "\n".join([*lines, f"work_dir: {folder}/work", *more]) + "\n")
    return main(["probe", "--target", str(folder / "target.yml")])


@pytest.mark.sshd
def test_probe(sshd, tmp_path, capsys):
    assert probe(sshd, tmp_path) == 0
    lines = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines())
    assert lines["target"].split() == ["board", f"({sshd.user}@127.0.0.1:{sshd.port})"]
    assert lines["kernel"].split()[0] == Path("/proc/sys/kernel/osrelease").read_text().strip()


@pytest.mark.sshd
def test_suites_of_another_architecture(sshd, tmp_path, capsys):
    program = tmp_path / "suites" / "lib" / "cyclic_timer_tests" / "cyclic_timer_tests"
    program.parent.mkdir(parents=True)
    (tmp_path / "suites" / "build.json").write_text("{}")
    shutil.copy(Path("/bin/sh").resolve(), program)
    assert probe(sshd, tmp_path, "suites: suites") == 0
    header = bytearray(program.read_bytes())
    header[18:20] = (243).to_bytes(2, "little")
    program.write_bytes(header)
    capsys.readouterr()
    assert probe(sshd, tmp_path, "suites: suites") == UsageError.exit_status
    (line,) = capsys.readouterr().err.splitlines()
    assert f"suites for 64-bit RISC-V, but {sshd.user}@127.0.0.1:{sshd.port} is 64-bit" in line


@pytest.mark.sshd
def test_probe_of_a_target_that_leaves_out_what_it_is(sshd, tmp_path, capsys, monkeypatch):
    from rtrun.targets.inspection import facts as inspection

    monkeypatch.setattr(inspection, "read_state", lambda *_: inspection.parse_state("== kernel_release\n\x1b[2J6.1\n"))
    assert probe(sshd, tmp_path) == 0
    output = capsys.readouterr().out
    assert "?[2J6.1 unknown" in output and "\x1b" not in output
