"""Whether sections of a Gmsh file hold what they say: Gmsh passes over what is beyond the number at their head."""

import re
import struct

from fenics_rom.errors import MeshError

# Nodes of an element, by Gmsh's number of its kind, of all kinds up to order two
ELEMENT_NODES = dict(enumerate((2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13), 1))


def check_sections(content: bytes, where: str) -> None:
    """Refuses a file of which nodes or elements are not as many as it says, or that ends among them.

    What is otherwise wrong is left to Gmsh.

    Args:
        content: of the file, of MSH format 2 or 4, in text or binary.
        where: the file, for the message.

    Raises:
        MeshError: with both numbers.
    """
    head = re.search(rb"^\$MeshFormat\s+(\d\.?\d*) +([01]) +\d+ *$", content, re.MULTILINE)
    if head is None:
        return
    if head[2] == b"1" and content[head.end() :].lstrip(b"\r\n")[:4] != b"\1\0\0\0":  # of another order of bytes
        return
    for what in ("Nodes", "Elements"):
        start = re.search(rb"^\$%b[ \r]*\n" % what.encode(), content, re.MULTILINE)
        if start is None:
            continue
        end = content.find(b"$End%b" % what.encode(), start.end())
        if end < 0:
            raise MeshError(f"{where}: ends within ${what}: it was cut, or not written to its end")
        body = content[start.end() : end]
        try:
            if head[2] == b"0":
                told, held = _in_text(body, float(head[1]), what)
            else:
                told, held = _in_binary(body, float(head[1]), what)
        except (ValueError, KeyError, struct.error):
            continue
        if told != held:
            raise MeshError(
                f"{where}: ${what} says {told} {what.lower()} and holds {held}: the file was cut or changed"
            )


def _in_text(body: bytes, version: float, what: str) -> tuple[int, int]:
    """Numbers that the head of a section says, and that its lines are of."""
    head, *lines = (line for line in body.split(b"\n") if line.strip())
    if version < 4:
        return int(head), len(lines)
    blocks, told = map(int, head.split()[:2])
    held = len(lines) - blocks
    return told, held // 2 if what == "Nodes" and version > 4 and held % 2 == 0 else held


def _in_binary(body: bytes, version: float, what: str) -> tuple[int, int]:
    """The same of a section that is one line of text and numbers in binary, or such numbers alone."""
    if version < 4:
        head, _, data = body.partition(b"\n")
        told, at = int(head), 0
        if what == "Nodes":
            return told, len(data) // 28
        layout, counted = "<iii", 1
    else:
        data, at = body, 32
        told = struct.unpack_from("<Q", body, 8)[0]
        layout, counted = "<iiiQ", 3
    held = 0
    while at + struct.calcsize(layout) <= len(data):
        block = struct.unpack_from(layout, data, at)
        if version < 4:
            size = 4 * (1 + block[2] + ELEMENT_NODES[block[0]])
        elif what == "Nodes":
            size = 8 * (4 + (block[0] if block[2] else 0))
        else:
            size = 8 * (1 + ELEMENT_NODES[block[2]])
        at += struct.calcsize(layout)
        held += min(block[counted], (len(data) - at) // size)
        at += block[counted] * size
    return told, held
