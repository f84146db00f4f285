"""Run the cases of testimage in a process of its own, as testimage.bbclass does once the target is up.

    python oeqa_driver.py TARGET CORE LAYER PATH ANSWER

TARGET is a JSON file: {"ip", "port", "agent", "log"}. CORE and LAYER are openembedded-core and our layer, PATH is that
of the shell that called BitBake. ANSWER becomes a JSON file: for each case what went wrong, or "". bb and oeqa must be
importable.
"""

import json
import logging
import os
import sys
from pathlib import Path

from oeqa.runtime.context import OERuntimeTestContext, OERuntimeTestContextExecutor


def main(target_file: str, core: str, layer: str, path: str, answer: str) -> None:
    given = json.loads(Path(target_file).read_text())
    os.environ["SSH_AUTH_SOCK"] = given["agent"]
    logger = logging.getLogger("testimage")
    target = OERuntimeTestContextExecutor.getTarget(
        "simpleremote", logger, f"{given['ip']}:{given['port']}", "10.0.2.2"
    )
    settings = {"ORIGPATH": path, "TEST_LOG_DIR": given["log"], "MLPREFIX": "", "IMAGE_PKGTYPE": "ipk"}
    # kirkstone's has one argument more.
    has_dumper = hasattr(OERuntimeTestContextExecutor, "getHostDumper")
    dumper = [OERuntimeTestContextExecutor.getHostDumper("", given["log"])] if has_dumper else []
    context = OERuntimeTestContext(settings, logger, target, *dumper, {"openssh-sshd"}, given["log"])
    folders = [f"{top}/lib/oeqa/runtime/cases" for top in (f"{core}/meta", layer)]
    context.loadTests(folders, modules=["ping", "ssh", "rt_tests"])
    results = context.runTests()
    ended = {test.id(): "" for test, *_ in results.successes}
    for test, why in [*results.failures, *results.errors, *results.skipped]:
        ended[test.id()] = why
    Path(answer).write_text(json.dumps(ended))


if __name__ == "__main__":
    main(*sys.argv[1:])
