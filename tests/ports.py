"""Ports that nobody uses, each given out once while its process lives, whichever test process of this machine asks."""

import errno
import random
import socket

# Below those that the kernel gives to connections: none takes one before its server listens.
PORTS = range(20_000, 32_000)
_given: list[socket.socket] = []


def free_port(host: str = "127.0.0.1") -> int:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in random.sample(PORTS, 1000):
        # The name of a socket belongs to one process of the machine, and is free again when that ends.
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0meta-rt-tests-port-{port}")
        except OSError:
            claim.close()
            continue
        _given.append(claim)
        with socket.socket(family) as probe:
            try:
                probe.bind((host, port))
            except OSError as error:
                # In another network namespace, whose ports nobody else uses.
                if error.errno != errno.EADDRNOTAVAIL:
                    continue
        return port
    raise OSError(f"of ports {PORTS.start} to {PORTS.stop - 1} none seems to be free")
