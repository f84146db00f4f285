"""Checkouts of the real layers of a profile, and BitBake on them."""

import os
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from rtgen.layer import output
from rtgen.layer.render import render
from rtgen.profile import Profile, Release, RosDistro, load_profile, profile_names

KEY = "ssh-ed25519 AAAA"
# What BitBake reports about recipes that are masked.
MISSING = ("Nothing PROVIDES", "No bb files in default matched")
# And of a world which needs some of these.
MISSING_OF_WORLD = (*MISSING, "Nothing RPROVIDES", "Required build target")
# What it reports about layers that are not ours, about the missing network, and about one recipe run alone.
FOREIGN = ("omap3-sgx-modules", "osrf-pycommon", "uninative", "Buildfile specified")
# The value of a variable that names what a recipe needs.
NEEDS = re.compile(r'(?:(?<!TEST_)DEPENDS|RRECOMMENDS|PACKAGECONFIG)[^\s="]*\s*[?:+.]*=[+.]?\s*"([^"]*)"')
# What it says when a recipe is missed: its name, and the files of those that need it.
MISSED = re.compile(r"Nothing R?PROVIDES '([^']+)' \(but (.+?) R?DEPENDS on or otherwise requires it\)")


@dataclass(frozen=True)
class Yocto:
    """A profile's checkouts, and a folder with its builds beside them."""

    top: Path
    name: str
    profile: Profile
    release: Release
    results: dict[str, dict[str, str]] = field(default_factory=dict)
    """By machine: what was seen of it, by column of the summary."""

    @property
    def work(self) -> Path:
        return self.top / self.name

    @property
    def build(self) -> Path:
        return self.work / "build"

    @property
    def layer(self) -> Path:
        return self.work / "rendered" / "meta-rt-tests"

    @property
    def ros(self) -> RosDistro:
        return self.release.ros_distros[self.profile.ros_distro]

    @property
    def machine(self) -> str:
        return os.environ.get("RT_TESTS_MACHINE", self.profile.default_machine)

    def note(self, machine: str, **seen: str) -> None:
        """Add columns to a machine's row of the summary."""
        self.results.setdefault(machine, {}).update(seen)

    def summary(self) -> str:
        """A table of what was seen of each machine, in Markdown."""
        columns = list(dict.fromkeys(column for row in self.results.values() for column in row))
        lines = [["machine", *columns], ["---"] * (1 + len(columns))]
        lines += [[machine, *(row.get(column, "") for column in columns)] for machine, row in self.results.items()]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

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

    @property
    def shared_layers(self) -> list[Path]:
        """Of the layers of others those that every machine of the profile has, openembedded-core's first.

        A mask concerns these alone. What an image needs of the machine's own layer only that layer's settings say.
        """
        return [layer for layer in self.kas(self.machine)[0] if layer.name in self.release.layers]

    def own_layers(self, machine: str) -> list[Path]:
        """The layers of others that a machine of the profile has beside the shared ones."""
        return [layer for layer in self.kas(machine)[0] if layer.name not in self.release.layers]

    def run(self, *command: str, build: Path | None = None, missing: tuple[str, ...] = ()) -> str:
        """Run a command in the build environment; what it said. Neither errors nor warnings of ours may be in it.

        `missing`: what is no error, as most recipes are masked.
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
        assert done.returncode == 0 or missing, done.stdout[-4000:]
        lines = [
            line for line in done.stdout.splitlines() if re.match(r"(Parsing recipes\.\.\.)?(WARNING|ERROR): ", line)
        ]
        foreign = (*FOREIGN, *missing)
        assert [line for line in lines if not any(name in line for name in foreign)] == []
        return done.stdout

    def variables(
        self, *target: str, names: tuple[str, ...], build: Path | None = None, masked: bool = False
    ) -> dict[str, str]:
        """Variables of a recipe, or of `-b` and its file, expanded, as `bitbake -e` gives them."""
        output = self.run("bitbake", "-e", *target, build=build, missing=MISSING if masked else ())
        values = {}
        for name in names:
            match = re.search(rf'^(?:export )?{re.escape(name)}="((?:[^"\\]|\\.|\\\n)*)"$', output, re.MULTILINE)
            # kirkstone shows what it runs in the root file system as a function.
            match = match or re.search(rf"^{re.escape(name)}\(\) {{\n(.*)$", output, re.MULTILINE)
            values[name] = match[1].replace(" \\\n", "\n").replace('\\"', '"') if match else ""
        return values

    def configure(self, build: Path, machine: str, *more: str) -> None:
        """Write local.conf and bblayers.conf as kas would for a machine, and `more` lines of local.conf."""
        layers, settings = self.kas(machine)
        self.write_configuration(build, [*layers, self.layer], [*self.local(machine), *settings, *more])

    def local(self, machine: str) -> list[str]:
        """The lines for local.conf that every build here needs."""
        old = not self.release.modern
        local = [
            f'MACHINE ?= "{machine}"',
            f'DISTRO ?= "{self.profile.distro}"',
            'BB_NO_NETWORK = "1"',
            f'RT_TESTS_AUTHORIZED_KEYS = "{KEY}"',
            f'CONF_VERSION = "{1 if old else 2}"',
            'BB_NUMBER_THREADS = "2"',
        ]
        if old:
            return [*local, 'PACKAGE_CLASSES = "package_ipk"']
        # BitBake may run as root here.
        return [*local, 'INHERIT:remove = "sanity"', 'BB_NUMBER_PARSE_THREADS = "2"']

    def write_configuration(self, build: Path, layers: list[Path], local: list[str]) -> None:
        """Write bblayers.conf and local.conf of a build folder."""
        old = not self.release.modern
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

    def mask_of_needless_recipes(self) -> str:
        """Return a BBMASK of the recipes in the layers beside openembedded-core that ours cannot need.

        A recipe may need every other that its DEPENDS, RDEPENDS and the like name, or whose name begins a name there:
        too many rather than too few, but hundreds instead of thousands. BitBake says so if one is missing.
        """
        _, *others = self.shared_layers
        files: dict[str, list[Path]] = {}
        appends: dict[str, list[Path]] = {}
        for layer in others:
            for path in layer.rglob("*.bb"):
                files.setdefault(_recipe(path), []).append(path)
            for path in layer.rglob("*.bbappend"):
                appends.setdefault(_recipe(path), []).append(path)
        needed: set[str] = set()
        # Of ours every word counts: an image names packages in other variables.
        ours = " ".join(path.read_text().replace('"', " ") for path in self.layer.glob("recipes-*/**/*.bb"))
        texts = [f'DEPENDS = "{ours}"']
        for layer in self.own_layers(self.machine):
            texts += [path.read_text() for path in layer.rglob("*") if path.suffix in (".bb", ".inc", ".conf")]
        # openembedded-core's recipes are all kept.
        texts += [path.read_text() for name in appends.keys() - files.keys() for path in appends[name]]
        while texts:
            words = {
                word for value in NEEDS.findall(texts.pop()) for word in re.findall(r"[a-z0-9][a-z0-9.+-]*", value)
            }
            new = (_beginnings(words) & files.keys()) - needed
            needed |= new
            folders = {path.parent for name in new for path in files[name]}
            parts = {path for folder in folders for path in folder.iterdir() if path.suffix in (".bb", ".inc")}
            parts.update(path for name in new for path in appends.get(name, ()))
            texts += [path.read_text().replace("${PYTHON_PN}", "python3") for path in parts]
        return self.mask_of_others_but(needed)

    def mask_of_others_but(self, needed: set[str]) -> str:
        """Return a BBMASK that keeps these recipes of the layers beside openembedded-core, and all of that one.

        A native one may come from a recipe of its own, or from the one without that ending.
        """
        core, *others = self.shared_layers
        recipes = needed | {name.removesuffix("-native") for name in needed} | self._appended(self.machine)
        return self._mask(others, recipes, recipes | {_recipe(path) for path in core.glob("recipes-*/*/*.bb")})

    def mask_of_all_but(self, needed: set[str], machine: str) -> str:
        """Return a BBMASK for a machine that keeps the recipes of another machine's image.

        What starts, builds or writes an image is kept too, and what the machine's layer adds to: it may need more.
        """
        core, *others = self.shared_layers
        names = _beginnings(needed) | self._appended(machine)
        for folder in ("bsp", "core", "devtools", "extended", "kernel", "support"):
            names |= {_recipe(path) for path in core.glob(f"recipes-{folder}/*/*.bb")}
        return self._mask([core, *others], names, names)

    def _appended(self, machine: str) -> set[str]:
        """The recipes to which a machine's own layers add: BitBake stops where such a recipe is missing."""
        return {_recipe(path) for layer in self.own_layers(machine) for path in layer.rglob("*.bbappend")}

    def _mask(self, layers: list[Path], recipes: set[str], appended: set[str]) -> str:
        """Return a BBMASK that keeps these recipes of the layers, and the bbappends of `appended`."""
        names = {".bb": recipes, ".bbappend": appended}
        masks = []
        for layer in layers:
            keep = [
                str(path.relative_to(layer)).replace(".", "[.]").replace("+", "[+]")
                for path in layer.rglob("*.bb*")
                if _recipe(path) in names.get(path.suffix, ())
            ]
            masks.append(f"^{layer}/(?!({'|'.join(sorted(keep))})$)")
        return " ".join(masks)

    def _python2(self) -> Path:
        python = os.environ.get("RT_TESTS_PYTHON2") or shutil.which("python2.7")
        assert python, "BitBake 1.20 needs Python 2.7: give its path in RT_TESTS_PYTHON2"
        folder = self.work / "python2"
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("python", "python2", "python2.7"):
            if not (folder / name).exists():
                (folder / name).symlink_to(python)
        return folder


