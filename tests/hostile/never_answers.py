"""A file system (FUSE) with one file, "page", whose contents never come: never_answers.py HANDLE."""

import os
import struct
import sys

FILE_BYTES = 1 << 20
LOOK_UP, FORGET, ATTRIBUTES, OPEN, READ, INIT = 1, 2, 3, 14, 15, 26


def attributes(node):
    mode, size = (0o40755, 0) if node == 1 else (0o100444, FILE_BYTES)
    return struct.pack("6Q10I", node, size, size // 512, 0, 0, 0, 0, 0, 0, mode, 1, 65534, 65534, 0, 4096, 0)


def answer(opcode, node):
    if opcode == INIT:
        return struct.pack("2I", 7, 31).ljust(64, b"\0")
    if opcode == LOOK_UP:
        return struct.pack("4Q2I", 2, 0, 100, 100, 0, 0) + attributes(2)
    if opcode == ATTRIBUTES:
        return struct.pack("Q2I", 100, 0, 0) + attributes(node)
    if opcode == OPEN:
        return struct.pack("Q2I", 1, 0, 0)
    return None


def main(handle):
    while True:
        _, opcode, unique, node = struct.unpack_from("2I2Q", os.read(handle, FILE_BYTES))
        if opcode in (READ, FORGET):  # the latter needs no answer
            continue
        content = answer(opcode, node)
        unknown = -38 if content is None else 0
        os.write(handle, struct.pack("IiQ", 16 + len(content or b""), unknown, unique) + (content or b""))


main(int(sys.argv[1]))
