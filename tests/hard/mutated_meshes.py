"""Gmsh files that are damaged or were never right, reproducible by seed."""

import sys
from pathlib import Path

import numpy as np
from mutated_files import refused

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes

sys.path.append(str(Path(__file__).parents[1]))
from bodies import box_arrays, write_arrays

FORMATS = ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1))  # version, and whether it is binary
NUMBERS = (
    b"0",
    b"-1",
    b"1",
    b"2",
    b"4",
    b"99",
    b"1000000000",
    b"99999999999999999999",
    b"nan",
    b"inf",
    b"1e300",
    b"x",
    b"",
)
originals: dict[tuple[float, int], bytes] = {}


def prepare(folder: Path) -> None:
    """A box in every format."""
    for version, binary in FORMATS:
        arrays = box_arrays((1.0, 0.4, 0.3), (2, 1, 1))
        originals[version, binary] = write_arrays(
            folder / "box.msh", *arrays, version=version, binary=bool(binary)
        ).read_bytes()


def mutated(random: np.random.Generator) -> tuple[str, bytes]:
    """What was done, and the file."""
    version, binary = FORMATS[random.integers(len(FORMATS))]
    content = originals[version, binary]
    way = random.integers(4)
    if way == 0:
        cut = int(random.integers(len(content)))
        return f"{version} {'binary' if binary else 'text'}, cut at {cut}", content[:cut]
    data = bytearray(content)
    if way == 1 or binary:
        for at in random.integers(len(data), size=random.integers(1, 5)):
            data[at] = random.choice([random.integers(256), 0, 255, data[at] ^ (1 << random.integers(8))])
        return f"{version} {'binary' if binary else 'text'}, bytes", bytes(data)
    lines = content.split(b"\n")
    for _ in range(random.integers(1, 4)):
        at, other = random.integers(len(lines), size=2)
        if way == 2:
            words = lines[at].split(b" ")
            words[random.integers(len(words))] = NUMBERS[random.integers(len(NUMBERS))]
            lines[at] = b" ".join(words)
        elif random.random() < 0.5:
            lines.insert(int(other), lines[at])
        else:
            del lines[at]
    return f"{version} text, {'words' if way == 2 else 'lines'}", b"\n".join(lines)


def outcome(content: bytes, folder: Path) -> str:
    """Reads a mesh, and numbers its nodes."""
    file = folder / "mutated.msh"
    file.write_bytes(content)
    try:
        mesh = read_mesh(file, {})
        canonical_nodes(mesh, 2)
    except MeshError as error:
        return refused(error, MeshError)
    assert len(mesh.cells)
    for group in (*mesh.surfaces.values(), *mesh.regions.values()):
        assert group.dtype == np.int64
    return "read"
