"""Build a PREEMPT_RT kernel from a pinned Debian source, its RT patches and the fragment of a machine."""

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from rtfiles import atomic, cache
from rtfiles.errors import InfrastructureError, UsageError
from rtgen.kconfig import debian_source
from rtgen.kconfig.data import Data
from rtgen.kconfig.fragment import parse_fragment
from rtgen.kconfig.render import render
from rtgen.kconfig.tree import CROSS_COMPILE
from rtgen.kconfig.verify import Verification, verify_tree
from rtgen.process import run

SCHEMA = 1
DEVICE_TREE = "omap4-panda-es-rt.dts"

# With these, the same source and options give the same bytes, whoever builds and whenever.
_REPRODUCIBLE = {
    "KBUILD_BUILD_TIMESTAMP": "2014-04-24", "KBUILD_BUILD_USER": "rtgen", "KBUILD_BUILD_HOST": "meta-rt-tests",
    "KBUILD_BUILD_VERSION": "1", "LC_ALL": "C",
}  # fmt: skip
BUILD_TIMEOUT_S = 3 * 3600


def plan(data: Data, machine: str, version: str | None = None) -> Verification:
    """Verify the .config that would be built: the machine's fragment for a pinned version on its first base.

    The version is as in `Data.source`.
    """
    tree = debian_source.open_debian(data, version)
    fragment = parse_fragment(render(data, machine, tree.kernel), "rendered")
    return verify_tree(data, tree, machine, data.machine(machine).bases[0], fragment, None)


def build(data: Data, machine: str, verdict: Verification, version: str | None = None) -> Path:
    """Build the planned kernel of a machine and version; return its folder in the cache.

    The folder holds vmlinuz (zImage), config, modules/<release> (as in /lib/modules), dtbs/*.dtb, and kernel.json
    (schema, release, version of the source, dtbs). The build takes five minutes on two idle cores unless the kernel is
    in the cache; an interrupted build leaves nothing. Raises UsageError when the options do not hold,
    InfrastructureError when a tool is missing or a step fails.
    """
    if verdict.mismatches:
        raise UsageError(f"{verdict.subject}: options do not hold: {', '.join(m.symbol for m in verdict.mismatches)}")
    for tool in (f"{CROSS_COMPILE}gcc", "make", "flex", "bison", "bc", "patch", "xz", "depmod"):
        if shutil.which(tool) is None:
            raise InfrastructureError(f"{tool} is not installed: `tools/setup all` installs it")
    pinned = data.source(version)
    dtbs = data.machine(machine).dtbs
    device_tree = data.folder / "devicetree" / DEVICE_TREE
    compiler = run([f"{CROSS_COMPILE}gcc", "--version"]).splitlines()[0]
    key = cache.digest([pinned.model_dump_json(), verdict.config, *dtbs, compiler, device_tree, Path(__file__)])

    def build_in(folder: Path) -> None:
        source = debian_source.unpack(pinned, folder, whole=True)
        objects = source / "objects"
        objects.mkdir()
        _add_device_tree(source, device_tree)
        (objects / ".config").write_text(verdict.config, encoding="utf-8")
        make = _make(folder, objects)
        run([*make, "olddefconfig"], timeout_s=BUILD_TIMEOUT_S)
        _refuse_change(verdict.config, (objects / ".config").read_text(encoding="utf-8"))
        run([*make, f"-j{os.cpu_count() or 1}", "zImage", "modules", "dtbs"], timeout_s=BUILD_TIMEOUT_S)
        run([*make, f"INSTALL_MOD_PATH={folder / 'installed'}", "modules_install"], timeout_s=BUILD_TIMEOUT_S)
        release = (objects / "include/config/kernel.release").read_text(encoding="utf-8").strip()
        _collect(folder, objects, release, dtbs)
        record = {"schema": SCHEMA, "release": release, "source": f"{pinned.source} {pinned.version}", "dtbs": dtbs}
        atomic.write_text(folder / "kernel.json", json.dumps(record, indent=2) + "\n")
        shutil.rmtree(source)

    return cache.entry("kernel-built", key, build_in)


def _make(folder: Path, objects: Path) -> list[str]:
    variables = dict(_REPRODUCIBLE)
    compiler = f"{CROSS_COMPILE}gcc"
    if shutil.which("ccache"):
        compiler = f"ccache {compiler}"
        # The name of the build folder changes with every build; without these, ccache would never find an object again.
        variables |= {"CCACHE_BASEDIR": str(folder), "CCACHE_NOHASHDIR": "1"}
    settings = [f"{name}={value}" for name, value in variables.items()]
    # With the objects below the source, the kernel's make uses relative file names.
    return ["env", *settings, "make", "-s", "-C", str(objects.parent), f"O={objects.name}", "ARCH=arm",
            f"CROSS_COMPILE={CROSS_COMPILE}", f"CC={compiler}"]  # fmt: skip


def _add_device_tree(source: Path, device_tree: Path) -> None:
    """Put the device tree next to the one that it includes, and make the kernel's build include it."""
    original = next(iter(sorted(source.glob("arch/arm/boot/dts/**/omap4-panda-es.dts"))), None)
    if original is None:
        raise InfrastructureError("the kernel's source has no omap4-panda-es.dts")
    shutil.copy(device_tree, original.parent / device_tree.name)
    with (original.parent / "Makefile").open("a", encoding="utf-8") as makefile:
        makefile.write(f"\ndtb-$(CONFIG_ARCH_OMAP4) += {device_tree.stem}.dtb\n")


def _refuse_change(planned: str, built: str) -> None:
    """Raise InfrastructureError if the kernel's make produced another .config than the verified one."""
    different = sorted(set(_settings(planned)) ^ set(_settings(built)))
    if different:
        raise InfrastructureError(f"the kernel's make changed the verified .config: {', '.join(different[:5])}")


def _settings(config: str) -> list[str]:
    return [line for line in config.splitlines() if line and (not line.startswith("#") or line.endswith(" is not set"))]


def _collect(folder: Path, objects: Path, release: str, dtbs: Sequence[str]) -> None:
    boot = objects / "arch/arm/boot"
    shutil.copy(boot / "zImage", folder / "vmlinuz")
    shutil.copy(objects / ".config", folder / "config")
    (folder / "dtbs").mkdir()
    for name in dtbs:
        built = next(iter(sorted((boot / "dts").glob(f"**/{name}"))), None)
        if built is None:
            raise InfrastructureError(f"the kernel's make built no {name}")
        shutil.copy(built, folder / "dtbs" / name)
    run(["depmod", "--basedir", str(folder / "installed"), release])
    modules = folder / "installed/lib/modules" / release
    for link in ("build", "source"):
        (modules / link).unlink(missing_ok=True)
    shutil.move(modules, folder / "modules" / release)
    shutil.rmtree(folder / "installed")
