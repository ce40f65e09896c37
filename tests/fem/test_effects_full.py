"""Effects on the full-order model: forces add up, and what a hand calculation says comes out; of the ROM, too."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, dense, scene_text, write_arrays
from scipy.spatial.transform import Rotation

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import HalfSpace

EXACT = 1e-10  # degree 2 holds the exact solution: what is left is the round-off of solves
YOUNG, DENSITY, GRAVITY = 1e6, 1000.0, 9.81
LENGTHS = LENGTH, WIDTH, HEIGHT = 1.0, 0.1, 0.2
AREA, MASS = WIDTH * HEIGHT, DENSITY * LENGTH * WIDTH * HEIGHT
NO_POISSON = f"young = {YOUNG}\npoisson = 0.0\ndensity = {DENSITY}"  # a bar that is pulled does not thin
RIGHT = '[contacts.right]\nsurface = "right"'
ENDS = {
    "outputs.left": 'surface = "left"',
    "outputs.right": 'surface = "right"',
    "outputs.middle": "points = [[0.5, 0.05, 0.1]]",
}
BOTTOM = '[contacts.bottom]\nsurface = "bottom"'
FREE = {"supports": None}
BOTH = pytest.mark.parametrize("model", ["full", "reduced"])
FULL = pytest.mark.parametrize("model", ["full", pytest.param("reduced", marks=pytest.mark.slow)])


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A straight bar of tetrahedra."""
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays(LENGTHS, (2, 1, 2)))


@pytest.fixture(scope="module")
def hollow(tmp_path_factory):
    """A cube of 0.3 m with a chamber of any shape inside, and the surface "chamber"."""
    points, cells = box_arrays((0.3, 0.3, 0.3), (3, 3, 3), shake=0.2)
    brick = np.arange(len(cells)) % 27
    cells = cells[brick != 13]  # the one in the middle
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    outer = box_surfaces(points, cells)
    known = np.unique(np.sort(np.concatenate(list(outer.values())), axis=1), axis=0)
    skin = unique[count == 1]
    inner = skin[~(skin[:, None] == known).all(axis=2).any(axis=1)]
    assert len(inner) == 12
    return write_arrays(tmp_path_factory.mktemp("hollow") / "hollow.msh", points, cells, outer | {"chamber": inner})


def beam(bar, effects, degree=2, contacts=RIGHT, **parts):
    """The scene of the bar without Poisson's effect."""
    return acted_on(bar, effects, degree=degree, contacts=contacts, **({"material": NO_POISSON} | ENDS | parts))


def reduced(system, **choices):
    """The ROM; orders that are not numerically there are no matter."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, **choices)


def run_of(scene, model, **choices):
    """The run of a scene: of the full model, or of a ROM that has all that is there."""
    system = fr.assemble(scene)
    if model == "full":
        return fr.simulate(system, **choices)
    order = {} if scene.effects.inertia is None else {"order": system.size}
    return fr.simulate(reduced(system, **order), **choices)


def resultant(system, columns):
    """Sum of the nodal forces of each column, (columns, 3)."""
    return np.stack([columns[system.body.free % 3 == axis].sum(axis=0) for axis in range(3)], axis=1)


def forces_of(system, column):
    """Nodal forces of one column, (N, 3)."""
    forces = np.zeros(3 * len(system.body.nodes))
    forces[system.body.free] = column
    return forces.reshape(-1, 3)


# --- gravity ---------------------------------------------------------------------------------------------------------

STILL = {"run": "dt = 0.1\nduration = 0.1"}


@pytest.mark.parametrize("degree", [1, 2])
def test_weight_adds_up_in_the_middle_of_the_body(bar, degree):
    scene = beam(bar, "inertia = {}\ngravity = { acceleration = [1.0, -2.0, 2.0] }", degree=degree, **FREE)
    system = fr.assemble(scene)
    weight = system.input_matrix("right")[:, -1]
    np.testing.assert_allclose(resultant(system, weight[:, None])[0], MASS * np.array([1.0, -2.0, 2.0]), rtol=1e-12)
    moment = np.cross(system.body.nodes, forces_of(system, weight)).sum(axis=0)
    middle = np.array(LENGTHS) / 2
    np.testing.assert_allclose(moment, np.cross(middle, MASS * np.array([1.0, -2.0, 2.0])), rtol=1e-12)


@BOTH
def test_bar_that_hangs_under_its_weight(bar, model):
    """u = ρ g (L x - x²/2)/E; a weight that is put on slowly does half of its work, and all of it is stored."""
    run = run_of(beam(bar, f"gravity = {{ acceleration = [{GRAVITY}, 0, 0] }}", **STILL), model)
    tip = DENSITY * GRAVITY * LENGTH**2 / (2 * YOUNG)
    assert tip == pytest.approx(4.905e-3)
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [tip, 0, 0], atol=EXACT * tip)
    np.testing.assert_allclose(run.outputs["middle"][-1, 0], [tip * 0.75, 0, 0], atol=EXACT * tip)
    stored = (DENSITY * GRAVITY) ** 2 * AREA * LENGTH**3 / (6 * YOUNG)
    assert run.energy[-1] == pytest.approx(stored, rel=EXACT)
    assert run.supplied[-1] == pytest.approx(stored, rel=EXACT)
    assert run.dissipated[-1] == run.numerical[-1] == 0
    assert run.effects == ("gravity",)


@BOTH
def test_springs_under_a_hanging_bar_carry_its_weight(bar, model):
    """k times the mean displacement of the surface that they hold is the reaction, m g."""
    springs = '[effects.springs.hook]\nsurface = "left"\nstiffness = 5e3'
    run = run_of(beam(bar, f"gravity = {{ acceleration = [{GRAVITY}, 0, 0] }}\n{springs}", **FREE, **STILL), model)
    left = MASS * GRAVITY / 5e3
    np.testing.assert_allclose(run.outputs["left"][-1, 0], [left, 0, 0], atol=EXACT * left)
    tip = left + DENSITY * GRAVITY * LENGTH**2 / (2 * YOUNG)
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [tip, 0, 0], atol=EXACT * tip)
    stored = (MASS * GRAVITY) ** 2 / 5e3 / 2 + (DENSITY * GRAVITY) ** 2 * AREA * LENGTH**3 / (6 * YOUNG)
    assert run.energy[-1] == pytest.approx(stored, rel=EXACT)  # what springs hold is part of it


@BOTH
def test_free_fall(bar, model):
    effects = f"inertia = {{}}\ngravity = {{ acceleration = [0, 0, {-GRAVITY}] }}\ndamping = {{ beta = 1e-3 }}"
    run = run_of(beam(bar, effects, degree=1, **FREE, run="dt = 0.01\nduration = 0.5"), model)
    fallen = np.array([0, 0, -GRAVITY / 2]) * run.times[:, None] ** 2
    assert np.abs(run.outputs["middle"][:, 0] - fallen).max() <= EXACT * GRAVITY / 8
    assert run.energy[-1] == pytest.approx(MASS / 2 * (GRAVITY * 0.5) ** 2, rel=EXACT)
    assert run.balance_error <= 1e-12


# --- loads and actuators ---------------------------------------------------------------------------------------------


@BOTH
def test_force_on_a_surface_stretches_the_bar(bar, model):
    """F L/(E A), and the work of a force that grows with it is half of F times it."""
    load = '[effects.prescribed.pull]\nsurface = "right"\nforce = [40.0, 0, 0]'
    run = run_of(beam(bar, load, **STILL), model)
    tip = 40.0 * LENGTH / (YOUNG * AREA)
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [tip, 0, 0], atol=EXACT * tip)
    assert run.supplied[-1] == pytest.approx(20.0 * tip, rel=EXACT)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("point", [(0.6, 0.03, 0.07), (1.0, 0.1, 0.2)])
def test_force_at_a_point_acts_there(bar, degree, point):
    load = f"[effects.prescribed.push]\npoint = {list(point)}"
    system = fr.assemble(beam(bar, load, degree=degree, **FREE))
    columns = system.loads["push"]
    np.testing.assert_allclose(resultant(system, columns), np.eye(3), atol=1e-13)
    for column, force in zip(columns.T, np.eye(3), strict=True):
        moment = np.cross(system.body.nodes, forces_of(system, column)).sum(axis=0)
        np.testing.assert_allclose(moment, np.cross(point, force), atol=1e-13)


@BOTH
def test_work_of_a_force_at_a_point_is_force_times_its_way(bar, model):
    effects = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
    load = "[effects.prescribed.push]\npoint = [0.7, 0.02, 0.15]\nforce = [1.0, 2.0, -3.0]"
    there = {"outputs.there": "points = [[0.7, 0.02, 0.15]]", "run": "dt = 0.01\nduration = 0.5"}
    run = run_of(beam(bar, effects + load, degree=1, **there), model)
    work = run.outputs["there"][:, 0] @ [1.0, 2.0, -3.0]
    assert np.abs(run.supplied - work).max() <= EXACT * np.abs(work).max()
    assert run.balance_error <= 1e-12


@pytest.mark.parametrize("degree", [1, 2])
def test_pressure_in_a_chamber_is_in_balance(hollow, degree):
    """Whatever its shape: no resultant and no moment; but along any affine motion the work p times the volume's."""
    pressure = '[effects.pressure.air]\nsurface = "chamber"'
    scene = acted_on(hollow, f"inertia = {{}}\n{pressure}", degree=degree, contacts=RIGHT, **FREE)
    system = fr.assemble(scene)
    air = system.input_matrix("right")[:, -1]
    forces = forces_of(system, air)
    size = np.abs(forces).sum()
    assert np.abs(forces.sum(axis=0)).max() <= 1e-14 * size
    assert np.abs(np.cross(system.body.nodes, forces).sum(axis=0)).max() <= 1e-14 * size
    volume = np.prod([0.3, 0.3, 0.3]) - system.body.node_mass.sum() / DENSITY
    assert volume == pytest.approx(1e-3, rel=0.5)
    gradient = np.random.default_rng(0).standard_normal((3, 3))
    work = (forces * (system.body.nodes @ gradient.T)).sum()
    assert work == pytest.approx(np.trace(gradient) * volume, rel=1e-11)


