"""A profile against the real layers: what only openembedded-core, meta-openembedded and meta-ros can say.

Not part of `make test`: `make test-yocto LAYERS=DIR` runs it, DIR holding checkouts of a profile's repositories at the
profile's commits, each in a folder of the repository's name. Which profile it is, the commits say. A first run parses
every recipe (minutes), later ones take it from DIR/build. dora needs Python 2.7: python2.7 in the PATH, or its path in
RT_TESTS_PYTHON2. RT_TESTS_CHECK_LAYER=1 adds yocto-check-layer (forty minutes on two cores).
"""

import hashlib
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

import rtgen.suites
from rtfiles.config import read_yaml
from rtgen import debian
from rtgen.board import sysroot
from rtgen.checkout import checkout
from rtgen.layer import output
from rtgen.layer.render import render, suite_recipes
from rtgen.profile import Profile, Release, load_machines, load_profile, profile_names

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(7200)]

KEY = "ssh-ed25519 AAAA"
# What is said of recipes that are masked.
MISSING = ("Nothing PROVIDES", "No bb files in default matched")
# What is said of layers that are not ours, of the missing network, and of one recipe run alone.
FOREIGN = ("omap3-sgx-modules", "uninative", "Buildfile specified")
# Debian's cross compiler, build tools and ROS in the place of those that Yocto would build first.
TOOLS = "cmake ninja g++ " + " ".join(
    f"arm-linux-gnueabihf-{tool}"
    for tool in (
        *("gcc", "g++", "cpp", "as", "ld", "ar", "nm", "ranlib", "strip", "objcopy", "objdump"),
        *("gcc-ar", "gcc-nm", "gcc-ranlib"),
    )
)
DEBIAN = """
HOSTTOOLS += "{tools}"
TARGET_PREFIX:forcevariable = "arm-linux-gnueabihf-"
PYTHON:forcevariable = "{python}"
RECIPE_SYSROOT:forcevariable = "{sysroot}"
# Has options that came after Debian's compiler.
DEBUG_PREFIX_MAP:forcevariable = ""
# Debian's ROS has a ROS_DISTRO of its own, and its genmsg looks for files under CMake's root paths only.
ROS_DISTRO[unexport] = "1"
OECMAKE_EXTRA_ROOT_PATH = "/"
export ROS_LANG_DISABLE = "{languages}"
"""


