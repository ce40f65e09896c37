"""Surfaces of triangles from files of VTK and STEP, which other programs read in a process of their own."""

import gmsh
import numpy as np
import pytest
from triangle_meshes import groove

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacles import Mesh
from fenics_rom.scene.surface_file import read_surface


def test_polygons_of_vtk_are_its_triangles(tmp_path):
    mesh, file = groove(0.5), tmp_path / "vee.vtk"
    with file.open("w") as stream:
        stream.write("# vtk DataFile Version 3.0\nvee\nASCII\nDATASET POLYDATA\n")
        stream.write(f"POINTS {len(mesh.vertices)} double\n")
        np.savetxt(stream, mesh.vertices, fmt="%.17g")
        stream.write(f"POLYGONS {len(mesh.triangles)} {4 * len(mesh.triangles)}\n")
        np.savetxt(stream, np.insert(mesh.triangles, 0, 3, axis=1), fmt="%d")
    read = Mesh(*read_surface(file).joined())
    assert read.surface.volume == pytest.approx(mesh.surface.volume, rel=1e-12)
    assert len(read.triangles) == len(mesh.triangles)
    file.write_text(file.read_text()[:200])
    with pytest.raises(SceneError, match=r"vee.vtk: mesh file .*vee.vtk: VTK cannot read it: it is damaged"):
        read_surface(file)


def block_without(file, tool):
    """A block of 30 by 20 by 10 mm, of which what a function adds to Gmsh's model is cut out."""
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("block")
        gmsh.model.occ.cut([(3, gmsh.model.occ.addBox(0, 0, 0, 30, 20, 10))], [(3, tool(gmsh.model.occ))])
        gmsh.model.occ.synchronize()
        gmsh.write(str(file))
    finally:
        gmsh.finalize()
    return Mesh(*read_surface(file).joined())


def test_a_hollow_in_a_solid_of_step_is_outside(tmp_path):
    mesh = block_without(tmp_path / "block.step", lambda model: model.addBox(10, 5, 3, 10, 10, 4))
    assert mesh.surface.volume == pytest.approx(6000e-9 - 400e-9, rel=1e-9)
    gaps, _ = mesh.distance(np.array([[15e-3, 10e-3, 5e-3], [5e-3, 5e-3, 5e-3]]))
    np.testing.assert_allclose(gaps, [2e-3, -5e-3], atol=1e-12)


def test_solids_of_step_are_in_metres_and_turned_outward(tmp_path):
    """With a hole of 10 mm, which has 48 sides at least."""
    mesh = block_without(tmp_path / "block.step", lambda model: model.addCylinder(15, 10, -1, 0, 0, 12, 5))
    hole, sides = 5e-3, 48
    polygon, circle = sides / 2 * hole**2 * np.sin(2 * np.pi / sides), np.pi * hole**2
    assert (600e-6 - circle) * 10e-3 < mesh.surface.volume < (600e-6 - polygon) * 10e-3
    assert not mesh.is_convex
    gaps, _ = mesh.distance(np.array([[15e-3, 10e-3, 5e-3], [5e-3, 5e-3, 5e-3], [35e-3, 10e-3, 5e-3]]))
    np.testing.assert_allclose(gaps, [hole * np.cos(np.pi / sides), -5e-3, 5e-3], atol=2e-5)
