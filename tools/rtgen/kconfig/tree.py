"""A kernel tree, and the kernel's own ``conf`` built from it.

Only the files that Kconfig reads are used. They are copied into the cache under the hash of their content, so nothing
is written into the tree, and an unchanged tree is not built again.
"""

import fnmatch
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rtfiles import cache
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.untrusted import MIB, read_text
from rtgen.process import run


@dataclass(frozen=True, kw_only=True, slots=True)
class Architecture:
    """An architecture: its name for the kernel's make (ARCH), its folder in arch/, and the prefix of its compiler."""

    title: str
    name: str
    folder: str
    prefix: str


ARCHITECTURES = {
    "arm": Architecture(title="32-bit ARM", name="arm", folder="arm", prefix="arm-linux-gnueabihf-"),
    "arm64": Architecture(title="64-bit ARM", name="arm64", folder="arm64", prefix="aarch64-linux-gnu-"),
    "x86-64": Architecture(title="x86-64", name="x86_64", folder="x86", prefix="x86_64-linux-gnu-"),
}
CROSS_COMPILE = ARCHITECTURES["arm"].prefix  # kernels are built for boards of 32-bit ARM only

# The sources of `conf`, the files that it reads, the defconfigs, and the includes of the PandaBoard's device tree.
PATTERNS = (
    "Makefile",
    "localversion*",
    "Kconfig*",
    "*/Kconfig*",
    "scripts/*.sh",
    "scripts/kconfig/*.[chly]",
    "scripts/include/*.h",
    "arch/arm/configs/*_defconfig",
    "arch/arm64/configs/defconfig",
    "arch/x86/configs/x86_64_defconfig",
    "arch/arm/boot/dts/omap4*",
    "arch/arm/boot/dts/elpida*",
    "arch/arm/boot/dts/twl603*",
    "arch/arm/boot/dts/twl604*",
    "arch/arm/boot/dts/ti/omap/omap4*",
    "arch/arm/boot/dts/ti/omap/elpida*",
    "arch/arm/boot/dts/ti/omap/twl60*",
    "include/dt-bindings/*",
    "include/uapi/linux/input-event-codes.h",
)
_WANTED = re.compile("|".join(fnmatch.translate(pattern) for pattern in PATTERNS))
_CONF_SOURCES = ("conf", "confdata", "expr", "menu", "preprocess", "symbol", "util")
_NEEDED = ("Makefile", "Kconfig", "arch/arm/Kconfig", "scripts/Kconfig.include", "scripts/kconfig/conf.c")


@dataclass(frozen=True, kw_only=True, slots=True)
class Tree:
    """A kernel tree in the cache: ``folder/source`` holds the files, ``folder/conf`` the program."""

    name: str
    folder: Path
    kernel: str
    release: str

    @property
    def source(self) -> Path:
        """The files that Kconfig reads."""
        return self.folder / "source"

    def defconfig(self, name: str, architecture: Architecture) -> Path:
        """The tree's own defconfig with that name. Raises UsageError, naming the available ones."""
        path = self.source / "arch" / architecture.folder / "configs" / name
        if not path.is_file():
            known = ", ".join(sorted(file.name for file in path.parent.glob("*defconfig")))
            raise UsageError(f"{self.name}: has no {name} for {architecture.name}, it has: {known or 'none'}")
        return path

    def symbols(self, architecture: Architecture) -> frozenset[str]:
        """Every symbol that a config of this tree can set for an architecture."""
        return frozenset((self.folder / "symbols" / architecture.folder).read_text(encoding="utf-8").split())


def wanted(path: str) -> bool:
    """Whether this file of a kernel tree is copied (path relative to its top)."""
    return _WANTED.match(path) is not None


def open_tree(path: Path, name: str | None = None) -> Tree:
    """Copy a kernel tree, or a Kconfig-only one, into the cache.

    Raises UsageError when it is not a kernel tree, or too old for its ``conf`` to be built (before 5.1),
    InfrastructureError when a compiler, flex or bison is missing.
    """
    name = name or str(path)
    missing = [file for file in _NEEDED if not (path / file).is_file()]
    if missing:
        raise UsageError(f"{name}: not a kernel tree, it has no {', '.join(missing)}")
    if not (path / "scripts/kconfig/parser.y").is_file():
        raise UsageError(f"{name}: its scripts/kconfig has no parser.y: a tree before 5.1 cannot be verified")
    kernel, release = read_version(path)
    files = sorted(_walk(path))
    parts: list[str | bytes | Path] = ["2"]
    for file in files:
        parts += [file, path / file]

    def build(folder: Path) -> None:
        for file in files:
            target = folder / "source" / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path / file, target)
        _build_conf(folder)
        (folder / "symbols").mkdir()
        for architecture in ARCHITECTURES.values():
            symbols = "\n".join(sorted(_defined(folder / "source", architecture)))
            (folder / "symbols" / architecture.folder).write_text(symbols, encoding="utf-8")

    folder = cache.entry("kconfig-tree", cache.digest(parts), build)
    return Tree(name=name, folder=folder, kernel=kernel, release=release)


