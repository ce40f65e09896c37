"""Makes diamond.msh and trunk.msh, the soft robots of demos/robots, from their published dimensions, mm.

    python meshes/robots.py

Published are the points that cables lead through, what is fixed, heights and masses (demos/robots/README.md). Sections
of the arms and of the trunk's core are ours, such that silicone of 1,070 kg/m3 has about the published mass.
"""

from collections.abc import Callable
from math import atan2, hypot, pi
from pathlib import Path

import gmsh

HERE = Path(__file__).parent


def diamond() -> list[int]:
    """Four arms of 22 x 22 mm from a column to elbows, where cables are tied, and on to a block that they carry."""
    occ = gmsh.model.occ
    parts = [occ.addBox(-15, -15, 10, 30, 30, 26), occ.addBox(-14, -14, 103, 28, 28, 22)]
    inner, elbow, upper = (12.0, 24.0), (99.0, 45.0), (6.0, 114.0)  # radius and height of an arm's middle line
    for quarter in range(4):
        for start, end in ((inner, elbow), (elbow, upper)):
            along, up = end[0] - start[0], end[1] - start[1]
            arm = occ.addBox(-11, -11, -11, hypot(along, up) + 22, 22, 22)
            occ.rotate([(3, arm)], 0, 0, 0, 0, 1, 0, -atan2(up, along))
            occ.translate([(3, arm)], start[0], 0, start[1])
            occ.rotate([(3, arm)], 0, 0, 0, 0, 0, 1, quarter * pi / 2)
            parts.append(arm)
    return parts


def trunk() -> list[int]:
    """A root of 20 mm, a core that tapers, and ten discs of 6 mm that eight cables lead through."""
    occ = gmsh.model.occ
    parts = [occ.addCylinder(0, 0, 0, 0, 0, 20, 13), occ.addCone(0, 0, 20, 0, 0, 175, 7.5, 3.5)]
    for k in range(10):
        cable = 10 - 0.7177 * k  # from the axis
        parts.append(occ.addCylinder(0, 0, 21 + 17.485 * k, 0, 0, 6, cable + 2.5))
    return parts


def write(name: str, make: Callable[[], list[int]], size: float, height: float) -> None:
    """Fuses the parts, names the faces that are wholly below a height "held", and meshes them."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    parts = make()
    gmsh.model.occ.fuse([(3, parts[0])], [(3, part) for part in parts[1:]])
    gmsh.model.occ.synchronize()
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    held = [tag for tag in faces if gmsh.model.getBoundingBox(2, tag)[5] <= height + 0.1]
    for dimension, tags, label in ((2, held, "held"), (3, [tag for _, tag in gmsh.model.getEntities(3)], "body")):
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, tags), label)
    for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(option, size)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(HERE / f"{name}.msh"))
    gmsh.finalize()


write("diamond", diamond, size=13.0, height=10.0)
write("trunk", trunk, size=8.0, height=20.0)
