"""Whether KVM can run a board here, found by a guest that ends at once.

A /dev/kvm alone proves nothing: a nested hypervisor may offer one whose guests never run an instruction.
"""

import functools
import subprocess
from pathlib import Path

from rtfiles.output import print_note

# Such a guest takes a second if KVM works, and never ends if KVM hangs.
DEADLINE_S = 10.0  # of QEMU on this machine


@functools.cache
def works(qemu: tuple[str, ...], kernel: Path) -> bool:
    """Whether QEMU, with arguments that ask for KVM, starts this kernel. If it does not, a note says so.

    The kernel gets no disk and has to restart when it panics, which ends the guest. Tried once per process.
    """
    command = ["setpriv", "--pdeathsig", "KILL", "--", *qemu, "-nodefaults", "-no-user-config", "-display", "none"]
    command += ["-no-reboot", "-kernel", str(kernel), "-append", "panic=-1"]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=DEADLINE_S, check=False
        )
    except subprocess.TimeoutExpired:
        obstacle = f"a guest that should end at once did not within {DEADLINE_S:g} s"
    else:
        if done.returncode == 0:
            return True
        words = done.stderr.strip().splitlines()
        obstacle = words[-1] if words else f"exit status {done.returncode} of {qemu[0]}"
    print_note(f"rtrun: KVM does not work here, QEMU emulates the processor instead ({obstacle})")
    return False
