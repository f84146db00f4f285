"""kas.yml: valid by kas' own schema, and read by the real kas."""

import json
import os
import subprocess
import sys
from importlib import resources
from pathlib import Path, PurePosixPath

import jsonschema
import pytest
import yaml

from rtgen.checkout import checkout
from rtgen.layer import output
from rtgen.layer.render import render
from rtgen.profile import load_profile, profile_names

KAS = Path(sys.executable).with_name("kas")


def rendered(tmp_path, name):
    output.write(render(name, *load_profile(name)), tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", profile_names())
def test_schema(tmp_path, name):
    schema = json.loads(resources.files("kas").joinpath("schema-kas.json").read_text())
    files = [tmp_path / "kas.yml", *sorted((rendered(tmp_path, name) / "meta-rt-tests/kas").glob("*.yml"))]
    assert len(files) >= 4
    for file in files:
        jsonschema.validate(yaml.safe_load(file.read_text()), schema)


@pytest.mark.parametrize("name", profile_names())
def test_every_repository_is_pinned(tmp_path, name):
    profile, _ = load_profile(name)
    repositories = yaml.safe_load((rendered(tmp_path, name) / "kas.yml").read_text())["repos"]
    for machine in profile.machines:
        data = yaml.safe_load((tmp_path / f"meta-rt-tests/kas/{machine}.yml").read_text())
        repositories |= data.get("repos", {})
    assert set(repositories) == {"meta-rt-tests", *profile.repositories}
    for repository, pinned in profile.repositories.items():
        assert repositories[repository]["commit"] == pinned.commit
        assert repositories[repository]["url"] == pinned.url


def test_what_yaml_would_take_for_something_else(tmp_path):
    profile, release = load_profile("scarthgap-noetic")
    bitbake = profile.repositories["bitbake"].model_copy(update={"commit": "1" * 40, "branch": "null"})
    repositories = {**profile.repositories, "bitbake": bitbake, "1.5": bitbake.model_copy(update={"layers": ("on",)})}
    image = profile.image.model_copy(update={"name": "true"})
    profile = profile.model_copy(update={"distro": "null", "image": image, "repositories": repositories})
    tree = render("mine", profile, release, prefix=f"my: own #2/{'long ' * 30}/")
    read = yaml.safe_load(tree[PurePosixPath("kas.yml")])
    assert (read["distro"], read["target"]) == ("null", "true")
    assert (read["repos"]["bitbake"]["commit"], read["repos"]["bitbake"]["branch"]) == ("1" * 40, "null")
    assert read["repos"]["1.5"]["layers"] == {"on": None}
    assert read["repos"]["meta-rt-tests"]["layers"] == {f"my: own #2/{'long ' * 30}/meta-rt-tests": None}


@pytest.mark.parametrize("name", profile_names())
def test_what_is_left_out_has_a_key_of_its_own_that_brings_it_back(tmp_path, name):
    """Kas takes the last text of a key: an empty one brings back what the key names, as testimage.yml does QEMU."""
    _, release = load_profile(name)
    header = yaml.safe_load((rendered(tmp_path, name) / "kas.yml").read_text())["local_conf_header"]
    lines = {key.removeprefix("rt-tests-without-"): text for key, text in header.items() if "-without-" in key}
    assert lines == {
        what: "".join(f'{variable} = "{value}"\n' for variable, value in settings.items())
        for what, settings in release.left_out.items()
    }
    assert ("qemu" in lines) == release.modern
    readme = (tmp_path / "meta-rt-tests/README.md").read_text()
    assert all(f"rt-tests-without-{what}: `{text.splitlines()[0]}`" in readme for what, text in lines.items())
    if release.modern:
        testimage = yaml.safe_load((tmp_path / "meta-rt-tests/kas/testimage.yml").read_text())
        assert testimage["local_conf_header"]["rt-tests-without-qemu"] == ""


def test_what_is_left_out_is_in_the_docs():
    """With what brings it back."""
    text = (checkout() / "docs/layer.md").read_text()
    for name in profile_names():
        _, release = load_profile(name)
        assert [what for what in release.left_out if f"| `{what}` |" not in text] == []


def test_settings_of_a_machine_that_is_not_ours():
    """They are the machine's, first or not, with a card on the other or not; joined, kas takes them once."""
    profile, release = load_profile("scarthgap-noetic")
    qemu = profile.machines["qemuarm"].model_copy(update={"boot_arguments": ("quiet", "nohz=off")})
    panda = profile.machines["pandaboard-es"].model_copy(update={"sd_card": None})
    profile = profile.model_copy(update={"machines": {"qemuarm": qemu, "pandaboard-es": panda}})
    tree = render("mine", profile, release)
    files = ("kas.yml", "meta-rt-tests/kas/qemuarm.yml", "meta-rt-tests/kas/pandaboard-es.yml")
    headers = [yaml.safe_load(tree[PurePosixPath(file)]).get("local_conf_header", {}) for file in files]
    settings = [header.get("rt-tests-qemuarm") for header in headers]
    assert settings[0] == settings[1] and settings[2] is None
    assert settings[0].splitlines() == [
        'PREFERRED_PROVIDER_virtual/kernel:qemuarm = "linux-yocto-rt"',
        'PREFERRED_VERSION_linux-yocto-rt:qemuarm = "6.6%"',
        'MACHINE_FEATURES:append:qemuarm = " preempt-rt"',
        'SERIAL_CONSOLES:qemuarm = "115200;ttyAMA0"',
        'QB_KERNEL_CMDLINE_APPEND:append:qemuarm = " quiet nohz=off"',
    ]
    assert headers[2]["rt-tests-pandaboard-es"].splitlines() == [
        'PREFERRED_PROVIDER_virtual/kernel:pandaboard-es = "linux-yocto-rt"',
        'PREFERRED_VERSION_linux-yocto-rt:pandaboard-es = "6.6%"',
    ]


@pytest.fixture
def project(tmp_path, monkeypatch):
    """The default rendering, its repositories replaced by local ones: commits differ, everything else is as it is."""
    project = rendered(tmp_path / "project", "scarthgap-noetic")
    for key in ("KAS_REPO_REF_DIR", "KAS_WORK_DIR", "GIT_DIR", "GIT_WORK_TREE"):
        monkeypatch.delenv(key, raising=False)
    git(project, "init", "-q", "-b", "main")
    git(project, "add", ".")
    git(project, "commit", "-q", "-m", "render")
    override = {"header": {"version": 14}, "repos": {}}
    for name, repository in load_profile("scarthgap-noetic")[0].repositories.items():
        source = tmp_path / "upstream" / name
        (source / "meta").mkdir(parents=True)
        (source / "README").write_text(name)
        git(source, "init", "-q", "-b", "main")
        git(source, "add", ".")
        git(source, "commit", "-q", "-m", "first")
        commit = git(source, "rev-parse", "HEAD").strip()
        override["repos"][name] = {"url": str(source), "branch": "main", "commit": commit}
        assert repository.commit != commit
    (project / "local.yml").write_text(yaml.safe_dump(override))
    return project


def git(folder, *arguments):
    identity = ["-c", "user.name=t", "-c", "user.email=t@localhost"]
    done = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout


def kas(project, *arguments):
    environment = {**os.environ, "KAS_WORK_DIR": str(project.parent / "work"), "LC_ALL": "C.UTF-8"}
    (project.parent / "work").mkdir(exist_ok=True)
    done = subprocess.run([KAS, *arguments], cwd=project, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize(
    ("joined", "machine"),
    [
        ("kas.yml", "pandaboard-es"),
        ("kas.yml:meta-rt-tests/kas/qemuarm.yml", "qemuarm"),
        ("kas.yml:meta-rt-tests/kas/qemuarm.yml:meta-rt-tests/kas/dropbear.yml", "qemuarm"),
        ("kas.yml:meta-rt-tests/kas/raspberrypi5.yml", "raspberrypi5"),
        ("kas.yml:meta-rt-tests/kas/pandaboard-es.yml:meta-rt-tests/kas/rm-work.yml", "pandaboard-es"),
    ],
)
def test_dump_joins_the_fragments(project, joined, machine):
    dumped = yaml.safe_load(kas(project, "dump", f"{joined}:local.yml").stdout)
    assert dumped["machine"] == machine
    assert dumped["target"] == "rt-tests-image"
    header = "\n".join(dumped["local_conf_header"].values())
    kernel = "linux-raspberrypi" if machine == "raspberrypi5" else "linux-yocto-rt"
    assert f'PREFERRED_PROVIDER_virtual/kernel:{machine} = "{kernel}"' in header
    assert ("layers" in dumped["repos"]["meta-raspberrypi"]) == (machine == "raspberrypi5")
    assert ('MACHINE_FEATURES:append:qemuarm = " preempt-rt"' in header) == (machine == "qemuarm")
    assert ('RT_TESTS_SSH_SERVER = "dropbear"' in header) == ("dropbear" in joined)
    assert ('INHERIT += "rm_work"' in header) == ("rm-work" in joined)


@pytest.mark.parametrize("joined", ["kas.yml", "kas.yml:meta-rt-tests/kas/raspberrypi5.yml"])
def test_lock_finds_nothing_to_pin(project, joined):
    done = kas(project, "lock", f"{joined}:local.yml")
    assert "WARNING" not in done.stderr, done.stderr
    assert "No floating repos found" in done.stderr
    assert not (project / "kas.lock.yml").exists()


def test_a_lock_file_of_a_user_wins(project):
    """kas takes one that lies beside kas.yml, even against a commit in a file that is joined."""
    source = project.parent / "upstream" / "meta-ros"
    git(source, "commit", "-q", "--allow-empty", "-m", "second")
    newer = git(source, "rev-parse", "HEAD").strip()
    lock = {"header": {"version": 14}, "overrides": {"repos": {"meta-ros": {"commit": newer}}}}
    (project / "kas.lock.yml").write_text(yaml.safe_dump(lock))
    kas(project, "dump", "kas.yml:local.yml")
    assert git(project.parent / "work" / "meta-ros", "rev-parse", "HEAD").strip() == newer