@BOTH
def test_pressure_on_the_end_shortens_the_bar(bar, model):
    """p L/E, by p A at the end; the input is in Pa."""
    pressure = '[effects.pressure.wind]\nsurface = "right"'
    push = {"run": 'dt = 0.1\nduration = 0.1\nload = [{ actuator = "wind", force = [250.0] }]'}
    scene = beam(bar, pressure, **push)
    run = run_of(scene, model)
    tip = -250.0 * LENGTH / YOUNG
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [tip, 0, 0], atol=EXACT * abs(tip))
    system = fr.assemble(scene)
    np.testing.assert_allclose(
        resultant(system, system.input_matrix("right")[:, -1:])[0], [-AREA, 0, 0], atol=1e-13 * AREA
    )


PULLED = 'dt = 0.1\nduration = 0.1\nload = [{ actuator = "rope", force = [40.0] }]'


@BOTH
def test_straight_cable_shortens_the_bar(bar, model):
    """The mean of the end goes by T L/(E A), wherever on it the cable ends (Betti)."""
    cable = "[effects.tendon.rope]\npoints = [[0.0, 0.03, 0.12], [1.0, 0.03, 0.12]]"
    run = run_of(beam(bar, cable, run=PULLED), model)
    tip = -40.0 * LENGTH / (YOUNG * AREA)
    assert run.outputs["right"][-1, 0, 0] == pytest.approx(tip, rel=EXACT)


@pytest.mark.parametrize("degree", [1, 2])
def test_cable_pulls_its_ends_and_its_guides(bar, degree):
    """T e at the ends, T (e₁ + e₂) at a guide, no resultant and no moment, and the work of T along its shortening."""
    points = np.array([[0.0, 0.0, 0.0], [0.5, 0.1, 0.1], [1.0, 0.1, 0.0], [1.0, 0.02, 0.2]])
    cable = f"inertia = {{}}\n[effects.tendon.rope]\npoints = {points.tolist()}"
    system = fr.assemble(beam(bar, cable, degree=degree, **FREE))
    forces = forces_of(system, system.input_matrix("right")[:, -1])
    pieces = np.diff(points, axis=0)
    e = pieces / np.linalg.norm(pieces, axis=1)[:, None]
    for point, force in zip(points[:3], (e[0], e[1] - e[0], e[2] - e[1]), strict=True):
        node = np.linalg.norm(system.body.nodes - point, axis=1).argmin()
        np.testing.assert_allclose(forces[node], force, atol=1e-14)
    assert np.abs(forces.sum(axis=0)).max() <= 1e-13
    assert np.abs(np.cross(system.body.nodes, forces).sum(axis=0)).max() <= 1e-13
    gradient = np.random.default_rng(1).standard_normal((3, 3))
    work = (forces * (system.body.nodes @ gradient.T)).sum()
    lengthening = np.einsum("pi,ij,pj->", e, gradient, pieces)
    assert work == pytest.approx(-lengthening, rel=1e-12)


# --- springs, dampers ------------------------------------------------------------------------------------------------


