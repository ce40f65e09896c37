"""What the scripts beside this file share: the paper's silicone cylinder, meshed as finely as asked for, and tables."""

from collections.abc import Mapping
from pathlib import Path

import gmsh
import numpy as np

from fenics_rom.scene.file import parse_scene
from fenics_rom.scene.scene import Scene

GEOMETRY = Path(__file__).parents[2] / "meshes" / "cylinder.geo"
RADIUS = 0.0075  # m
PAPER = 0.8  # size factor of a mesh like the paper's: 4,072 nodes, 11,997 unknowns
FINE = 0.5  # size factor from which on gmsh's fast algorithm is worth its slightly worse tetrahedra
HXT = 10  # gmsh's number for it
GOLDEN = (np.sqrt(5) - 1) / 2  # of a turn between a pair of contact patches and the next

SCENE = """
name = "cylinder"
[mesh]
file = "{file}"
[material]
young = 3.45e6      # Pa
poisson = 0.475
density = 1187.4    # kg/m3
[supports]
clamped = ["ends"]
[effects]
inertia = {{}}
damping = {{ alpha = 1.0, beta = 2e-3 }}   # 1/s, s
"""
CONTACT = """
[contacts.{name}]
near = {{ point = [{x}, {y}, {z}], radius = 0.008 }}   # m
"""


def mesh(file: Path, factor: float) -> None:
    """Writes a mesh of the cylinder; its tetrahedra are larger than the finest by `factor`."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(GEOMETRY))
        gmsh.option.setNumber("Mesh.MeshSizeFactor", factor)
        gmsh.option.setNumber("Mesh.Binary", 1)
        if factor < FINE:
            gmsh.option.setNumber("Mesh.Algorithm3D", HXT)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file.with_suffix(".part.msh")))
        file.with_suffix(".part.msh").replace(file)  # a file of that name is a whole one
    finally:
        gmsh.finalize()


def places(count: int) -> dict[str, list[float]]:
    """Centres of the first contact patches of a sequence that fills the cylinder evenly, along and around."""
    centres = {}
    for k in range(count):
        halved = sum(2.0 ** -(bit + 1) for bit in range(k.bit_length()) if k >> bit & 1)  # van der Corput's sequence
        along, angle = 0.1 + 0.4 * ((0.25 + halved) % 1), 2 * np.pi * GOLDEN * (k // 2)
        centres[f"at_{k}"] = [along, RADIUS * np.sin(angle), RADIUS * np.cos(angle)]
    return centres


def scene(file: Path, contacts: Mapping[str, list[float]]) -> Scene:
    """The cylinder between two clamps, with a contact mode for each centre of a patch."""
    text = SCENE.format(file=file.name)
    for name, (x, y, z) in contacts.items():
        text += CONTACT.format(name=name, x=x, y=y, z=z)
    return parse_scene(text, folder=file.parent, source="cylinder")
