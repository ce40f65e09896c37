"""Bodies and scenes that the tests are made of."""

from pathlib import Path

import gmsh

PLATE = Path(__file__).parent.parent / "demos" / "plate" / "plate.toml"


def write_box(path: Path, lengths: tuple[float, float, float], cells: tuple[int, int, int]) -> Path:
    """A box of tetrahedra with faces left/right (x), front/back (y), bottom/top (z) and volume "body" named."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        geo, (lx, ly, lz), (nx, ny, nz) = gmsh.model.geo, lengths, cells
        corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (lx, 0), (lx, ly), (0, ly))]
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        for line, count in zip(lines, (nx, ny, nx, ny), strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        bottom = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(bottom)
        extruded = geo.extrude([(2, bottom)], 0, 0, lz, numElements=[nz])
        geo.synchronize()
        (_, top), (_, volume), *sides = extruded
        names = ("front", "right", "back", "left")
        faces = {"bottom": bottom, "top": top} | {name: tag for name, (_, tag) in zip(names, sides, strict=True)}
        for name, tag in faces.items():
            gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag]), name)
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [volume]), "body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def scene_text(
    mesh: Path, *, contacts: str | None = None, damping: str = "alpha = 1.0, beta = 1e-3", **parts: str
) -> str:
    """A scene of a box held on its left; `parts` are further tables by heading, or replace these."""
    tables = {
        "mesh": f'file = "{mesh}"',
        "material": "young = 1.0e6\npoisson = 0.3\ndensity = 1000.0",
        "supports": 'clamped = ["left"]',
        "effects": f"inertia = {{}}\ndamping = {{ {damping} }}",
    } | parts
    contacts = contacts or '[contacts.right]\nsurface = "right"\n[contacts.top]\nsurface = "top"'
    return "\n".join(f"[{heading}]\n{body}" for heading, body in tables.items()) + "\n" + contacts