@BOTH
def test_block_on_springs_gives_way_by_force_over_stiffness(bar, model):
    springs = '[effects.springs.bed]\nsurface = "bottom"\nstiffness = 2e3\n'
    load = '[effects.prescribed.push]\nsurface = "bottom"\nforce = [3.0, 4.0, -20.0]'
    bottom = {"outputs.bottom": 'surface = "bottom"'}
    run = run_of(beam(bar, springs + load, degree=1, **bottom, **FREE, **STILL), model)
    moved = np.array([3.0, 4.0, -20.0]) / 2e3
    np.testing.assert_allclose(run.outputs["bottom"][-1, 0], moved, atol=EXACT * 1e-2)


@BOTH
def test_weight_on_the_end_of_a_hanging_bar_draws_it_out(bar, model):
    """m g L/(E A) beside the bar's own; it acts where it is fixed, whatever the thread."""
    masses = (
        '[effects.point_masses.plate]\nsurface = "right"\nmass = 3.0\n'
        '[effects.point_masses.hung]\nsurface = "right"\nmass = 2.0\ndirection = [-4, 0, 0]\n'
    )
    run = run_of(beam(bar, f"gravity = {{ acceleration = [{GRAVITY}, 0, 0] }}\n{masses}", **STILL), model)
    tip = DENSITY * GRAVITY * LENGTH**2 / (2 * YOUNG) + 5.0 * GRAVITY * LENGTH / (YOUNG * AREA)
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [tip, 0, 0], atol=EXACT * tip)


