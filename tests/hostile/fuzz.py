"""Mutation fuzz of readers: whatever is in a file or comes from a target, the reader ends with a result or our error.

python tests/hostile/fuzz.py --seconds 3600 --seed 7
"""

import argparse
import random
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.plan.campaign import read_campaign
from rtrun.target import architecture, host_keys, inspection, ros_master, rt_readiness
from rtrun.target.address import Address
from rtrun.target.config import read_target

MEMORY_MIB = 300
INPUT_S = 20.0
TOP = Path(__file__).parents[2]
KEY = b"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIPJs62duJcZ1UDeiYfJh47Sob6aBR0zYBWGFxamj6gCK"
TOKENS = [b"\0", b"\xff", b"-1", b"9" * 5000, b"1e9999", b"\n", b"{", b"[" * 2000, b"\xc2\xb2", b"*", b"&a ", b": "]


def _known_hosts(path: Path) -> None:
    host_keys.read_host_keys(Address(host="board", known_hosts=(path,)))


def _state(path: Path) -> None:
    inspection.parse_state(path.read_text(errors="replace"))


def _facts(path: Path) -> None:
    rt_readiness.judge(rt_readiness.read_checks(), rt_readiness.parse(path.read_text(errors="replace")))


def _reply(path: Path) -> None:
    try:
        ros_master._parse_reply(path.read_bytes())
    except ValueError:
        return


def _certificate(path: Path) -> None:
    try:
        host_keys.parse_certificate(path.read_bytes())
    except ValueError:
        return


STATE = b"== governor\nperformance\n== threads\n12 (a) b) S " + b"0 " * 36 + b"95 1 0\n== machine\narmv7l\n"
FACTS = b"== kernel_version\n#1 SMP PREEMPT_RT\n== swap\n/dev/a x\n== threads\n99 program a\n"
REPLY = b"<methodResponse><params><param><value><array><data><value><int>1</int></value></data></array></value></param>"
READERS: dict[str, tuple[Callable[[Path], object], list[bytes]]] = {
    "known_hosts": (_known_hosts, [b"board,*.x " + KEY + b" me\n@revoked * " + KEY + b"\n|1|AAAA|AAAA " + KEY + b"\n"]),
    "target": (read_target, [path.read_bytes() for path in sorted((TOP / "targets").glob("*.yml"))]),
    "campaign": (read_campaign, [path.read_bytes() for path in sorted((TOP / "campaigns").glob("*.yml"))]),
    "state": (_state, [STATE]),
    "facts": (_facts, [FACTS]),
    "reply": (_reply, [REPLY]),
    "certificate": (_certificate, [b"\0\0\0\x20ssh-ed25519-cert-v01@openssh.com" + b"\0\0\0\4abcd" * 20]),
    "program": (lambda path: architecture.name(path.read_bytes()), [b"\x7fELF\2\1\1" + bytes(13)]),
}


def mutate(random_: random.Random, data: bytes) -> bytes:
    """Change, cut, repeat and insert at a few places."""
    for _ in range(random_.randint(1, 6)):
        start = random_.randint(0, len(data))
        end = min(len(data), start + random_.randint(0, 40))
        middle = random_.choice([b"", random_.choice(TOKENS), random_.randbytes(4), data[start:end] * 20])
        data = data[:start] + middle + data[end:]
    return data


def fuzz(seconds: float, seed: int) -> int:
    """Feed mutated files to every reader in turn; return how many. Whatever is no error of ours goes through."""
    random_, count, end = random.Random(seed), 0, time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "input"
        while time.monotonic() < end:
            for name, (read, seeds) in READERS.items():
                path.write_bytes(mutate(random_, random_.choice(seeds)))
                started = time.monotonic()
                try:
                    read(path)
                except (UsageError, InfrastructureError):
                    pass
                except BaseException as error:
                    error.add_note(f"reader {name}, seed {seed}, input {path.read_bytes()[:2000]!r}")
                    raise
                assert time.monotonic() - started < INPUT_S, (name, path.read_bytes()[:2000])
                count += 1
    # getrusage would tell the highest memory of the process that forked this one too.
    peak = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    assert peak is not None and int(peak[1]) < MEMORY_MIB * 1024
    return count


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"{fuzz(arguments.seconds, arguments.seed)} inputs")
