"""Bodies among meshes of files: full order and reduced, held and free, at rest, in batches, worlds and files."""

import gc

import numpy as np
import pytest
from bodies import box_arrays, write_arrays
from triangle_meshes import groove, write_stl
from turning import spin

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.compiled_pairs import CompiledPairs
from fenics_rom.mechanics.mesh_contact import MeshContact
from fenics_rom.scene.file import parse_scene

CLOSES_TO = 1e-12  # of the largest energy or work seen
VEE = """
[effects.contact.obstacles.vee]
shape = "mesh"
file = "vee.stl"
scale = 1e-3
position = [0.09, 0.025, -0.012]
[effects.friction]
coefficient = 0.3
"""
HELD = """
[mesh]
file = "box.msh"
[material]
young = 1e5
poisson = 0.3
density = 500.0
[supports]
clamped = ["left"]
[contacts.bottom]
surface = "bottom"
[contacts.right]
surface = "right"
[outputs.tip]
points = [[0.1, 0.0, 0.0]]
[effects]
inertia = {}
damping = { alpha = 1.0, beta = 1e-3 }
gravity = { acceleration = [0, 0, -60.0] }
[run]
dt = 1e-3
duration = 0.15
"""
AT_REST = HELD.replace("inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n", "")
FREE = HELD.replace('[supports]\nclamped = ["left"]\n', "").replace("-60.0", "-9.81")
pytestmark = pytest.mark.filterwarnings("ignore:the surface is")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A soft box, and a groove in mm."""
    folder = tmp_path_factory.mktemp("meshes")
    write_arrays(folder / "box.msh", *box_arrays((0.1, 0.05, 0.05), (4, 2, 2)))
    write_stl(folder / "vee.stl", groove(0.1), 500.0)
    return folder


def scene_of(folder, text, vee=VEE):
    return parse_scene(text.replace("[run]", f"{vee}\n[run]"), folder=folder)


@pytest.fixture(scope="module")
def held(folder):
    system = fr.assemble(scene_of(folder, HELD))
    return system, fr.reduce(system, order=16)


def check_account(run):
    totals = run.energy + run.dissipated + run.numerical - run.supplied
    scale = max(np.abs(each).max() for each in (run.energy, run.dissipated, run.supplied))
    assert np.abs(totals - totals[0]).max() <= CLOSES_TO * scale


def test_a_held_bar_is_pulled_into_a_groove(held, folder):
    """Reduced as at full order, with both accounts closed; no node of its contact surfaces gets in."""
    system, rom = held
    runs = [fr.simulate(model) for model in held]
    mesh = system.scene.environment.obstacles["vee"].shape
    for run in runs:
        check_account(run)
        touched = np.unique(np.concatenate([model.contact_points for model in rom.contact_models.values()]))
        gaps = mesh.distance((run.nodes + run.snapshots)[:, touched].reshape(-1, 3))[0]
        assert -1e-9 < gaps.min() < 1e-6
    apart = np.abs(runs[0].outputs["tip"] - runs[1].outputs["tip"]).max()
    assert apart < 0.01 * np.abs(runs[0].outputs["tip"]).max()


def test_a_mesh_travels_with_rom_and_run(held, folder, tmp_path):
    system, rom = held
    fr.write_rom(tmp_path / "bar.h5", rom)
    read = fr.read_rom(tmp_path / "bar.h5")
    mesh = system.scene.environment.obstacles["vee"].shape
    assert read.environment.obstacles["vee"].shape == mesh
    run = fr.simulate(read)
    fr.write_trajectory(tmp_path / "run.h5", run)
    assert fr.read_trajectory(tmp_path / "run.h5").obstacles["vee"] == mesh
    again = parse_scene(system.scene.text, tables=system.scene.tables)
    assert again.environment.obstacles["vee"].shape == mesh, "the file is not needed any more"


def test_a_batch_steps_as_a_simulator_does(held):
    _, rom = held
    single, bodies = fr.Simulator(rom, dt=2e-3), fr.Batch(rom, 2, 2e-3)
    assert isinstance(single.integrator.interface.solver, MeshContact)
    assert "not convex" in bodies.stepping
    u = np.zeros(bodies.inputs)
    for _ in range(40):
        single.step(u)
        bodies.step(u)
    np.testing.assert_array_equal(bodies.displacement("tip")[1], single.displacement("tip"))
    assert single.contact is not None


@pytest.mark.skipif(not compiled(), reason="numba is not installed")
@pytest.mark.parametrize("kind", ["held", "free, turning"])
def test_compiled_forces_are_those_of_numpy(held, folder, kind):
    """Step after step, each from where NumPy alone is."""
    rom, signals = held[1], None
    if kind != "held":
        vee = VEE.replace("0.09, 0.025, -0.012", "0.05, 0.025, -0.02").replace("scale", "motion = {}\nscale")
        rom = fr.reduce(fr.assemble(scene_of(folder, 'frame = "moving"\n' + FREE, vee)), order=8)
        signals = {"vee": spin([0.05, 0.025, -0.02], [0.6, 0.0, 0.8], 5.0, 0.01)}
    body = fr.Simulator(rom, 2e-3, signals=signals)
    with numpy_alone():
        other = fr.Simulator(rom, 2e-3, signals=signals)
    largest, touched = 1e-3, 0
    for _ in range(60):
        body.step(np.zeros(body.inputs))
        with numpy_alone():
            other.step(np.zeros(body.inputs))
        largest = max(largest, np.abs(other.contact_forces()).max())
        np.testing.assert_allclose(body.contact_forces(), other.contact_forces(), rtol=0, atol=1e-8 * largest)
        touched += other.integrator.contact is not None
    assert touched > 15
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-11)


@pytest.mark.skipif(not compiled(), reason="numba is not installed")
def test_a_step_does_not_keep_those_before_it(held):
    """What contact is told of a step may be asked until the next one; so few are kept, not all that touched."""
    body = fr.Simulator(held[1], dt=2e-3)
    touched = 0
    for _ in range(60):
        body.step(np.zeros(body.inputs))
        touched += body.integrator.contact is not None
    gc.collect()
    assert touched > 15
    assert sum(isinstance(each, CompiledPairs) for each in gc.get_objects()) < 10


def test_without_inertia_a_bar_lies_in_the_groove_at_once(folder):
    rom = fr.reduce(fr.assemble(scene_of(folder, AT_REST)), order=16)
    body = fr.Simulator(rom, dt=1e-3)
    for _ in range(3):
        body.step(np.zeros(body.inputs))
    assert body.contact is not None
    solver = body.integrator.interface.solver
    gaps = solver.gaps(body.displacement()[body.integrator.interface.points.nodes], np.zeros((1, 3)))
    assert -1e-9 < gaps.min() < 1e-9


def test_a_free_body_falls_into_a_groove_and_stays(folder):
    """At rest it moves by less than 1 um in 60 s, which is 1.6e-8 m in one; demos/feed/rest.py goes on for these."""
    vee = VEE.replace("0.09, 0.025, -0.012", "0.05, 0.025, -0.02")
    rom = fr.reduce(fr.assemble(scene_of(folder, 'frame = "moving"\n' + FREE, vee)), order=12)
    run = fr.simulate(rom)
    check_account(run)
    mesh = scene_of(folder, 'frame = "moving"\n' + FREE, vee).environment.obstacles["vee"].shape
    bottom = np.unique(np.flatnonzero(run.nodes[:, 2] < 1e-9))
    assert mesh.distance((run.nodes + run.snapshots)[:, bottom].reshape(-1, 3))[0].min() > -1e-9
    body, moved = fr.Simulator(rom, dt=1e-2), []
    for _ in range(300):
        body.step(np.zeros(body.inputs))
        moved.append(body.displacement())
    assert body.contact is not None
    assert np.linalg.norm(moved[-100:] - moved[-101], axis=2).max() < 1.6e-8


@pytest.mark.parametrize(
    ("vee", "says"),
    [
        (VEE.replace("vee.stl", "none.stl"), "obstacles.vee.file: surface .*none.stl: cannot be read: No such file"),
        (
            VEE.replace("vee.stl", "box.msh"),
            "obstacles.vee.file: surface .*box.msh: use a file that ends in .stl, .vtk",
        ),
        (VEE.replace('file = "vee.stl"\n', ""), "obstacles.vee: file is missing"),
        (VEE + "[effects.contact.obstacles.it]\nshape = 'sphere'\nfile = 'vee.stl'\n", "a sphere has center, radius"),
        (VEE.replace("scale", "size"), "obstacles.vee.size = "),
        (VEE.replace("vee.stl", "cut.stl"), "cut.stl: was cut: its text does not end with endsolid"),
        (VEE.replace("vee.stl", "open.stl"), r"obstacles.vee: mesh: is not closed: 3 of 24 edges .* open = true"),
        (VEE.replace("vee.stl", "inward.stl"), "obstacles.vee: mesh: is turned inside out, as it encloses -"),
        (VEE.replace("vee.stl", "empty.stl"), "empty.stl: holds no triangles"),
        (VEE.replace("vee.stl", "words.stl"), "words.stl: has vertices that are no three numbers"),
    ],
)
def test_what_is_no_mesh_is_refused_as_the_scene_is_read(folder, vee, says):
    text, triangle = (folder / "vee.stl").read_text(), "facet"
    facets = text.split(triangle + " ")
    (folder / "cut.stl").write_text(text[: len(text) // 2])
    (folder / "open.stl").write_text((triangle + " ").join(facets[:-1]) + "\nendsolid part\n")
    turned = [facet.split("vertex") for facet in facets]
    inward = ["vertex".join([f[0], f[2], f[1], f[3]]) if len(f) == 4 else f[0] for f in turned]
    (folder / "inward.stl").write_text((triangle + " ").join(inward))
    (folder / "empty.stl").write_text("solid part\nendsolid part\n")
    (folder / "words.stl").write_text(text.replace("vertex", "vertex x", 1))
    with pytest.raises(SceneError, match=says):
        scene_of(folder, HELD, vee)


def test_a_body_that_begins_in_a_mesh_is_refused(folder):
    system = fr.assemble(scene_of(folder, HELD, VEE.replace("-0.012", "-0.005")))
    with pytest.raises((SceneError, StepError), match=r"'vee' is 0.\d+ m inside the body at \[|m inside 'vee' is"):
        fr.reduce(system, order=8)


def test_binary_stl_is_what_its_text_is(folder):
    corners = (500 * groove(0.1).surface.vertices[groove(0.1).triangles]).astype("<f4")
    records = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = corners
    (folder / "binary.stl").write_bytes(b"\0" * 80 + np.array(len(corners), "<u4").tobytes() + records.tobytes())
    meshes = [
        scene_of(folder, HELD, VEE.replace("vee.stl", name)).environment.obstacles["vee"].shape
        for name in ("vee.stl", "binary.stl")
    ]
    np.testing.assert_allclose(meshes[0].vertices, meshes[1].vertices, rtol=1e-6)
    np.testing.assert_array_equal(meshes[0].triangles, meshes[1].triangles)