def read_version(path: Path) -> tuple[str, str]:
    """(``6.1``, ``6.1.176-rt64``) from the Makefile and the localversion files. Raises UsageError."""
    text = read_text(path / "Makefile", max_bytes=MIB)
    numbers = [re.search(rf"^{part} = (\d+)$", text, re.M) for part in ("VERSION", "PATCHLEVEL", "SUBLEVEL")]
    version, level, sub = (match[1] if match else None for match in numbers)
    if version is None or level is None:
        raise UsageError(f"{path / 'Makefile'}: not the Makefile of a kernel, it has no VERSION and PATCHLEVEL")
    local = "".join(read_text(file, max_bytes=MIB).strip() for file in sorted(path.glob("localversion*")))
    return f"{version}.{level}", f"{version}.{level}.{sub or 0}{local}"


def environment(tree: Tree, architecture: Architecture) -> dict[str, str]:
    """The variables that the kernel's Makefile passes to Kconfig."""
    compiler = f"{architecture.prefix}gcc"
    version = run([compiler, "--version"])
    tools = {name: f"{architecture.prefix}{name.lower()}" for name in ("LD", "NM", "AR", "OBJCOPY", "READELF")}
    return {
        "PATH": os.environ.get("PATH", os.defpath),
        "LC_ALL": "C",
        "srctree": str(tree.source),
        "ARCH": architecture.name,
        "SRCARCH": architecture.folder,
        "KERNELVERSION": tree.release.split("-")[0],
        "CC": compiler,
        "CC_VERSION_TEXT": version.splitlines()[0],
        "HOSTCC": "gcc",
        "HOSTCXX": "g++",
        # Not used by this build, but empty names would break the shell calls in Kconfig.
        "RUSTC": "rustc",
        "BINDGEN": "bindgen",
        "PAHOLE": "pahole",
        "PAHOLE_VERSION": "0",
        "RUSTC_VERSION_TEXT": "",
        **tools,
    }


def run_conf(tree: Tree, architecture: Architecture, defconfig: str) -> str:
    """The finished .config that ``conf --defconfig`` makes from a defconfig's text. Raises InfrastructureError."""
    # conf leaves include/ and .tmp_* folders in the current folder.
    with tempfile.TemporaryDirectory(prefix="rtgen-conf-") as work:
        given, config = Path(work, "defconfig"), Path(work, ".config")
        given.write_text(defconfig, encoding="utf-8")
        settings = environment(tree, architecture) | {"KCONFIG_CONFIG": str(config)}
        command: list[str | Path] = [tree.folder / "conf", f"--defconfig={given}", tree.source / "Kconfig"]
        try:
            run(command, folder=Path(work), environment=settings)
            return config.read_text(encoding="utf-8")
        except (InfrastructureError, FileNotFoundError) as error:
            raise InfrastructureError(f"{tree.name}: conf failed: {error}") from error


def _walk(path: Path) -> list[str]:
    wanted_files = []
    for folder, folders, files in os.walk(path):
        if ".git" in folders:
            folders.remove(".git")
        relative = os.path.relpath(folder, path)
        prefix = "" if relative == "." else f"{relative}/"
        # A link may lead to a file that is missing in this tree.
        wanted_files += [prefix + file for file in files if wanted(prefix + file) and Path(folder, file).is_file()]
    return wanted_files


def _build_conf(folder: Path) -> None:
    scripts = folder / "source/scripts"
    work = folder / "build"
    work.mkdir()
    sources = [scripts / "kconfig" / f"{name}.c" for name in _CONF_SOURCES]
    steps: list[list[str | Path]] = [
        ["flex", "-o", "lexer.lex.c", "-L", scripts / "kconfig/lexer.l"],
        ["bison", "-o", "parser.tab.c", "--defines=parser.tab.h", "-t", "-l", scripts / "kconfig/parser.y"],
        ["gcc", "-O1", "-w", "-I.", "-I", scripts / "kconfig", "-I", scripts / "include", "-o", folder / "conf",
         *[source for source in sources if source.is_file()], "lexer.lex.c", "parser.tab.c"],
    ]  # fmt: skip
    for step in steps:
        run(step, folder=work)
    shutil.rmtree(work)


def _defined(source: Path, architecture: Architecture) -> set[str]:
    define = re.compile(r"^\s*(?:menu)?config\s+(\w+)\s*$", re.M)
    symbols = set()
    for file in source.rglob("Kconfig*"):
        parts = file.relative_to(source).parts
        other_architecture = parts[0] == "arch" and len(parts) > 2 and parts[1] != architecture.folder
        if other_architecture or parts[:3] == ("scripts", "kconfig", "tests"):
            continue
        symbols.update(define.findall(file.read_text(encoding="utf-8", errors="replace")))
    return symbols
