"""Whether a board can measure at all: the check of `rtrun farm --check`."""

from typing import TYPE_CHECKING

from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts, platform_signs

if TYPE_CHECKING:
    from rtrun.targets.link import Link

FREE_MIN_BYTES = 64 * 2**20  # room for copied suites and the samples of some runs


def check_health(link: "Link") -> str:
    """Describe the board in a few words. Raises TargetError if it does not answer, lacks tools or has no room."""
    equipment = facts.inspect(link)
    if equipment.free_bytes < FREE_MIN_BYTES:
        raise TargetError(
            f"{link.target.address}: {equipment.free_bytes // 2**20} MiB are free in {link.target.work_dir}, "
            f"{FREE_MIN_BYTES // 2**20} are needed"
        )
    release = link.check(["uname", "-r"]).strip()[:100]
    return f"{platform_signs.find_platform(link).platform}, {equipment.cpus} x {equipment.architecture}, {release}"
