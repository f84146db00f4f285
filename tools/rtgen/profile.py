"""Profiles: a YAML file that describes an image and its sources.

`load_profile` takes the name of a profile that comes with rtgen, or the path of a file. It raises UsageError with file
and key path for values that are unknown or do not fit together.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rtfiles.config import Config, load, load_own, matching
from rtfiles.errors import UsageError
from rtfiles.wording import unknown

PROFILES = Path(__file__).with_name("profiles")
RELEASES_FILE = Path(__file__).parent / "layer" / "releases.yml"
MACHINES_FILE = Path(__file__).parent / "layer" / "machines.yml"
LAYER = "meta-rt-tests"  # the rendered folder

Strings = Annotated[tuple[str, ...], Field(strict=False)]  # YAML has only lists


# These values end up in recipes and shell, so they must not contain syntax of BitBake, kas or a shell.
Commit = Annotated[str, matching(r"[0-9a-f]{40}", "a commit of 40 lower-case hex digits")]
Url = Annotated[str, matching(r"(https?|git)://[\w.~:/@%+-]+", "an http(s) or git address")]
Name = Annotated[str, matching(r"[a-z0-9][a-z0-9.+_-]*", "a name of lower-case letters, digits and . + _ -")]
# BitBake reads the part after an underscore as the version.
RecipeName = Annotated[str, matching(r"[a-z0-9][a-z0-9.+-]*", "a name of lower-case letters, digits and . + -")]
Branch = Annotated[str, matching(r"\w[\w.+/-]*", "a branch of letters, digits and . + / _ -")]
LayerPath = Annotated[str, matching(r"\.|\w[\w.+-]*(/\w[\w.+-]*)*", "a folder in the repository, or . for its top")]
Argument = Annotated[str, matching(r"[\w.,:/=+-]+", "one boot argument without blanks or quotes")]
Line = Annotated[
    str, matching(r"[^$\\\x00-\x1f\x7f-\x9f\u2028\u2029]+", "one line of printable text without $ and backslash")
]

# Kinds of public keys, and the form of the base64 text that follows: its beginning and its length, so that a truncated
# key is refused (RSA keys have any length from 1024 bits; three of four truncations are refused). For Python's re and
# for grep -E.
_BASE64 = "[A-Za-z0-9+/]"
KEY_TYPES = {
    "ssh-ed25519": f"AAAAC3NzaC1lZDI1NTE5AAAAI{_BASE64}{{43}}",
    "ecdsa-sha2-nistp256": f"AAAAE2VjZHNhLXNoYTItbmlzdHAyNTY{_BASE64}{{108}}=",
    "ecdsa-sha2-nistp384": f"AAAAE2VjZHNhLXNoYTItbmlzdHAzODQ{_BASE64}{{151}}==",
    "ecdsa-sha2-nistp521": f"AAAAE2VjZHNhLXNoYTItbmlzdHA1MjE{_BASE64}{{199}}==",
    "ssh-rsa": f"AAAAB3NzaC1yc2EA({_BASE64}{{4}}){{45,}}({_BASE64}{{4}}|{_BASE64}{{3}}=|{_BASE64}{{2}}==)",
}


def key_pattern(kinds: Iterable[str]) -> str:
    """Public keys of these kinds without their comments, for Python's re and for grep -E."""
    return "|".join(f"{kind} {KEY_TYPES[kind]}" for kind in kinds)


KeyType = Annotated[str, matching("|".join(KEY_TYPES), f"one of {', '.join(KEY_TYPES)}")]


RtSource = Literal["branch", "mainline", "patch"]


class KernelRecipe(Config):
    """A kernel recipe in the layers of a release: its series, and how it gets PREEMPT_RT (see `ProfileKernel`).

    `collection`: the layer's name for BitBake (BBFILE_COLLECTIONS), if an image may do without the layer of the recipe.
    """

    versions: Strings
    rt: RtSource
    collection: str | None = None


class RosDistro(Config):
    """A ROS distribution in the layers of a release; releases.yml explains each key."""

    version: Literal[0, 1, 2]
    transports: dict[str, RecipeName] = Field(default={})
    set: dict[str, str] = Field(default={})
    left_out: dict[str, dict[str, str]] = Field(default={})


class Release(Config):
    """The facts of a Yocto release that a layer depends on; releases.yml explains each.

    `modern`: BitBake and meta-ros since 2022, with catkin-native, ros_distro classes, linux-yocto-rt, and the newer
    names of variables and exceptions; false for those of 2013.
    """

    modern: bool
    separator: Literal[":", "_"]
    unpack_folder: str
    ros_distros: dict[str, RosDistro]
    kernels: dict[str, KernelRecipe]
    left_out: dict[str, dict[str, str]] = Field(default={})
    own_suites: bool
    machines: Strings
    layers: Strings
    layer_depends: Strings
    ros_layers: Strings = ()
    ros_layer_depends: Strings = ()
    wic_boot_plugin: str | None
    wks_folder: str | None
    own_u_boot: bool
    key_types: Annotated[tuple[KeyType, ...], Field(strict=False, min_length=1)]


