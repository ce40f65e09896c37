"""Inputs that fuzzing found to break something, each with what is said of it now."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, scene_text, write_arrays
from rom_files import put, refusal, tampered

import fenics_rom as fr
from fenics_rom.errors import FileError, MeshError, SceneError, SolverError, StructureError
from fenics_rom.fem.mesh import _from_arrays, read_mesh
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.linearity import SurfaceGauges
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.reduction.balancing import balance
from fenics_rom.rom.rom import check_rom
from fenics_rom.runtime.linearity_monitor import ReducedGauges
from fenics_rom.scene.file import parse_scene

DATA = Path(__file__).parents[1] / "data"
RUN = 'dt = 0.01\nduration = 0.1\nload = [{{ contact = "right", table = "{}" }}]'


@pytest.mark.parametrize("table", ["/dev/zero", "pipe", "folder"])
def test_force_table_without_end_or_beginning_is_refused(tmp_path, table):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with pytest.raises(SceneError, match="cannot be read: is a folder or a device"):
        parse_scene(scene_text(Path("box.msh"), run=RUN.format(table)), folder=tmp_path)


def test_scene_without_end_is_refused():
    with pytest.raises(SceneError, match="/dev/zero: is "):
        fr.read_scene("/dev/zero")


@pytest.mark.parametrize("name", [300 * "x" + ".msh", "/dev/zero", "a\\u0000b.msh"])
def test_mesh_file_that_cannot_be_is_told(tmp_path, name):
    text = scene_text(Path("box.msh")).replace("box.msh", name)
    with pytest.raises(MeshError, match=r"^mesh file "):
        fr.assemble(parse_scene(text, folder=tmp_path))


@pytest.mark.parametrize("value", ["1e150", "1e51", "1e-51", "1e-320", "1.7e308"])
@pytest.mark.parametrize("there", ["young = 1.0e6", "density = 1000.0", "beta = 1e-3"])
def test_numbers_whose_products_are_none_are_refused(there, value):
    key = there.split(" = ")[0]
    text = scene_text(Path("box.msh")).replace(there, f"{key} = {value}")
    with pytest.raises(SceneError, match=re.escape(f"{key} = {float(value)!r}: use 0 or a size from 1e-50 to 1e+50")):
        parse_scene(text)


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_cell_of_a_node_that_there_is_not_is_refused(tmp_path, version):
    """Its place would have been taken by another node, in silence."""
    points, cells = box_arrays((1.0, 0.4, 0.3), (2, 1, 1))
    mesh = write_arrays(tmp_path / "box.msh", points, cells, version=version)
    text = mesh.read_text()
    gone = int(cells[0, 0]) + 1
    coordinates = " ".join(f"{x:.16g}" for x in points[gone - 1])
    if version == 2.2:
        assert f"\n{gone} {coordinates}\n" in text
        text = text.replace(f"\n{gone} {coordinates}\n", f"\n99 {coordinates}\n")
    else:
        start = text.index("$Nodes\n")
        head, rest = text[:start], text[start:]
        assert f"\n{gone}\n" in rest
        text = head + rest.replace(f"\n{gone}\n", "\n99\n", 1)
    mesh.write_text(text)
    with pytest.raises(MeshError):
        read_mesh(mesh, {})


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ({"cells4": np.array([[1, 2, 3, 4]])}, "nodes"),
        ({"dimensions": [2], "tags": [1], "names": ["left"], "group0": np.array([1, 2, 4])}, "nodes"),
        ({"dimensions": [3], "tags": [1], "names": ["body"], "group0": np.array([8])}, "cells"),
    ],
)
def test_node_or_cell_that_gmsh_does_not_miss_is_missed(more, what):
    """What Gmsh makes of some damaged files: a cell of a node that is not among the nodes."""
    points, nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([1, 2, 3, 5])
    whole = {"nodes": nodes, "points": points.ravel(), "others": [], "numbers": np.array([7]), "sizes": [4]}
    whole["quadrilaterals0"] = np.empty(0, dtype=int)
    whole |= {"cells4": nodes, "dimensions": [], "tags": [], "names": [], "edges": np.empty(0, dtype=int)}
    assert len(_from_arrays(whole, Path("whole.msh"), {})[1]) == 1
    with pytest.raises(MeshError, match=f"names {what} that it does not hold"):
        _from_arrays(whole | more, Path("hole.msh"), {})


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_binary_meshes_are_those_in_text(tmp_path, version):
    arrays = box_arrays((1.0, 0.4, 0.3), (3, 2, 1), shake=0.2)
    text, binary = (
        read_mesh(write_arrays(tmp_path / f"{name}.msh", *arrays, version=version, binary=name == "binary"), {})
        for name in ("text", "binary")
    )
    np.testing.assert_array_equal(binary.points, text.points)
    np.testing.assert_array_equal(binary.cells, text.cells)
    for name, surface in text.surfaces.items():
        np.testing.assert_array_equal(binary.surface(name), surface)


def test_tags_of_nodes_may_be_any_numbers(tmp_path):
    """As large as in meshes that were cut out of larger ones; nothing is reserved up to the largest."""
    points, cells = box_arrays((1.0, 0.4, 0.3), (2, 1, 1))
    plain = write_arrays(tmp_path / "plain.msh", points, cells, version=2.2)
    text = plain.read_text()
    last = len(points)
    coordinates = " ".join(f"{x:.16g}" for x in points[-1])
    far = text.replace(f"\n{last} {coordinates}\n", f"\n2000000000 {coordinates}\n")
    start, end = far.index("$Elements\n"), far.index("$EndElements")
    far = far[:start] + re.sub(rf"(?m)(?<= ){last}(?=( \d+)*$)", "2000000000", far[start:end]) + far[end:]
    assert far.count("2000000000") > 2
    (tmp_path / "far.msh").write_text(far)
    one, other = (read_mesh(tmp_path / f"{name}.msh", {}) for name in ("plain", "far"))
    np.testing.assert_array_equal(other.points[other.cells], one.points[one.cells])


def test_body_in_two_parts_is_told_which_is_not_held(tmp_path):
    """Nodes twice at one place are a cut through the body; the part beyond it moves freely."""
    points, cells = box_arrays((1.0, 0.4, 0.3), (4, 2, 2))
    surfaces = box_surfaces(points, cells)
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    at_cut = np.flatnonzero(np.isclose(points[:, 0], 0.5))
    moved = np.arange(len(points))
    moved[at_cut] = len(points) + np.arange(len(at_cut))
    cut = np.concatenate([cells[~right], moved[cells[right]]])
    faces = {"left": surfaces["left"], "right": moved[surfaces["right"]]}
    mesh = write_arrays(tmp_path / "cut.msh", np.concatenate([points, points[at_cut]]), cut, faces)
    contacts = "[contacts.near]\nnear = { point = [0.25, 0.2, 0.3], radius = 0.2 }"
    assert assembled(mesh, contacts=contacts).rigid.shape[1] == 6
    assert assembled(mesh, contacts=contacts, supports='clamped = ["left", "right"]').rigid.shape[1] == 0


def test_damping_whose_squares_overflow_is_refused_or_taken(tmp_path):
    rom = fr.read_rom(DATA / "rom-1.0.h5")
    name, mode = next(iter(rom.contact_models.items()))
    D = 1e200 * (np.eye(mode.order) + np.ones((mode.order, mode.order)))
    assert check_rom(replace(rom, contact_models={name: replace(mode, damping=D)}))
    with pytest.raises(StructureError, match="damping is not positive semi-definite, least -5e"):
        check_rom(replace(rom, contact_models={name: replace(mode, damping=-D)}))


@pytest.mark.parametrize("scale", [1e-200, 1e-120, 1e120, 1e200, 1e308])
def test_surfaces_and_motions_beyond_measure_have_gauges(scale):
    """What cannot be measured is not looked at; what turns beyond all numbers is never safe."""
    points, cells = box_arrays((1.0, 0.4, 0.3), (1, 1, 1))
    triangles = box_surfaces(points, cells)["top"]
    with np.errstate(all="ignore"):
        assert len(SurfaceGauges(scale * points, triangles).triangles) == 0
    rows = np.ones((6, 2))
    gauge, plain = ReducedGauges(scale * rows, np.ones(2)), ReducedGauges(rows, np.ones(2))
    assert gauge.safe_energy == pytest.approx(plain.safe_energy / scale / scale if scale < 1e150 else 0.0)
    assert ReducedGauges(np.full((6, 2), np.inf), np.ones(2)).safe_energy == 0.0


def test_gramians_that_vanish_are_told():
    with pytest.raises(SolverError, match="the Gramians vanish"):
        balance(np.zeros((3, 2)), np.ones((3, 2)))


@pytest.mark.parametrize("sums", [[np.inf, -np.inf, 1.0], [1.7e308, 1.7e308, -np.inf, 1.0], [np.nan, 1.0]])
def test_energies_beyond_all_numbers_are_booked_as_such(sums):
    ledger = EnergyLedger()
    for J in sums:
        ledger.book(lost_in_switching=J)
    assert not np.isfinite(ledger.lost_in_switching)


def test_contact_without_a_node_to_touch_is_refused(tmp_path):
    rom = fr.read_rom(DATA / "rom-1.2.h5")
    modes = {name: replace(mode, contact_points=np.empty(0, dtype=int)) for name, mode in rom.contact_models.items()}
    with pytest.raises(FileError, match="has contact, and no node that obstacles can touch"):
        fr.write_rom(tmp_path / "rom.h5", replace(rom, contact_models=modes))


def test_step_after_which_nothing_has_moved_is_said_to_be_long():
    gauge = TimeStepMonitor()
    gauge.add(changed=1.0, moved=0.0)
    assert "some inf % too long" in gauge.message


def test_name_that_would_break_a_line_is_refused(tmp_path):
    file = tmp_path / "rom.h5"
    fr.write_rom(file, fr.read_rom(DATA / "rom-1.0.h5"))
    said = refusal(fr.read_rom, tampered(file, put("two\nlines\x1b[31m", [1.0])))
    assert said.endswith(r"unexpected 'two\nlines\x1b[31m' in /")