@dataclass(frozen=True)
class Yocto:
    """A profile's checkouts and a build folder beside them."""

    top: Path
    name: str
    profile: Profile
    release: Release

    @property
    def build(self) -> Path:
        return self.top / "build"

    @property
    def layer(self) -> Path:
        return self.top / "rendered" / "meta-rt-tests"

    @property
    def machine(self) -> str:
        return os.environ.get("RT_TESTS_MACHINE", self.profile.default_machine)

    def kas(self, machine: str) -> tuple[list[Path], list[str]]:
        """The layers of others, and the lines for local.conf, that kas would take for a machine."""
        files = [self.layer.parent / "kas.yml", self.layer / "kas" / f"{machine}.yml"]
        read = [yaml.safe_load(file.read_text()) for file in files]
        repositories = {name: found["layers"] for data in read for name, found in data.get("repos", {}).items()}
        layers = [
            self.top / name / layer
            for name, layers in repositories.items()
            for layer, state in layers.items()
            if name != "meta-rt-tests" and state != "disabled"
        ]
        headers = [header for data in read for header in data.get("local_conf_header", {}).values()]
        return layers, [line for header in headers for line in header.splitlines()]

    def run(self, *command: str, build: Path | None = None, masked: bool = False) -> str:
        """Run a command in the build environment; what it said. Neither errors nor warnings of ours may be in it.

        `masked`: most recipes are, so that it is no error if they are missing.
        """
        core = self.top / ("openembedded-core" if (self.top / "openembedded-core").is_dir() else "poky")
        environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LC_ALL": "en_US.UTF-8", "HOME": str(Path.home())}
        if (self.top / "bitbake").is_dir():
            environment["BITBAKEDIR"] = str(self.top / "bitbake")
        else:
            environment["PATH"] = f"{self._python2()}:{environment['PATH']}"
        script = 'build=$1; shift; set -- "$build" -- "$@"; b=$1; shift 2; run=("$@"); set -- "$b"; '
        script += '. ./oe-init-build-env "$b" >/dev/null && exec "${run[@]}"'
        done = subprocess.run(
            ["bash", "-c", script, "bash", str(build or self.build), *command],
            cwd=core, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0 or masked, done.stdout[-4000:]
        lines = [
            line for line in done.stdout.splitlines() if re.match(r"(Parsing recipes\.\.\.)?(WARNING|ERROR): ", line)
        ]
        foreign = (*FOREIGN, *(MISSING if masked else ()))
        assert [line for line in lines if not any(name in line for name in foreign)] == []
        return done.stdout

    def variables(
        self, recipe: str, *, names: tuple[str, ...], build: Path | None = None, masked: bool = False
    ) -> dict[str, str]:
        """Variables of a recipe, expanded, as `bitbake -e` gives them."""
        output = self.run("bitbake", "-e", recipe, build=build, masked=masked)
        values = {}
        for name in names:
            match = re.search(rf'^(?:export )?{re.escape(name)}="((?:[^"\\]|\\.)*)"$', output, re.MULTILINE)
            # kirkstone shows what it runs in the root file system as a function.
            match = match or re.search(rf"^{re.escape(name)}\(\) {{\n(.*)$", output, re.MULTILINE)
            values[name] = re.sub(r"\\\n", " ", match[1]) if match else ""
        return values

    def _python2(self) -> Path:
        python = os.environ.get("RT_TESTS_PYTHON2") or shutil.which("python2.7")
        assert python, "BitBake 1.20 needs Python 2.7: give its path in RT_TESTS_PYTHON2"
        folder = self.top / "python2"
        folder.mkdir(exist_ok=True)
        for name in ("python", "python2", "python2.7"):
            if not (folder / name).exists():
                (folder / name).symlink_to(python)
        return folder


@pytest.fixture(scope="session")
def yocto():
    given = os.environ.get("RT_TESTS_LAYERS")
    assert given, "give the checkouts: make test-yocto LAYERS=DIR"
    top = Path(given).resolve()
    seen = []
    for name in profile_names():
        profile, release = load_profile(name)
        commits = {repository: _head(top / repository) for repository in profile.repositories}
        wrong = {key: commit for key, commit in commits.items() if commit != profile.repositories[key].commit}
        if not wrong:
            break
        pinned = {key: profile.repositories[key].commit for key in wrong}
        seen.append(f"{name}: {', '.join(f'{key} is at {wrong[key]}, not at {pinned[key]}' for key in wrong)}")
    else:
        pytest.fail(f"{top} holds no profile's checkouts:\n" + "\n".join(seen))
    output.write(render(name, profile, release), top / "rendered")
    yocto = Yocto(top, name, profile, release)
    _configure(yocto, yocto.build, yocto.machine)
    print(f"\nprofile {name}, machine {yocto.machine}: {top}")
    return yocto


def _head(folder: Path) -> str:
    done = subprocess.run(["git", "-C", folder, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "no checkout"


def _configure(yocto: Yocto, build: Path, machine: str, mask: str = "") -> None:
    old = not yocto.release.modern
    layers, settings = yocto.kas(machine)
    local = [*_local(yocto, machine), *settings]
    _write_configuration(build, old, [*layers, yocto.layer], [*local, f'BBMASK = "{mask}"'] if mask else local)


def _local(yocto: Yocto, machine: str) -> list[str]:
    old = not yocto.release.modern
    local = [
        f'MACHINE ?= "{machine}"',
        f'DISTRO ?= "{yocto.profile.distro}"',
        'BB_NO_NETWORK = "1"',
        f'RT_TESTS_AUTHORIZED_KEYS = "{KEY}"',
        f'CONF_VERSION = "{1 if old else 2}"',
        'BB_NUMBER_THREADS = "2"',
    ]
    if old:
        return [*local, 'PACKAGE_CLASSES = "package_ipk"']
    # BitBake may run as root here.
    return [*local, 'INHERIT:remove = "sanity"', 'BB_NUMBER_PARSE_THREADS = "2"']


def _write_configuration(build: Path, old: bool, layers: list[Path], local: list[str]) -> None:
    (build / "conf").mkdir(parents=True, exist_ok=True)
    if old:
        # BitBake as root; 1.20 has no INHERIT_remove.
        versions = ('BB_MIN_VERSION = "1.19.1"', 'SANITY_VERSION ?= "1"', 'LOCALCONF_VERSION ?= "1"',
                    'LAYER_CONF_VERSION ?= "6"', 'SITE_CONF_VERSION ?= "1"')  # fmt: skip
        _write(build / "conf" / "sanity.conf", "\n".join(versions) + "\n")
    _write(build / "conf" / "local.conf", "\n".join(local) + "\n")
    paths = "".join(f" {layer}" for layer in layers)
    _write(
        build / "conf" / "bblayers.conf",
        f'LCONF_VERSION = "{6 if old else 7}"\nBBPATH = "${{TOPDIR}}"\nBBFILES ?= ""\nBBLAYERS = "{paths} "\n',
    )


def _write(path: Path, text: str) -> None:
    """Leave a file that holds it already as it is: BitBake goes by times."""
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def test_parses_without_a_warning(yocto):
    output = yocto.run("bitbake", "-p")
    # BitBake 1.20 counts nothing when all of it comes from its cache.
    counted = re.search(r"Parsing of (\d+) .bb files complete .* (\d+) errors", output)
    cached = re.search(r"Loaded (\d+) entries from dependency cache", output)
    if counted:
        assert counted[2] == "0"
    assert int((counted or cached)[1]) > 1000
    print((counted or cached)[0])


def licence_is_as_recorded(variables: dict[str, str]) -> bool:
    """Whether LIC_FILES_CHKSUM, where a recipe has it and the file is there, is that file's."""
    file, _, checksum = variables["LIC_FILES_CHKSUM"].removeprefix("file://").partition(";md5=")
    return not Path(file).is_file() or hashlib.md5(Path(file).read_bytes()).hexdigest() == checksum


def test_recipes_resolve(yocto):
    assert licence_is_as_recorded(yocto.variables("packagegroup-rt-tests", names=("LIC_FILES_CHKSUM",)))
    for suite in suite_recipes(yocto.profile):
        recipe = suite["package"]
        variables = yocto.variables(recipe, names=("S", "SRC_URI", "LIC_FILES_CHKSUM", "FILE", "DEPENDS", "PV"))
        assert variables["FILE"].startswith(str(yocto.layer)), recipe
        assert variables["S"].endswith("/" + recipe.replace("-", "_"))
        assert "${" not in "".join(variables.values())
        assert {*suite["build"]} <= set(variables["DEPENDS"].split())
        assert licence_is_as_recorded(variables)


def test_kernel_and_image_resolve(yocto):
    kernel = yocto.profile.machines[yocto.machine].kernel
    names = ("SRC_URI", "PV", "SRCREV", "KBUILD_DEFCONFIG", "KERNEL_DEVICETREE")
    variables = yocto.variables(kernel.recipe, names=names)
    assert variables["PV"].startswith(kernel.version)
    assert f"file://rt-tests-{yocto.machine}.cfg" in variables["SRC_URI"].split()
    if kernel.rt == "branch":
        assert "preempt-rt" in variables["SRC_URI"]
    else:
        assert kernel.source.rt_patch in variables["SRC_URI"] and variables["SRCREV"] == kernel.source.commit
    if yocto.machine == "pandaboard-es":
        assert variables["KBUILD_DEFCONFIG"] == "omap2plus_defconfig"
        assert "omap4-panda-es-rt.dtb" in variables["KERNEL_DEVICETREE"]
    looked_at = ("IMAGE_INSTALL", "IMAGE_FEATURES", "ROOTFS_POSTPROCESS_COMMAND", "WKS_FULL_PATH")
    image = yocto.variables(yocto.profile.image.name, names=looked_at)
    assert {"packagegroup-rt-tests", "openssh-sftp-server", *yocto.profile.image.packages} <= set(
        image["IMAGE_INSTALL"].split()
    )
    assert f"ssh-server-{yocto.profile.ssh.server}" in image["IMAGE_FEATURES"].split()
    assert "rt_tests_ssh_policy" in image["ROOTFS_POSTPROCESS_COMMAND"]
    if yocto.machine == "pandaboard-es":
        assert Path(image["WKS_FULL_PATH"]).is_relative_to(yocto.layer)
    for open_door in ("debug-tweaks", "empty-root-password", "allow-root-login", "allow-empty-password"):
        assert open_door not in image["IMAGE_FEATURES"].split()


def test_graph_of_the_image(yocto):
    yocto.run("bitbake", "-g", yocto.profile.image.name)
    recipes = set((yocto.build / "pn-buildlist").read_text().split())
    kernel = yocto.profile.machines[yocto.machine].kernel.recipe
    suites = [suite["package"] for suite in suite_recipes(yocto.profile)]
    wanted = {re.sub("^util-linux-.*", "util-linux", package) for package in yocto.profile.image.packages}
    assert {*suites, "packagegroup-rt-tests", kernel, "openssh", *wanted} <= recipes
    if yocto.machine.startswith("pandaboard"):
        assert ("u-boot-panda" if yocto.release.own_u_boot else "u-boot") in recipes
    print(f"{len(recipes)} recipes")


def test_kernel_of_every_machine(yocto):
    """With all other recipes masked, which takes seconds a machine, on the layers that kas would take for it."""
    if not yocto.release.modern:
        pytest.skip("dora has one machine")
    build = yocto.top / "build-kernels"
    for machine, described in yocto.profile.machines.items():
        kernel, known, console = described.kernel, load_machines()[machine], described.serial_console
        _configure(yocto, build, machine, mask=rf"/(?!{kernel.recipe}_)[^/]*[.]bb(append)?$")
        names = ("SRC_URI", "PV", "MACHINE_FEATURES", "SERIAL_CONSOLES", "IMAGE_FSTYPES", *known.kernel)
        variables = yocto.variables(kernel.recipe, names=names, build=build, masked=True)
        assert f"file://rt-tests-{machine}.cfg" in variables["SRC_URI"].split(), machine
        assert variables["PV"].startswith(kernel.version), machine
        assert {key: variables[key] for key in known.kernel} == known.kernel, machine
        assert "preempt-rt" in variables["MACHINE_FEATURES"].split(), machine
        assert f"{console.baud};{console.device}" in variables["SERIAL_CONSOLES"].split(), machine
        print(f"| {machine} | {kernel.recipe} {variables['PV']} | {variables['IMAGE_FSTYPES']} |", flush=True)


def test_graph_for_other_machines(yocto):
    """The graph of the image for each other machine, without the recipes that no image needs."""
    if not yocto.release.modern:
        pytest.skip("dora has one machine")
    mask = _needless(yocto)
    build = yocto.top / "build-machines"
    suites = {suite["package"] for suite in suite_recipes(yocto.profile)}
    for machine, described in yocto.profile.machines.items():
        if machine == yocto.machine:
            continue
        _configure(yocto, build, machine, mask)
        yocto.run("bitbake", "-g", yocto.profile.image.name, build=build)
        recipes = set((build / "pn-buildlist").read_text().split())
        wanted = {*suites, "packagegroup-rt-tests", described.kernel.recipe, "openssh", "rt-tests", "stress-ng"}
        assert wanted <= recipes, machine
        print(f"| {machine} | {len(recipes)} recipes |", flush=True)


def test_suites_are_fetched_and_unpacked(yocto):
    if yocto.profile.suites:
        pytest.skip("the originals of 2014 are in a git repository, and BB_NO_NETWORK is set")
    for suite in suite_recipes(yocto.profile):
        recipe = suite["package"]
        yocto.run("bitbake", "-c", "clean", recipe)
        yocto.run("bitbake", "-c", "unpack", recipe)
        source = Path(yocto.variables(recipe, names=("S",))["S"])
        assert (source / "package.xml").is_file()
        assert (source / "CMakeLists.txt").is_file()


def test_suites_are_patched_configured_and_compiled(yocto):
    if yocto.profile.suites:
        pytest.skip("the originals of 2014 are in a git repository, and BB_NO_NETWORK is set")
    build = yocto.top / "build-suites"
    shutil.rmtree(build, ignore_errors=True)
    _configure(yocto, build, yocto.machine)
    # To be added to: links would do so to the one in the cache.
    stage = build / "sysroot"
    shutil.copytree(sysroot.build("armhf", debian.source()), stage, symlinks=True)
    with (build / "conf" / "local.conf").open("a") as conf:
        python, languages = rtgen.suites.SYSTEM_PYTHON, rtgen.suites.ROS_LANG_DISABLE
        conf.write(DEBIAN.format(tools=TOOLS, python=python, sysroot=stage, languages=languages))
    for suite in suite_recipes(yocto.profile):
        (recipe,) = yocto.layer.glob(f"recipes-tests/*/{suite['package']}_*.bb")
        yocto.run("bitbake", "-b", str(recipe), "-c", "compile", build=build)
        (work,) = build.glob(f"tmp*/work/*/{suite['package']}/*")
        assert {"do_patch", "do_configure", "do_compile"} <= {
            path.suffixes[0][1:] for path in work.glob("temp/log.do_*")
        }
        # do_install would need pseudo.
        subprocess.run(["cmake", "--install", work / "build"], env=os.environ | {"DESTDIR": str(stage)}, check=True)
    for suite, described in read_yaml(checkout() / "recipes-tests/suites.yml")["suites"].items():
        for program in described["programs"]:
            binary = stage / "opt" / "ros" / "noetic" / "lib" / suite / program
            kind = subprocess.run(["file", "-b", binary], capture_output=True, text=True, check=True).stdout
            assert "ELF 32-bit" in kind and "ARM" in kind and "EABI5" in kind


def test_dry_run_of_the_image(yocto):
    if not yocto.release.modern:
        pytest.skip("BitBake 1.20 starts pseudo even for a dry run, and pseudo is not built")
    output = yocto.run("bitbake", "-n", yocto.profile.image.name)
    counted = re.search(r"Attempted (\d+) tasks of which \d+ didn't need to be rerun and all succeeded", output)
    assert counted and int(counted[1]) > 1000, output[-2000:]
    print(counted[0])


def test_yocto_check_layer(yocto):
    if not os.environ.get("RT_TESTS_CHECK_LAYER"):
        pytest.skip("takes forty minutes: RT_TESTS_CHECK_LAYER=1 asks for it")
    if not yocto.release.modern:
        pytest.skip("dora has no yocto-check-layer")
    mask = _needless(yocto)
    build = yocto.top / "build-check"
    core, *others = yocto.kas(yocto.machine)[0]
    # As somebody else has it who adds the layer: nothing of ours is switched on.
    _write_configuration(build, False, [core], [*_local(yocto, "qemuarm"), f'BBMASK = "{mask}"'])
    output = yocto.run(
        "yocto-check-layer", str(yocto.layer), "--dependency", *map(str, others), "--no-auto", "--no-auto-dependency",
        "--machines", *yocto.profile.machines, build=build,
    )  # fmt: skip
    print(output)
    assert re.search(r"meta-rt-tests \.\.\. PASS", output)


def _needless(yocto: Yocto) -> str:
    """Return a BBMASK of what no recipe of ours needs of the layers beside openembedded-core.

    yocto-check-layer works out `world` ten times, for each machine, with our layer and without it: with some four
    thousand recipes of others in it, that would take hours.
    """
    ours = sorted({path.stem.partition("_")[0] for path in yocto.layer.glob("recipes-*/*/*.bb")})
    yocto.run("bitbake", "-g", *ours)
    graph = (yocto.build / "task-depends.dot").read_text()
    needed = {Path(path) for path in re.findall(r"(?:virtual:[^/]*:)?(/[^\\\n\"]*\.bb)\b", graph)}
    assert len(needed) > 100
    core, *others = yocto.kas(yocto.machine)[0]
    known = {path.stem.partition("_")[0] for path in [*needed, *core.glob("recipes-*/*/*.bb")]}
    masks = []
    for layer in others:
        files = [path for path in layer.rglob("*.bb*") if path.suffix in (".bb", ".bbappend")]
        keep = [
            str(path.relative_to(layer)).replace(".", "[.]").replace("+", "[+]")
            for path in files
            if path in needed or (path.suffix == ".bbappend" and path.stem.partition("_")[0] in known)
        ]
        masks.append(f"^{layer}/(?!({'|'.join(sorted(keep))})$)")
    return " ".join(masks)