class Releases(Config):
    """releases.yml."""

    schema_: Literal[1] = Field(alias="schema")
    releases: dict[str, Release]


class KnownMachine(Config):
    """What the layer must know about a machine; machines.yml explains each key."""

    layer: str
    fragment: str
    device_tree: str | None = None
    boot_loader: str | None = None
    boot_arguments: str | None = None
    kernel: dict[str, str] = Field(default={})
    set: dict[str, str] = Field(default={})
    append: dict[str, str] = Field(default={})


class KnownMachines(Config):
    """machines.yml."""

    schema_: Literal[1] = Field(alias="schema")
    machines: dict[str, KnownMachine]


class Repository(Config):
    """A repository of layers (or BitBake itself, which has none), pinned by commit."""

    url: Url
    commit: Commit
    branch: Branch | None = None
    layers: Annotated[tuple[LayerPath, ...], Field(strict=False)] = ()

    def layer_names(self, name: str) -> list[str]:
        """The names of its layers' folders; `name` is that of the repository, for a layer at its top."""
        return [name if layer == "." else layer.rpartition("/")[2] for layer in self.layers]


class KernelSource(Config):
    """A kernel tree and patch that replace those of the recipe."""

    url: Url
    branch: Branch
    commit: Commit
    rt_patch: Url
    rt_patch_sha256: Annotated[str, matching(r"[0-9a-f]{64}", "64 lower-case hex digits")] | None = None


class ProfileKernel(Config):
    """The kernel of a machine, and how it gets PREEMPT_RT.

    `rt`: "branch" (the recipe's branch has the RT patch), "mainline" (no patch is needed) or "patch" (our append adds
    it, from `source`).
    """

    recipe: Name
    version: Annotated[str, matching(r"\d+\.\d+", "a kernel series such as 6.6")]
    rt: RtSource
    source: KernelSource | None = None

    @model_validator(mode="after")
    def _patch_needs_source(self) -> Self:
        if (self.rt == "patch") != (self.source is not None):
            raise ValueError("rt: patch and source belong together, give both or neither")
        return self

    @property
    def series(self) -> tuple[int, ...]:
        """The version as numbers."""
        return tuple(int(part) for part in self.version.split("."))


class SerialConsole(Config):
    """A serial console."""

    device: Annotated[str, matching(r"tty[A-Za-z]+\d+", "a serial device such as ttyS2")]
    baud: Annotated[int, Field(ge=1200, le=4_000_000)]


class SdCard(Config):
    """Two partitions: FAT for the boot files, ext4 for the root."""

    boot_size_mib: Annotated[int, Field(ge=32, le=1024)]
    root_extra_mib: Annotated[int, Field(ge=0, le=65536)]


class ProfileMachine(Config):
    """A machine of the profile. `sd_card` is for machines of our layer; others have their own image types."""

    kernel: ProfileKernel
    serial_console: SerialConsole
    boot_arguments: Annotated[tuple[Argument, ...], Field(strict=False)] = ()
    sd_card: SdCard | None = None


class SuiteSource(Config):
    """The source of the suites, if it is not this repository."""

    url: Url
    branch: Branch
    commit: Commit
    version: Annotated[str, matching(r"\d+(\.\d+)+", "a version such as 0.1.2")]


class Image(Config):
    """The image and its packages, apart from the suites and the SSH server."""

    name: RecipeName
    packages: Annotated[tuple[Name, ...], Field(strict=False)]


class Ssh(Config):
    """The SSH server, and public keys that may log in as root, in addition to RT_TESTS_AUTHORIZED_KEYS."""

    server: Literal["openssh", "dropbear"]
    authorized_keys: Annotated[tuple[Line, ...], Field(strict=False)] = ()


class Profile(Config):
    """One image: Yocto release, layers, machines, kernel, contents. kas.yml builds for the first machine."""

    schema_: Literal[1] = Field(alias="schema")
    summary: str
    release: str
    ros_distro: str
    distro: Name
    repositories: Annotated[dict[Name, Repository], Field(min_length=1)]
    machines: Annotated[dict[Name, ProfileMachine], Field(min_length=1)]
    suites: SuiteSource | None = None
    image: Image
    ssh: Ssh

    @property
    def default_machine(self) -> str:
        """The machine that kas.yml builds for."""
        return next(iter(self.machines))


def load_releases() -> dict[str, Release]:
    """The known Yocto releases by name."""
    return load_own(RELEASES_FILE, Releases).releases


def load_machines() -> dict[str, KnownMachine]:
    """The machines that a profile can name."""
    return load_own(MACHINES_FILE, KnownMachines).machines