def test_masses_fixed_to_a_body_add_up(bar):
    """Along any translation: m, of a thread m n nᵀ; and a heavy one on a bar oscillates as β tan β = bar's mass/m."""
    masses = """inertia = {}
        [effects.point_masses.knob]
        point = [0.7, 0.03, 0.11]
        mass = 0.5
        [effects.point_masses.plate]
        surface = "right"
        mass = 2.0
        [effects.point_masses.hung]
        point = [0.2, 0.1, 0.2]
        mass = 4.0
        direction = [3, 0, 4]"""
    with_them, without = (fr.assemble(beam(bar, effects, **FREE)) for effects in (masses, "inertia = {}"))
    n = with_them.size
    added = dense(with_them.mass, n) - dense(without.mass, n)
    shift = np.kron(np.ones((n // 3, 1)), np.eye(3))
    along = np.array([0.6, 0, 0.8])
    np.testing.assert_allclose(shift.T @ added @ shift, 2.5 * np.eye(3) + 4 * np.outer(along, along), atol=1e-12)
    moments = np.kron(with_them.body.nodes[:, :1], np.eye(3)).T @ added @ shift  # Σ m x of where they are
    expected = (0.35 + 2 * LENGTH) * np.eye(3) + 0.8 * np.outer(along, along)
    np.testing.assert_allclose(moments, expected, atol=1e-12)
    assert np.linalg.eigvalsh(added)[0] >= -1e-12
    heavy = f'inertia = {{}}\n[effects.point_masses.m]\nsurface = "right"\nmass = {1000 * MASS}\ndirection = [1, 0, 0]'
    system = fr.assemble(beam(bar, heavy))
    γ = system.algebra.eigenpairs(system.mass, system.stiffness, 3)[0]  # the others: it turns about y and z
    β = np.sqrt(γ * DENSITY / YOUNG) * LENGTH
    assert np.abs(β * np.tan(β) / 1e-3 - 1).min() <= 1e-6


PART = """
[effects.rigid_parts.camera]
surface = "right"
mass = 0.4
center = [1.3, 0.1, 0.25]
inertia = [2e-3, 3e-3, 4e-3]
"""


@pytest.mark.parametrize("degree", [1, 2])
def test_rigid_part_has_the_energy_of_a_rigid_body_however_far_it_is_turned(bar, degree):
    """½ m v² of its centre and ½ ωᵀ R I Rᵀ ω, of nodes that move as v + ω x (R X); and its weight is at its centre."""
    system, without = (fr.assemble(beam(bar, f"inertia = {{}}\n{part}", degree, **FREE)) for part in (PART, ""))
    added = dense(system.mass, system.size) - dense(without.mass, system.size)
    rng = np.random.default_rng(4)
    for turn in (np.zeros(3), rng.standard_normal(3)):
        R = Rotation.from_rotvec(turn).as_matrix()
        velocity, ω = rng.standard_normal((2, 3))
        v = (velocity + np.cross(ω, system.body.nodes @ R.T)).ravel()
        at_centre = velocity + np.cross(ω, R @ [1.3, 0.1, 0.25])
        expected = 0.4 * at_centre @ at_centre + ω @ R @ np.diag([2e-3, 3e-3, 4e-3]) @ R.T @ ω
        assert v @ added @ v == pytest.approx(expected, rel=1e-11)
    weighed, alone = (
        fr.assemble(beam(bar, f"inertia = {{}}\ngravity = {{ acceleration = [1, -2, 2] }}\n{part}", degree, **FREE))
        for part in (PART, "")
    )
    force = forces_of(system, weighed.input_matrix("right")[:, -1] - alone.input_matrix("right")[:, -1])
    np.testing.assert_allclose(force.sum(axis=0), [0.4, -0.8, 0.8], atol=1e-11)
    moment = np.cross(system.body.nodes, force).sum(axis=0)
    np.testing.assert_allclose(moment, np.cross([1.3, 0.1, 0.25], [0.4, -0.8, 0.8]), atol=1e-11)


def test_rigid_part_on_a_beam_that_bends_far_keeps_the_account(bar):
    """Its mass matrix stays as the body turns, so that a push and its weight are all that is supplied."""
    effects = f"""inertia = {{}}
        gravity = {{ acceleration = [0, 0, -5] }}
        large_deformation = {{ material = "neo_hookean" }}
        {PART}"""
    push = 'dt = 0.02\nduration = 0.3\nload = [{ contact = "right", force = [0, -900, 0] }]'
    run = run_of(beam(bar, effects, 1, run=push), "full")
    assert np.linalg.norm(run.outputs["right"][-1, 0]) > 0.2 * LENGTH
    missing = run.energy - run.supplied + run.dissipated
    assert np.abs(missing).max() <= 1e-11 * np.abs(run.supplied).max()


def test_rigid_part_in_another_unit_is_refused(bar):
    with pytest.raises(SceneError, match=r"camera.center = .* m from its surface; at most 10 sizes"):
        fr.assemble(beam(bar, f"inertia = {{}}\n{PART}".replace("[1.3, 0.1, 0.25]", "[1300, 100, 250]")))


def test_rigid_part_swings_as_a_stiff_block_does(tmp_path):
    """The first two oscillations of a beam that ends in a block 10,000 times as stiff, which also keeps the face from
    straining: 0.13 % and 0.56 % (and 2.3 % of the first torsion, whose warping it hinders)."""
    lengths = (1.3, WIDTH, HEIGHT)
    points, cells = box_arrays(lengths, (13, 1, 2))
    block = points[cells].mean(axis=1)[:, 0] > LENGTH
    whole = write_arrays(
        tmp_path / "whole.msh", points, cells, regions={"beam": np.flatnonzero(~block), "block": np.flatnonzero(block)}
    )
    stiff: dict[str, str | None] = {"material": None}
    for name, young in (("beam", YOUNG), ("block", 1e4 * YOUNG)):
        stiff[f"materials.{name}"] = f'cells = "{name}"\nyoung = {young}\npoisson = 0.0\ndensity = {DENSITY}'
    a, b, c = 0.3, WIDTH, HEIGHT
    m = DENSITY * a * b * c
    part = f"""inertia = {{}}
        [effects.rigid_parts.block]
        surface = "right"
        mass = {m}
        center = [1.15, {b / 2}, {c / 2}]
        inertia = [{m * (b * b + c * c) / 12}, {m * (a * a + c * c) / 12}, {m * (a * a + b * b) / 12}]"""
    short = write_arrays(tmp_path / "short.msh", *box_arrays(LENGTHS, (10, 1, 2)))
    frequencies = []
    for mesh, effects, parts in ((whole, "inertia = {}", stiff), (short, part, {})):
        system = fr.assemble(beam(mesh, effects, **parts, **dict.fromkeys(ENDS)))
        frequencies.append(np.sqrt(system.algebra.eigenpairs(system.mass, system.stiffness, 2)[0]))
    assert np.abs(frequencies[1] / frequencies[0] - 1).max() <= 0.01


def test_weight_on_a_thread_stays_where_it_is_when_the_support_is_shaken_across(bar):
    """A base motion carries n nᵀ d of it, and gravity all of it."""
    hung = "[effects.point_masses.hung]\npoint = [0.7, 0.03, 0.11]\nmass = 4.0\ndirection = [3, 0, 4]"
    for load, expected in (
        ("base_motion = { shaken = { direction = [1, 0, 0] } }", -4 * np.array([0.36, 0, 0.48])),
        ("base_motion = { shaken = { direction = [0, 2, 0] } }", np.zeros(3)),
        ("gravity = { acceleration = [1, 0, 0] }", np.array([4.0, 0, 0])),
    ):
        effects = f"inertia = {{}}\n{load}\n"
        columns = [fr.assemble(beam(bar, effects + mass, **FREE)).input_matrix("right")[:, -1:] for mass in (hung, "")]
        system = fr.assemble(beam(bar, effects, **FREE))
        np.testing.assert_allclose(resultant(system, columns[0] - columns[1])[0], expected, atol=1e-12)


def test_springs_and_dashpots_add_up(bar):
    """Along any translation: k, and c; the dashpot of a part of the body is nowhere else."""
    effects = """inertia = {}
        [effects.springs.bed]
        surface = "bottom"
        stiffness = 7.0
        [effects.springs.wall]
        near = { point = [1.0, 0.05, 0.1], radius = 0.05 }
        stiffness = 5.0
        [effects.damping.dashpots.bed]
        surface = "bottom"
        coefficient = 3.0
        [effects.damping.dashpots.wall]
        surface = "right"
        coefficient = 2.0"""
    with_them = fr.assemble(beam(bar, effects, **FREE))
    without = fr.assemble(beam(bar, "inertia = {}", **FREE))
    n = with_them.size
    added = dense(with_them.stiffness, n) - dense(without.stiffness, n)
    damping = dense(with_them.damping, n)
    shift = np.kron(np.ones((n // 3, 1)), np.eye(3))
    np.testing.assert_allclose(shift.T @ added @ shift, 12 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(shift.T @ damping @ shift, 5 * np.eye(3), atol=1e-12)
    on = (without.body.nodes[:, 2] == 0) | (without.body.nodes[:, 0] == 1)
    assert not damping[np.repeat(~on, 3)].any()
    assert damping[np.repeat(on, 3)].any(axis=1).all()
    for matrix in (added, damping):
        assert np.linalg.eigvalsh((matrix + matrix.T) / 2)[0] >= -1e-9 * np.abs(matrix).max()
    assert with_them.rigid.shape[1] == 0
    assert without.rigid.shape[1] == 6


def test_foundations_resist_by_area_and_along_normals_where_they_slide(bar):
    """Along any translation: k A of all faces, or of those at right angles to it; a flat one lets it slide."""
    bed = '[effects.springs.bed]\nany = ["left", "right", "front", "back", "bottom", "top"]\nfoundation = 100.0\n'
    without = fr.assemble(beam(bar, "inertia = {}", **FREE))
    n, (x, y, z) = without.size, (LENGTH, WIDTH, HEIGHT)
    shift, faces = np.kron(np.ones((n // 3, 1)), np.eye(3)), 200.0 * np.array([y * z, x * z, x * y])
    for slides, expected in (("", faces.sum() * np.eye(3)), ("sliding = true", np.diag(faces))):
        system = fr.assemble(beam(bar, f"inertia = {{}}\n{bed}{slides}", **FREE))
        added = dense(system.stiffness, n) - dense(without.stiffness, n)
        np.testing.assert_allclose(shift.T @ added @ shift, expected, atol=1e-12 * np.abs(added).max() * n)
        assert np.linalg.eigvalsh((added + added.T) / 2)[0] >= -1e-12 * np.abs(added).max()
    flat = bed.replace('any = ["left", "right", "front", "back", "bottom", "top"]', 'surface = "bottom"')
    assert fr.assemble(beam(bar, f"{flat}sliding = true", **FREE)).rigid.shape[1] == 3  # two ways, and about the normal
    with pytest.raises(SceneError, match=r"springs\.bed\.sliding: use it with frame"):
        parse_scene('frame = "moving"\n' + scene_text(bar, effects=f"inertia = {{}}\n{flat}sliding = true"))
    with pytest.raises(SceneError, match="foundation"):
        beam(bar, flat.replace("foundation = 100.0", ""), **FREE)


@BOTH
def test_dashpot_holds_a_pulled_block_at_its_terminal_speed(bar, model):
    """v = F/c, when F v is dissipated and nothing more is stored."""
    effects = """inertia = {}
        damping.beta = 1e-3
        [effects.damping.dashpots.oil]
        surface = "left"
        coefficient = 400.0
        [effects.prescribed.pull]
        surface = "left"
        force = [30.0, 0, 0]"""
    run = run_of(beam(bar, effects, degree=1, **FREE, run="dt = 0.01\nduration = 8.0"), model)
    late = run.times > 7.5
    speed = np.diff(run.outputs["left"][late, 0], axis=0) / 0.01
    assert np.abs(speed - [30.0 / 400.0, 0, 0]).max() <= 1e-8 * 30.0 / 400.0  # it still turns a little
    power = np.diff(run.dissipated[late]) / 0.01
    np.testing.assert_allclose(power, 30.0**2 / 400.0, rtol=1e-9)
    assert run.energy[-1] == pytest.approx(MASS / 2 * (30.0 / 400.0) ** 2, rel=1e-2)  # and what holds it together
    assert run.balance_error <= 1e-12


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """A bar of two materials."""
    points, cells = box_arrays(LENGTHS, (2, 1, 2))
    first = points[cells].mean(axis=1)[:, 0] < 0.5
    regions = {"front": np.flatnonzero(first), "rear": np.flatnonzero(~first)}
    return write_arrays(tmp_path_factory.mktemp("halves") / "halves.msh", points, cells, None, regions)


def two_materials(halves, effects, front=(1e6, 1000.0), rear=(3e6, 500.0), **parts):
    text = {
        f"materials.{name}": f'cells = "{name}"\nyoung = {young}\npoisson = 0.3\ndensity = {density}'
        for name, (young, density) in (("front", front), ("rear", rear))
    }
    return acted_on(halves, effects, contacts=RIGHT, **({"material": None} | text | parts))


def test_damping_of_each_material(halves):
    """Σ α M + β K of each, with the body's own α and β where a material has none."""
    nothing = 1e-40
    effects = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3, materials.rear = { alpha = 5.0, beta = 3e-3 } }"
    both = fr.assemble(two_materials(halves, effects))
    front = fr.assemble(two_materials(halves, "inertia = {}", rear=(nothing, nothing)))
    rear = fr.assemble(two_materials(halves, "inertia = {}", front=(nothing, nothing)))
    n = both.size
    M, K, D = ([dense(matrix, n) for matrix in (s.mass, s.stiffness, s.damping)] for s in (front, rear, both))
    expected = 2.0 * M[0] + 1e-3 * M[1] + 5.0 * K[0] + 3e-3 * K[1]
    np.testing.assert_allclose(D[2], expected, atol=1e-13 * np.abs(expected).max())
    assert both.rayleigh is None


def test_damping_of_materials_that_are_alike_is_the_bodys(halves):
    one = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }"
    all_alike = "inertia = {}\ndamping = { materials = { front = {A}, rear = {A} } }".replace(
        "{A}", "{ alpha = 2.0, beta = 1e-3 }"
    )
    systems = [fr.assemble(two_materials(halves, effects)) for effects in (one, all_alike)]
    D = [dense(system.damping, system.size) for system in systems]
    np.testing.assert_allclose(D[1], D[0], atol=1e-13 * np.abs(D[0]).max())


# --- base motion -----------------------------------------------------------------------------------------------------


@BOTH
def test_shaken_support_is_a_gravity_the_other_way(bar, model):
    shaken = "[effects.base_motion.quake]\ndirection = [0, 3, 4]\nacceleration = 2.0"
    heavy = "[effects.gravity]\nacceleration = [0, -1.2, -1.6]"
    damped = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
    runs = [
        run_of(beam(bar, damped + what, degree=1, run="dt = 0.01\nduration = 0.5"), model) for what in (shaken, heavy)
    ]
    scale = np.abs(runs[1].outputs["right"]).max()
    assert scale > 1e-3
    assert np.abs(runs[0].outputs["right"] - runs[1].outputs["right"]).max() <= 1e-11 * scale
    assert np.abs(runs[0].supplied - runs[1].supplied).max() <= 1e-11 * runs[1].supplied.max()


@BOTH
def test_free_body_stays_behind_a_moving_frame(bar, model):
    """Relative to it: -a t²/2."""
    shaken = "inertia = {}\ndamping = { beta = 1e-3 }\n"
    shaken += "[effects.base_motion.quake]\ndirection = [0, 3, 4]\nacceleration = 2.0"
    run = run_of(beam(bar, shaken, degree=1, **FREE, run="dt = 0.01\nduration = 0.3"), model)
    behind = -np.array([0, 0.6, 0.8]) * run.times[:, None] ** 2
    assert np.abs(run.outputs["right"][:, 0] - behind).max() <= EXACT * 0.09


# --- without inertia -------------------------------------------------------------------------------------------------

BESIDE = """
[effects.prescribed.push]
surface = "right"
force = [0.0, 1.0, -2.0]
[effects.springs.bed]
surface = "bottom"
stiffness = 100.0
"""
FLOOR = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -0.01]
normal = [0, 0, 1]
"""


@BOTH
def test_equilibrium_is_what_the_matrix_says(bar, model):
    """x = K⁻¹ f at every instant of a force that changes."""
    scene = beam(bar, BESIDE, degree=1, run="dt = 0.1\nduration = 0.5\nsnapshots = 5")
    run = run_of(scene, model, signals={"push": lambda t: [t, 1.0, -2.0 * t**2]})
    system = fr.assemble(scene)
    K, B = dense(system.stiffness, system.size), system.input_matrix("right")
    for time, shape in zip(run.snapshot_times, run.snapshots, strict=True):
        x = np.linalg.solve(K, B @ [0, 0, 0, time, 1.0, -2.0 * time**2])
        assert np.abs(shape.ravel()[system.body.free] - x).max() <= EXACT * np.abs(x).max()
    assert run.balance_error <= 1e-12


@BOTH
@pytest.mark.parametrize("steps", [4, 16])
def test_load_that_comes_and_goes_slowly_dissipates_nothing(bar, model, steps):
    """What it has supplied is stored, at every instant and for any dt: the work is that of the path, not of its steps.

    Both are sums over as many steps of forces that are solved for to some 100 eps, the condition of K left aside.
    """

    def push(t):
        return np.sin(np.pi * t) * np.array([5.0, 3.0, -8.0])

    run_table = f"dt = {1 / steps}\nduration = 1.0"
    run = run_of(beam(bar, BESIDE, degree=1, run=run_table), model, signals={"push": push})
    assert not run.dissipated.any()
    assert not run.numerical.any()
    assert np.abs(run.supplied - run.energy).max() <= 1e-12 * run.energy.max()
    assert abs(run.supplied[-1]) <= 1e-12 * run.energy.max()
    system = fr.assemble(beam(bar, BESIDE, degree=1))
    f = system.input_matrix("right")[:, -3:] @ push(0.5)
    stored = f @ np.linalg.solve(dense(system.stiffness, system.size), f) / 2
    assert run.energy.max() == pytest.approx(stored, rel=EXACT)


PATHS = {  # a law beside, what a floor does, and the order at which what is missed of the work goes to 0
    "smooth": ("", lambda t: [0.0, 0.0, 0.02 * np.sin(np.pi * t)], 2),
    "rough": ("[effects.friction]\ncoefficient = 0.3\n", lambda t: [0.02 * t, 0.0, 0.015 * t], 1),
}


@BOTH
@pytest.mark.parametrize("path", PATHS)
def test_what_equilibria_miss_of_the_work_of_contact_goes_to_zero_with_the_step(bar, model, path, tmp_path):
    """And it stands apart: what is dissipated is friction's, the work of the floor the integral of its force.

    Where in a step a point begins to touch makes it uneven, so it is the mean of four starts within a step.
    """
    law, floor, order = PATHS[path]
    system = fr.assemble(beam(bar, BESIDE + FLOOR + law, degree=1, contacts=BOTTOM, run="dt = 0.1\nduration = 1.0"))
    body = system if model == "full" else reduced(system)

    def missed(steps, begin):
        def push(t):
            return [0.0, t + begin, -2.0 * (t + begin)]

        def lift(t):
            return floor(t + begin)

        run = fr.simulate(body, dt=1 / steps, signals={"push": push, "floor": lift})
        assert run.balance_error <= 1e-12
        assert not run.contact_account["contact"].any()
        np.testing.assert_array_equal(run.dissipated, run.contact_account.get("friction", 0 * run.times))
        way, force = np.diff([lift(t) for t in run.times], axis=0), run.forces["floor"]
        work = np.cumsum(((force[1:] + force[:-1]) / 2 * way).sum(axis=1))
        assert np.abs(run.contact_account["obstacles"][1:] - work).max() <= 1e-12 * np.abs(work).max()
        fr.write_trajectory(tmp_path / "run.h5", run)
        np.testing.assert_array_equal(fr.read_trajectory(tmp_path / "run.h5").numerical, run.numerical)
        return np.abs(run.numerical).max() / run.energy.max()

    coarse, fine = (np.mean([missed(steps, k / (4 * steps)) for k in range(4)]) for steps in (20, 60))
    assert abs(np.log(coarse / fine) / np.log(3) - order) <= 0.1
    assert fine <= 0.02


@FULL
@pytest.mark.parametrize("floor", [None, -0.001], ids=["alone", "on the floor"])
def test_damped_motion_settles_in_the_equilibrium(bar, floor, model):
    """In that on a floor as high as where it stopped: a motion stops up to one step's way before the surface."""
    bottom = {"contacts": '[contacts.bottom]\nsurface = "bottom"', "degree": 1}
    damped = "inertia = {}\ndamping = { alpha = 30.0, beta = 2e-3 }"

    def obstacle(height):
        return "" if floor is None else FLOOR.replace("-0.01", str(height))

    run = "dt = 2e-3\nduration = 4"
    moving = run_of(beam(bar, damped + BESIDE + obstacle(floor), **bottom, run=run), model)
    stopped = moving.snapshots[-1, :, 2].min()
    assert floor is None or -1e-15 <= stopped - floor <= 1e-4 * 0.001  # of a body of 0.1 m, by round-off
    still = run_of(beam(bar, BESIDE + obstacle(stopped), **bottom, **STILL), model)
    scale = np.abs(still.snapshots[-1]).max()
    assert np.abs(moving.snapshots[-1] - still.snapshots[-1]).max() <= 1e-8 * scale
    assert list(still.forces) == ([] if floor is None else ["floor"])
    for name, force in still.forces.items():
        assert force[-1, 2] > 0.1
        np.testing.assert_allclose(moving.forces[name][-1], force[-1], rtol=1e-8, atol=1e-9)


# --- contact ---------------------------------------------------------------------------------------------------------

STIFF = "young = 1e12\npoisson = 0.3\ndensity = 1000.0"
BLOCK_MASS = 1000.0 * 0.2 * 0.1 * 0.05
WEIGHT = f"gravity = {{ acceleration = [0, 0, {-GRAVITY}] }}\n"
CORNER = {"outputs.corners": "points = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0], [0.2, 0.1, 0.05]]"}


@pytest.fixture(scope="module")
def slab(tmp_path_factory):
    """A flat block."""
    mesh = box_arrays((0.2, 0.1, 0.05), (2, 1, 1))
    return write_arrays(tmp_path_factory.mktemp("slab") / "slab.msh", *mesh)


def block(slab, effects, **parts):
    """The scene of a free block."""
    return acted_on(slab, effects, **({"contacts": BOTTOM, "supports": None} | CORNER | parts))


@BOTH
@pytest.mark.parametrize("law", ["", "[effects.friction]\ncoefficient = 0.5\n"], ids=["smooth", "rough"])
def test_body_comes_to_rest_on_the_floor_under_its_weight(slab, law, model):
    """The floor carries m g; what is at rest stays at rest, to round-off."""
    effects = "inertia = {}\ndamping = { alpha = 20.0, beta = 2e-3 }\n" + WEIGHT + FLOOR + law
    run = run_of(block(slab, effects, run="dt = 2e-3\nduration = 3.0"), model)
    weight = BLOCK_MASS * GRAVITY
    late = run.times > 2.8
    np.testing.assert_allclose(run.forces["floor"][late, 2], weight, rtol=1e-8)
    assert np.abs(run.forces["floor"][late, :2]).max() <= 1e-8 * weight
    speed = np.linalg.norm(np.diff(run.outputs["corners"], axis=0), axis=2).max(axis=1) / 2e-3
    assert speed[late[1:]].max() <= 1e-10 * speed.max()
    assert run.balance_error <= 1e-12


LOWER = FLOOR.replace("-0.01", "-0.02")
BOUNCES = pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """The scene of a soft cube that falls on a rough floor, and sticks to it while damping stops it within a step."""
    mesh = box_arrays((0.05, 0.05, 0.05), (2, 2, 2))
    file = write_arrays(tmp_path_factory.mktemp("cube") / "cube.msh", *mesh)
    return acted_on(
        file,
        "inertia = {}\ndamping = { beta = 5e-3 }\n" + WEIGHT + LOWER + "[effects.friction]\ncoefficient = 0.5\n",
        contacts="[contacts.skin]\nnear = { point = [0, 0, 0], radius = 1.0 }",
        material="young = 5e4\npoisson = 0.3\ndensity = 1000.0",
        run="dt = 2e-3\nduration = 1.0",
        supports=None,
        **{"outputs.sole": "points = [[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0], [0.025, 0.025, 0]]"},
    )


@pytest.fixture(scope="module")
def reduced_cube(cube):
    return reduced(fr.assemble(cube), order=20, method="modal+static")


def bouncing(model, restitution):
    """A scene or a ROM, in whose contact impacts give back a part of the speed."""
    if isinstance(model, fr.Rom):
        law = replace(model.environment.contact_law, restitution=restitution)
        return replace(model, environment=replace(model.environment, contact_law=law))
    effects = model.effects
    return replace(model, effects=replace(effects, contact=replace(effects.contact, restitution=restitution)))


def check_rest(forces):
    """Forces in the last steps are the weight, and no others than in the step before, however hard it fell."""
    forces = np.array(forces) / (1000.0 * 0.05**3 * GRAVITY)
    assert np.abs(np.diff(forces, axis=0)).max() > 1.0
    np.testing.assert_allclose(forces[-20:], np.tile([0.0, 0.0, 1.0], (20, 1)), atol=1e-8)


@BOTH
@BOUNCES
def test_forces_at_rest_do_not_alternate(cube, model, restitution, request):
    fallen = cube if model == "full" else request.getfixturevalue("reduced_cube")
    run = fr.simulate(bouncing(fallen, restitution))
    check_rest(run.forces["floor"])
    assert run.balance_error <= 1e-12
    lost = np.diff(run.contact_account["friction"] + run.contact_account["contact"])
    assert lost.min() >= -1e-12 * run.dissipated[-1]


def sole(model):
    """Heights of points of the lower side of a cube above the floor, m."""
    return model.displacement("sole")[..., 2] + 0.02


# The longest steps leave waves within the cube, which damping takes long for.
@pytest.mark.parametrize(("dt", "duration"), [(1e-3, 0.4), (5e-3, 0.6), (1e-2, 1.0), (2e-2, 1.5), (5e-2, 4.0)])
@BOTH
def test_a_soft_body_that_has_fallen_lies_on_the_floor(cube, model, dt, duration, request):
    """Whatever its step is; contact is rigid, and exact to 1e-12 of the velocities in each step."""
    if model == "full":
        step, body = stepper(bouncing(cube, 0.5), model, dt, [0, 0, 0])
    else:
        body = fr.Simulator(bouncing(request.getfixturevalue("reduced_cube"), 0.5), dt)
        step = body.step
    deepest = 0.0
    for _ in range(round(duration / dt)):
        step()
        deepest = min(deepest, sole(body).min())
    assert deepest >= -1e-11
    np.testing.assert_allclose(sole(body), 0.0, atol=1e-11)


@pytest.mark.parametrize(("dt", "restitution"), [(2e-3, 0.0), (2e-3, 0.5), (2e-3, 0.9)])
def test_bodies_of_batches_and_of_worlds_rest_like_single_ones(reduced_cube, dt, restitution):
    """On the floor, and without forces that alternate."""
    rom = bouncing(reduced_cube, restitution)
    bodies, forces = fr.Batch(rom, 2, dt), []
    floor = fr.RigidBody(HalfSpace(), motion=fr.BaseState((0, 0, -0.02), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0)))
    parts = {"cube": fr.SoftBody(rom), "floor": floor}
    world, between = fr.World(parts, dt, friction=0.5, restitution=restitution), []
    for _ in range(500):
        bodies.step(np.zeros((2, bodies.inputs)))
        forces.append(bodies.contact_force("floor")[1])
        world.step()
        between.append(world.force_between("cube", "floor"))
    check_rest(forces)
    check_rest(between)
    np.testing.assert_allclose(sole(world.simulator("cube")), 0.0, atol=1e-11)
    np.testing.assert_allclose(sole(bodies), 0.0, atol=1e-7)  # as forces of a batch are found to 4e-7 of velocities


@BOTH
def test_work_of_a_floor_that_lifts_is_its_force_times_its_way(slab, model):
    effects = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n" + WEIGHT + FLOOR

    def lift(t):
        return [0.0, 0.0, 0.02 * (1 - np.cos(10 * t))]

    run = run_of(block(slab, effects, run="dt = 1e-3\nduration = 1.0"), model, signals={"floor": lift})
    way = np.diff([lift(t) for t in run.times], axis=0)
    work = np.cumsum((run.forces["floor"][1:] * way).sum(axis=1))
    account = run.contact_account
    assert np.abs(account["obstacles"][1:] - work).max() <= 1e-11 * np.abs(work).max()
    assert work.max() > 0.1 * BLOCK_MASS * GRAVITY * 0.04
    assert (np.diff(account["contact"]) >= -1e-14 * np.abs(work).max()).all()  # sums over 25 points
    assert "friction" not in account
    assert run.balance_error <= 1e-12


@BOTH
def test_elastic_impacts_lose_nothing(slab, model):
    """Three bounces and more, undamped: all of the work of the weight is there as energy.

    But for what a reduced body's residual compliance loses: its floor, 1e-12 of the static compliance at each point.
    """
    law = "[effects.contact]\nrestitution = 1.0\n"
    damped = block(slab, "inertia = {}\ndamping = { beta = 1e-4 }\n" + WEIGHT + law + FLOOR)
    scene = block(slab, "inertia = {}\n" + WEIGHT + law + FLOOR, run="dt = 1e-3\nduration = 0.5")
    if model == "full":
        run = fr.simulate(scene)
    else:
        system = fr.assemble(damped)
        run = fr.simulate(reduced(system, order=system.size), scene=scene)
    scale = BLOCK_MASS * GRAVITY * 0.01
    assert run.supplied.max() >= 0.9 * scale
    lost = 1e-11 if model == "full" else 1e-9
    assert np.abs(run.energy - run.supplied).max() <= lost * scale
    assert np.abs(run.dissipated).max() <= lost * scale
    height = run.outputs["corners"][:, :3, 2].mean(axis=1)
    falling = np.diff(height) < 0
    assert (falling[:-1] & ~falling[1:]).sum() >= 3
    assert run.outputs["corners"][:, :3, 2].min() >= -0.01 - 1e-12


SHAPES = {
    "half-space": "point = [1.02, 0, 0]\nnormal = [-3, 0, 4]",
    "sphere": "center = [1.06, 0.05, 0.1]\nradius = 0.05",
    "capsule": "start = [1.06, 0.05, -1]\nend = [1.06, 0.05, 1]\nradius = 0.05",
    "box": "center = [1.195, 0.0, 0.0]\nsize = [0.3, 0.3, 0.3]\nrotation = [0, 0, 0.2]",
}


def outside(shape, x):
    """How far points (P, 3) are from these, worked out by hand."""
    if shape == "half-space":
        return (x - [1.02, 0, 0]) @ [-0.6, 0, 0.8]
    if shape == "sphere":
        return np.linalg.norm(x - [1.06, 0.05, 0.1], axis=1) - 0.05
    if shape == "capsule":
        return np.hypot(x[:, 0] - 1.06, x[:, 1] - 0.05) - 0.05
    c, s = np.cos(0.2), np.sin(0.2)
    along, across, up = ((x - [1.195, 0, 0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])).T
    return np.maximum(np.maximum(np.abs(along), np.abs(across)), np.abs(up)) - 0.15


@BOTH
@pytest.mark.parametrize("shape", SHAPES)
def test_body_gives_way_to_where_the_obstacle_is(bar, shape, model):
    """Without inertia: the nearest node is on its surface, and what pushes is a force outwards."""
    effects = f'[effects.contact.obstacles.it]\nshape = "{shape}"\n{SHAPES[shape]}'
    scene = beam(bar, effects, run="dt = 0.1\nduration = 1.0\nsnapshots = 10")
    run = run_of(scene, model, signals={"it": lambda t: [-0.04 * t, 0.0, 0.0]})
    right = run.nodes[:, 0] == 1.0
    gaps = [
        outside(shape, (run.nodes + moved)[right] - [-0.04 * time, 0.0, 0.0]).min()
        for time, moved in zip(run.snapshot_times, run.snapshots, strict=True)
    ]
    assert min(gaps) >= -1e-4  # the normal is that of the step's beginning
    assert abs(gaps[-1]) <= 1e-4
    assert run.forces["it"][-1, 0] < -1.0
    assert run.balance_error <= 1e-12


PENALTY = '[effects.contact]\nmethod = "penalty"\nstiffness = 1e3\ndamping = 2.0\n'


@BOTH
def test_penalty_floor_gives_way_by_weight_over_stiffness(slab, model):
    """m g/(P k) on the mean of its P points, and its springs and dashpots are in the account."""
    effects = "inertia = {}\ndamping = { alpha = 20.0, beta = 2e-3 }\n" + WEIGHT + PENALTY + FLOOR
    run = run_of(block(slab, effects, run="dt = 2e-3\nduration = 3.0"), model)
    bottom = run.nodes[:, 2] == 0
    depth = -0.01 - run.snapshots[-1, bottom, 2]
    assert bottom.sum() == 6
    assert depth.mean() == pytest.approx(BLOCK_MASS * GRAVITY / (6 * 1e3), rel=1e-8)
    assert run.forces["floor"][-1, 2] == pytest.approx(BLOCK_MASS * GRAVITY, rel=1e-8)
    assert run.balance_error <= 1e-12
    held = 1e3 / 2 * (depth**2).sum()  # in the springs, at least
    assert run.contact_account["contact"][-1] >= held


def stepper(scene, model, dt, velocity, signals=None):
    """A body that moves with a velocity (3,) at first: how to take a step, and what to read."""
    system = fr.assemble(scene)
    start = np.tile(velocity, len(system.body.nodes))[:, None]
    if model == "full":
        full = FullOrderSimulator(system, dt, scene.environment, signals)
        full.stepper.set_state(np.zeros(system.size), start)
        automatic = scene.environment.switches_itself
        columns = 0 if automatic else next(iter(system.contacts.values())).shape[1]

        def step():
            full.step(np.zeros(columns))

        return step, full
    rom = reduced(system, order=system.size)
    body = fr.Simulator(rom, dt, scene=scene, signals=signals)
    W = rom.basis @ next(iter(rom.contact_models.values())).coordinates
    body.state = np.zeros(W.shape[1]), (W.T @ (system.mass @ start))[:, 0]
    return body.step, body


@BOTH
@pytest.mark.parametrize("restitution", [0.0, 0.8, *(pytest.param(e, marks=pytest.mark.slow) for e in (0.3, 1.0))])
def test_stiff_block_bounces_to_the_height_that_restitution_says(slab, restitution, model):
    """e² H, and e of the speed, to what a step of falling makes of them."""
    law = f"[effects.contact]\nrestitution = {restitution}\n"
    effects = "inertia = {}\ndamping = { beta = 1e-9 }\n" + WEIGHT + law + FLOOR
    h = 1e-4
    step, body = stepper(block(slab, effects, material=STIFF), model, h, [0, 0, -1.0])
    heights = [0.0]
    for _ in range(300 + round(1150 * restitution)):  # it falls 100 steps long, and rises e times 1115
        step()
        heights.append(body.displacement("corners")[:, 2].mean())
    heights = np.array(heights)
    speed = np.diff(heights) / h
    hit = speed.argmin()  # the last step before
    before, after = speed[hit] - GRAVITY * h, speed[hit + 3]  # without restitution it is stopped in two steps
    assert after == pytest.approx(-restitution * before, abs=3.1 * GRAVITY * h)
    H = before**2 / (2 * GRAVITY)
    rebound = heights[hit + 1 :].max() - heights[hit + 1]
    assert rebound == pytest.approx(restitution**2 * H, abs=2.2 * abs(before) * h)
    assert heights.min() >= -0.01 - 1e-9


RESTING = FLOOR.replace("-0.01", "0.0")


@FULL
def test_block_slides_as_far_as_friction_lets_it(slab, model):
    """v²/(2 μ g), to 1 %; then it sticks. Friction took all of the energy."""
    effects = "inertia = {}\ndamping = { beta = 1e-6 }\n" + WEIGHT + RESTING + "[effects.friction]\ncoefficient = 0.4\n"
    step, body = stepper(block(slab, effects, material=STIFF), model, 5e-4, [0.6, 0.8, 0])
    for _ in range(600):
        step()
    way = body.displacement("corners").mean(axis=0)
    exact = 1 / (2 * 0.4 * GRAVITY) * np.array([0.6, 0.8, 0.0])
    assert np.abs(way - exact).max() <= 0.01 * np.linalg.norm(exact)
    assert body.ledger.friction == pytest.approx(BLOCK_MASS / 2, rel=1e-3)
    for _ in range(20):
        step()
    assert np.abs(body.displacement("corners").mean(axis=0) - way).max() <= 1e-9


@BOTH
@pytest.mark.parametrize(("slope", "slides"), [(0.45, False), (0.55, True)])
def test_block_on_an_incline_slides_beyond_the_angle_of_friction(slab, slope, slides, model):
    """tan θ > μ = 0.5, with g (sin θ - μ cos θ)."""
    θ = np.arctan(slope)
    g = GRAVITY * np.array([np.sin(θ), 0.0, -np.cos(θ)])
    effects = f"inertia = {{}}\ndamping = {{ beta = 1e-6 }}\ngravity = {{ acceleration = {g.tolist()} }}\n"
    effects += RESTING + "[effects.friction]\ncoefficient = 0.5\n"
    step, body = stepper(block(slab, effects, material=STIFF), model, 1e-3, [0, 0, 0])
    for _ in range(500):
        step()
    way = body.displacement("corners").mean(axis=0)
    if slides:
        exact = GRAVITY * (np.sin(θ) - 0.5 * np.cos(θ)) * 0.5**2 / 2
        assert way[0] == pytest.approx(exact, rel=1e-2)
        assert np.abs(way[1:]).max() <= 1e-3 * exact
    else:
        assert np.abs(way).max() <= 1e-8
        assert body.ledger.friction <= 1e-8
