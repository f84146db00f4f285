"""Ports and domains that nobody uses, each given out once, whichever test process asks; domains may be given back."""

import errno
import random
import socket

# Below those that the kernel gives to connections: none takes one before its server listens.
PORTS = range(20_000, 32_000)
# Of ROS 2: their ports are below those, too (7400 and 250 for each).
DOMAINS = range(1, 100)
_given: dict[str, socket.socket] = {}


def _claim(what: str) -> bool:
    """Whether it was free on this machine, and is ours from now on."""
    # The name of a socket belongs to one process of the machine, and is free again when that ends.
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0meta-rt-tests-{what}")
    except OSError:
        claim.close()
        return False
    _given[what] = claim
    return True


def free_domain() -> int:
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if _claim(f"domain-{domain}"):
            return domain
    raise OSError(f"of domains {DOMAINS.start} to {DOMAINS.stop - 1} none is free")


def give_back_domain(domain: int) -> None:
    """For others, now that its programs have ended: there are fewer domains than tests of four releases."""
    _given.pop(f"domain-{domain}").close()


def free_port(host: str = "127.0.0.1") -> int:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in random.sample(PORTS, 1000):
        if not _claim(f"port-{port}"):
            continue
        with socket.socket(family) as probe:
            try:
                probe.bind((host, port))
            except OSError as error:
                # In another network namespace, whose ports nobody else uses.
                if error.errno != errno.EADDRNOTAVAIL:
                    continue
        return port
    raise OSError(f"of ports {PORTS.start} to {PORTS.stop - 1} none seems to be free")
