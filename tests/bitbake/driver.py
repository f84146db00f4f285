"""The real BitBake (bitbake-setup on PyPI, its Python API) over a build folder; started as a program of its own.

BitBake keeps global state and changes folder, so that a test runs ``driver.py FOLDER REQUEST`` (JSON) and reads JSON:

    {"variables": ["S", ...], "tasks": [["recipe", "task"], ...], "functions": [["recipe", "function"], ...]}
    -> {"recipes": {name: {"file", "appends", "skipped", "variables": {...}}}, "files": {recipe: {path: package}}}

Recipes must parse; a task or function that fails ends the program with status 1 and its log on standard error.
"""

import fnmatch
import json
import logging
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "stubs" / "shims"))

import bb.build
import bb.cookerdata
import bb.parse
import bb.siggen
from bb.cooker import CookerCollectFiles


def main(folder: str, request: dict[str, list]) -> dict[str, dict]:
    os.chdir(folder)
    os.environ["BBPATH"] = folder
    bb.utils.set_process_name = lambda _name: None
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr, format="%(levelname)s: %(message)s")
    configuration = bb.cookerdata.CookerConfiguration()
    configuration.env = dict(os.environ)
    builder = bb.cookerdata.CookerDataBuilder(configuration)
    builder.parseBaseConfiguration()
    priorities = builder.data.getVar("BBFILE_COLLECTIONS").split()
    collected = CookerCollectFiles(bb_priorities(builder.data, priorities))
    files, _, _ = collected.collect_bbfiles(builder.data, builder.data)
    recipes, stores = {}, {}
    for file in files:
        appends = collected.get_file_appends(file)
        store = builder.parseRecipeVariants(file, appends, layername="")[""]
        name = store.getVar("PN")
        stores[name] = store
        recipes[name] = {
            "file": file,
            "appends": list(appends),
            "skipped": store.getVar("__SKIPPED"),
            "variables": {variable: store.getVar(variable) for variable in request.get("variables", [])},
            "unexpanded": unexpanded(store),
        }
    installed = {}
    for name, task in request.get("tasks", []):
        run(stores[name], recipes[name]["file"], task)
        if task == "do_install":
            installed[name] = packages_of(stores[name])
    for name, function in request.get("functions", []):
        prepare(stores[name], recipes[name]["file"])
        bb.build.exec_func(function, stores[name])
    return {"recipes": recipes, "files": installed}


def bb_priorities(data, collections):
    """Layers as CookerCollectFiles wants them: name, pattern, compiled pattern, priority."""
    import re

    rows = []
    for name in collections:
        pattern = data.getVar(f"BBFILE_PATTERN_{name}")
        rows.append((name, pattern, re.compile(pattern), int(data.getVar(f"BBFILE_PRIORITY_{name}"))))
    return rows


def unexpanded(store):
    """Variables of the recipe that still hold a reference after expansion: one that nothing defines."""
    looked_at = ("SRC_URI", "S", "B", "DEPENDS", "RDEPENDS:" + store.getVar("PN"), "IMAGE_INSTALL", "LIC_FILES_CHKSUM")
    return [name for name in looked_at if "${" in (store.getVar(name) or "")]


def prepare(store, file):
    for variable in ("T", "WORKDIR", "STAMPS_DIR", "DL_DIR"):
        Path(store.getVar(variable)).mkdir(parents=True, exist_ok=True)
    bb.parse.siggen.setup_datacache_from_datastore(file, store)


def run(store, file, task):
    prepare(store, file)
    if bb.build.exec_task(file, task, store):
        for log in sorted(Path(store.getVar("T")).glob(f"log.{task}*")):
            sys.stderr.write(log.read_text(errors="replace"))
        raise SystemExit(1)


def packages_of(store):
    """Every installed file and the package that takes it, as do_package does: the first whose FILES match."""
    top = Path(store.getVar("D"))
    package_of = {}
    for path in sorted(top.rglob("*")):
        if path.is_dir() and not path.is_symlink():
            continue
        name = "/" + path.relative_to(top).as_posix()
        package_of[name] = ""
        for package in store.getVar("PACKAGES").split():
            patterns = (store.getVar(f"FILES:{package}") or "").split()
            if any(fnmatch.fnmatchcase(name, pattern) or name.startswith(pattern + "/") for pattern in patterns):
                package_of[name] = package
                break
    return package_of


if __name__ == "__main__":
    answer = main(sys.argv[1], json.loads(sys.argv[2]))
    Path(sys.argv[3]).write_text(json.dumps(answer))
