"""What a target is: specimens of many machines, what no file can say, and this machine itself."""

import platform as host
from pathlib import Path

import pytest
import yaml

from rtrun.targets.config import connect, parse_target
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.inspection.platform_signs import find_platform, judge, read_signs
from rtrun.targets.link import Link

SPECIMENS = yaml.safe_load((Path(__file__).parents[3] / "data" / "platforms.yml").read_text())
LOCAL = {"schema": 1, "name": "here", "kind": "local"}


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda specimen: specimen["what"])
def test_a_specimen(specimen):
    known = judge(specimen["lines"].splitlines(), read_signs())
    assert known.platform == specimen["platform"], known.evidence
    assert known.evidence == specimen.get("evidence", known.evidence)


def test_each_sign_is_seen_in_a_specimen():
    lines = "\n".join(specimen["lines"] for specimen in SPECIMENS)
    for sign in read_signs():
        assert judge(lines.splitlines(), [sign]).platform is not Platform.HARDWARE, sign.hypervisor


def test_a_hostile_target_gets_no_long_or_commanding_evidence():
    line = "dmi: QEMU \x1b[2J" + "x" * 100_000
    evidence = judge([line, *(f"{line}{number}" for number in range(1000))], read_signs()).evidence
    assert len(evidence) < 1000 and evidence.isprintable()


def known_here(tmp_path, **stated):
    config = parse_target(LOCAL | {"work_dir": str(tmp_path)} | stated, "test")
    with connect(config, tmp_path, tmp_path / "console") as target, Link(target, print) as link:
        return find_platform(link)


def test_this_machine(tmp_path):
    """A hypervisor sets the flag on every PC; nothing else does."""
    known = known_here(tmp_path)
    if host.machine() == "x86_64":
        is_virtual = " hypervisor" in Path("/proc/cpuinfo").read_text()
        assert (known.platform is Platform.HARDWARE) is not is_virtual, known.evidence


def test_a_file_can_only_weaken(tmp_path):
    assert known_here(tmp_path, emulated=True).platform is Platform.EMULATED
    assert known_here(tmp_path, emulated=False) == known_here(tmp_path)