def _recipe(path: Path) -> str:
    """The name of the recipe that a .bb file makes, or to which a .bbappend adds."""
    return path.stem.partition("_")[0]


def _beginnings(words: set[str]) -> set[str]:
    """Each word, and what is before each of its hyphens: gcc-cross-arm comes from the recipe gcc-cross."""
    return {"-".join(split[:end]) for word in words for split in [word.split("-")] for end in range(1, 9)}


def unmet_needs(output: str, graph: str) -> set[str]:
    """What a recipe of a graph (task-depends.dot) needs and nothing provides, from what `bitbake -g` said.

    BitBake draws a graph without what is missing. It also names what recipes miss that it considers and does not take.
    """
    files = set(re.findall(r'\\n([^"\\]+)"\]$', graph, re.MULTILINE))
    return {missed for missed, needing in MISSED.findall(output) if files & set(needing.split(", "))}


def open_checkouts(top: Path, wanted: str | None = None) -> Yocto:
    """Find the profile whose commits are checked out, render it, and configure a build of its first machine.

    `wanted` says which, where several have these commits. Fails with the commits that differ from those of the profile
    that comes nearest, where none fits.
    """
    profiles = {name: load_profile(name) for name in ([wanted] if wanted else profile_names())}
    differences = {name: _differences(top, profile) for name, (profile, _) in profiles.items()}
    name, *others = sorted(differences, key=lambda name: len(differences[name]))
    assert not differences[name], f"{top} holds no profile's checkouts, {name} comes nearest:\n" + "\n".join(
        differences[name]
    )
    fitting = [name, *(other for other in others if not differences[other])]
    assert len(fitting) == 1, f"{top} fits {', '.join(fitting)}: name one of them in RT_TESTS_PROFILE"
    profile, release = profiles[name]
    yocto = Yocto(top, name, profile, release)
    # Another checkout of this repository may have linked its own sources there.
    (yocto.work / "rendered" / "recipes-tests").unlink(missing_ok=True)
    output.write(render(name, profile, release), yocto.work / "rendered")
    yocto.configure(yocto.build, yocto.machine)
    return yocto


def _differences(top: Path, profile: Profile) -> list[str]:
    """What is wrong with each checkout that is not at its profile's commit."""
    differences = []
    for name, pinned in profile.repositories.items():
        command = ["git", "-C", top / name, "rev-parse", "HEAD"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        commit = done.stdout.strip()
        if done.returncode != 0:
            differences.append(f"{name} is not there, it should be at {pinned.commit}")
        elif commit != pinned.commit:
            differences.append(f"{name} is at {commit}, not at {pinned.commit}")
    return differences


def _write(path: Path, text: str) -> None:
    """Leave a file that holds it already as it is: BitBake goes by times."""
    if not path.exists() or path.read_text() != text:
        path.write_text(text)