def profile_names() -> list[str]:
    """The profiles that come with rtgen, sorted."""
    return sorted(path.stem for path in PROFILES.glob("*.yml"))


def profile_path(name: str) -> Path:
    """The file of a profile: by the name of one that comes with rtgen, or by a path that ends with .yml."""
    if name.endswith(".yml"):
        return Path(name)
    if name not in profile_names():
        raise UsageError(f"{unknown('profile', name, known=profile_names())}, or a file (….yml)")
    return PROFILES / f"{name}.yml"


def load_profile(name: str) -> tuple[Profile, Release]:
    """Read a profile and its release. Raises UsageError with a line for each value that does not fit."""
    path = profile_path(name)
    profile = load(path, Profile)
    releases = load_releases()
    if profile.release not in releases:
        raise UsageError(f"{path}: release: {unknown('release', profile.release, known=releases)}")
    release = releases[profile.release]
    if profile.ros_distro not in release.ros_distros:
        raise UsageError(f"{path}: {_unsupported('ros_distro', profile.ros_distro, profile, release.ros_distros)}")
    release = _with_ros(release, profile)
    problems = _misfits(profile, release)
    if problems:
        raise UsageError("\n".join(f"{path}: {problem}" for problem in problems))
    return profile, release


def _with_ros(release: Release, profile: Profile) -> Release:
    """A release with what the profile's ROS, or its having none, adds: layers, and what is left out."""
    ros = release.ros_distros[profile.ros_distro]

    def filled(names: Strings) -> Strings:
        return tuple(name.format(version=ros.version, distro=profile.ros_distro) for name in names if ros.version)

    left_out = {
        what: {name.replace("{image}", profile.image.name): value for name, value in settings.items()}
        for what, settings in (release.left_out | ros.left_out).items()
    }
    return release.model_copy(
        update={
            "layers": release.layers + filled(release.ros_layers),
            "layer_depends": release.layer_depends + filled(release.ros_layer_depends),
            "left_out": left_out,
        }
    )


def _unsupported(key: str, value: str, profile: Profile, allowed: Iterable[str]) -> str:
    return f"{key}: {value!r} is not supported with {profile.release}, allowed: {', '.join(allowed)}"


def _misfits(profile: Profile, release: Release) -> list[str]:
    """The values of a profile that are not supported with its release, as `key path: value, allowed values`."""
    problems = []

    def check(key: str, value: str, allowed: tuple[str, ...]) -> None:
        if value not in allowed:
            problems.append(_unsupported(key, value, profile, allowed))

    layers = {
        layer: name for name, repository in profile.repositories.items() for layer in repository.layer_names(name)
    }
    known_machines = load_machines()
    for name, machine in profile.machines.items():
        check(f"machines.{name}", name, release.machines)
        check(f"machines.{name}.kernel.recipe", machine.kernel.recipe, tuple(release.kernels))
        recipe = release.kernels.get(machine.kernel.recipe)
        if recipe:
            check(f"machines.{name}.kernel.version", machine.kernel.version, recipe.versions)
            check(f"machines.{name}.kernel.rt", machine.kernel.rt, (recipe.rt,))
        known = known_machines.get(name)
        if known is None:
            continue
        if known.layer not in (LAYER, *layers):
            problems.append(
                f"machines.{name}: no repository has its layer {known.layer!r}, add one under repositories or leave "
                "the machine out"
            )
        if machine.boot_arguments and not known.boot_arguments:
            problems.append(
                f"machines.{name}.boot_arguments: its boot loader takes none from Yocto's settings, leave it out"
            )
        if machine.sd_card and not release.wic_boot_plugin:
            problems.append(f"machines.{name}.sd_card: {profile.release} has no image type wic, leave it out")
        elif machine.sd_card and known.layer != LAYER:
            problems.append(f"machines.{name}.sd_card: {known.layer} describes the card of {name}, leave it out")
    if release.own_suites and profile.suites:
        problems.append(f"suites: those of this repository are built in {profile.release}, leave it out")
    if not release.own_suites and not profile.suites:
        problems.append(f"suites: those of this repository do not build in {profile.release}, give others")
    for number, key in enumerate(profile.ssh.authorized_keys):
        if not re.fullmatch(f"({key_pattern(release.key_types)})( .*)?", key):
            kinds = ", ".join(release.key_types)
            problems.append(f"ssh.authorized_keys.{number}: not a public key of the kinds {kinds}, or not a whole one")
    if LAYER in profile.repositories:
        problems.append(f"repositories.{LAYER}: the name of the rendered layer, choose another")
    if not {"bitbake", "poky"} & set(profile.repositories):
        problems.append("repositories: BitBake is missing, name a repository bitbake, or poky, which contains it")
    for layer in release.layers:
        if layer not in layers:
            problems.append(f"repositories: no repository has the layer {layer!r}, {profile.release} needs it")
    return problems
