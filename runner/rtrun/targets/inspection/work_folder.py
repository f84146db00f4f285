"""The runner's folder on a target: it is made, and used only if nobody else can change the programs in it."""

from typing import TYPE_CHECKING

from rtrun.targets.address import Address
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.errors import TargetError

if TYPE_CHECKING:
    from rtrun.targets.link import Link

SCRIPT = ON_TARGET / "work_folder.sh"
_SHOWN_CHARACTERS = 400


def make(link: "Link") -> None:
    """Make the folder, or check that it is ours alone. Must come before anything is written or ended by its contents.

    Raises TargetError with the reason and the remedy.
    """
    folder, address = link.target.work_dir, link.target.address
    # Through standard input: nothing is deployed yet.
    refusal = link.check(["sh", "-s", str(folder)], stdin=SCRIPT.read_text(encoding="utf-8"))
    if not refusal:
        return
    user = address.user if isinstance(address, Address) else "this user"
    kind, _, why = refusal[:_SHOWN_CHARACTERS].rstrip().partition(" ")
    if kind == "foreign":
        raise TargetError(
            f"{address}: {folder} holds what rtrun did not make ({why}): "
            "name an empty or a new folder as work_dir in the target file"
        )
    own = f"/home/{user}/rt-tests" if isinstance(address, Address) and user != "root" else "/var/lib/rt-tests"
    if kind == "readonly":
        raise TargetError(
            f"{address}: {folder} cannot be written: {user} may not make or fill {why}: name a folder that {user} may "
            f"write to in a target file, as 'work_dir: {own}', or log in as root"
        )
    above = not why.startswith((f"{folder} ", "/ "))
    # A program that has a file open can write to it even after its rights were changed.
    remedy = ", or take that right away (chown, chmod go-w)" if above else "; to take that right away is not enough"
    raise TargetError(
        f"{address}: {folder}: others could replace what {user} runs from there: {why}: name a new folder where nobody "
        f"else may write in a target file, as 'work_dir: {own}'{remedy}"
    )
