"""What commands print for programs: one JSON object, with a schema, and nothing else on standard output."""

import contextlib
import json

from rtgen.cli import main
from rtgen.kconfig.data import load
from rtgen.kconfig.fragment import kernel_of
from rtgen.kconfig.render import config_line
from rtgen.profile import profile_names


def printed(capsys, *words, status=0):
    assert main([*words, "--json"]) == status
    data = json.loads(capsys.readouterr().out)
    assert isinstance(data, dict) and data.pop("schema") == 1
    return data


def test_profiles_and_machines(capsys):
    data = printed(capsys, "profiles")
    assert [profile["profile"] for profile in data["profiles"]] == list(profile_names())
    assert data["default"] in profile_names() and all(profile["summary"] for profile in data["profiles"])
    machines = printed(capsys, "board", "machines")["machines"]
    assert main(["board", "machines"]) == 0
    assert [machine["machine"] for machine in machines] == [
        line.split()[0] for line in capsys.readouterr().out.splitlines()
    ]
    assert sum(machine["is_default"] for machine in machines) == 1


def test_the_doctor_names_findings_and_the_status_stays(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    data = printed(capsys, "doctor", str(tmp_path), status=1)
    assert data["can_build"] is False
    assert data["findings"][0]["fatal"] and "not installed" in data["findings"][0]["what"]


def test_options_that_do_not_hold(capsys, tmp_path):
    wanted = load().wanted("qemu-armv7", kernel_of("# Linux/arm 6.1.0 Kernel Configuration\n"))
    path = tmp_path / "config"
    lines = ["# Linux/arm 6.1.0 Kernel Configuration", *(config_line(*pair) for pair in wanted.items()), ""]
    path.write_text("\n".join(lines))
    words = ("kconfig", "verify", "--machine", "qemu-armv7", "--config", str(path))
    (subject,) = printed(capsys, *words)["subjects"]
    assert (subject["checked"], subject["do_not_hold"]) == (len(wanted), [])
    path.write_text(path.read_text().replace("CONFIG_PREEMPT_RT=y\n", ""))
    (subject,) = printed(capsys, *words, status=1)["subjects"]
    ((option,),) = (subject["do_not_hold"],)
    assert (option["symbol"], option["want"], option["got"]) == ("PREEMPT_RT", "y", "n")


def test_what_is_built_is_one_object_whatever_a_build_prints(capsys, tmp_path, monkeypatch):
    (tmp_path / "build.json").write_text('{"not_built": {"nodes": ["dlib"]}}')

    def build(*_, **__):
        print("a line of a tool")
        return tmp_path

    monkeypatch.setattr("rtgen.suites.build", build)
    data = printed(capsys, "suites", "build")
    assert data == {"machine": "host", "folder": str(tmp_path), "not_built": {"nodes": ["dlib"]}}
    monkeypatch.setattr("rtgen.board.build.build", build)
    assert printed(capsys, "board", "build", "--machine", "qemu-arm64") == {
        "machine": "qemu-arm64",
        "folder": str(tmp_path),
    }


def test_a_target_that_builds_suites_has_a_json_of_its_own(capsys):
    assert main(["suites", "build", "--on", "board.yml", "--json"]) == 2
    assert "--json goes without --on" in capsys.readouterr().err


def test_every_command_that_prints_an_answer_has_json(capsys):
    lacks = []
    for words in (
        ("profiles",),
        ("explain",),
        ("new-profile",),
        ("render",),
        ("doctor",),
        ("flash",),
        ("kernel", "build"),
        ("kconfig", "render"),
        ("kconfig", "verify"),
        ("board", "build"),
        ("board", "machines"),
        ("suites", "build"),
    ):
        with contextlib.suppress(SystemExit):
            main([*words, "--help"])
        if "--json" not in capsys.readouterr().out:
            lacks.append(words)
    assert not lacks


def test_a_profile_explained_and_copied(capsys, tmp_path):
    explained = printed(capsys, "explain", "scarthgap-noetic")
    assert explained["release"] == "scarthgap" and "kas.yml" in explained["files"]
    copy = tmp_path / "mine.yml"
    assert printed(capsys, "new-profile", str(copy)) == {"file": str(copy), "from": "scarthgap-noetic"}


def test_a_rendering(capsys, tmp_path):
    words = ("render", "--output", str(tmp_path))
    done = printed(capsys, *words)
    assert done["written"] == done["files"] and done["removed"] == []
    assert printed(capsys, *words, "--check")["difference"] == ""
    (tmp_path / "kas.yml").write_text((tmp_path / "kas.yml").read_text() + "more: 1\n")
    assert "-more: 1\n" in printed(capsys, *words, "--check", status=1)["difference"]


def test_fragments(capsys):
    rendered = printed(capsys, "kconfig", "render", "--check", "--machine", "qemu-armv7")
    assert rendered["difference"] == "" and {fragment["state"] for fragment in rendered["fragments"]} == {"unchanged"}


def test_a_card_is_asked_about_or_described(capsys):
    assert main(["flash", "--image", "card.img", "--device", "/dev/null", "--json"]) == 2
    assert "--json goes with --yes" in capsys.readouterr().err
