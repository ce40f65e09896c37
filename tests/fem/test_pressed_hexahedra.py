"""Pressures that follow hexahedra, curved ones, too: closed forms, slopes of volumes, chambers with gas, reduced."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, scene_text
from bricks import hexahedra, shaken_bricks, write_bricks
from scipy.integrate import quad

import fenics_rom as fr
from fenics_rom.fem.cell_points import checked_nodes
from fenics_rom.fem.facets import volume_within_surface
from fenics_rom.fem.finite_strain.follower_loads import PressureLoad
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.gas import ATMOSPHERE
from fenics_rom.scene.file import parse_scene

KINDS = [(8, 1), (8, 2), (20, 2), (27, 2)]
EDGES, BRICKS = (0.05, 0.03, 0.03), (5, 3, 3)


def hollow(path, nodes):
    """Shaken bricks without those in the middle."""
    points, cells, faces = shaken_bricks(EDGES, BRICKS, nodes)
    middles = points[cells[:, :8]].mean(axis=1) / np.array(EDGES)
    inner = (np.abs(middles - 0.5) < [0.3, 1 / 6, 1 / 6]).all(axis=1)
    assert inner.sum() == 3
    return write_bricks(path, points, cells[~inner], faces)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hollow")
    return {nodes: hollow(folder / f"{nodes}.msh", nodes) for nodes in (8, 20, 27)}


@pytest.mark.parametrize(("nodes", "degree"), KINDS)
def test_a_pressure_is_the_slope_of_what_a_surface_encloses(meshes, nodes, degree):
    """To round-off: the force, its change, its symmetric stiffness, the volume swept, and the rim of a part."""
    of = checked_nodes(read_mesh(meshes[nodes], {}), degree)
    load, random = PressureLoad(of, of.surface), np.random.default_rng(1)
    u, du = (1e-3 * random.standard_normal(of.coordinates.shape) for _ in range(2))

    def volume(u):
        moved = replace(of, coordinates=of.coordinates + u, is_curved=True)
        return volume_within_surface(moved, moved.surface, np.zeros(3))

    change = volume(u + du) - volume(u - du)  # volume is a cubic
    change -= (volume(u + 2 * du) - volume(u - 2 * du) - 2 * change) / 6
    size = np.abs(volume(u))
    assert abs((load.force(u) * du).sum() + change / 2) <= 1e-14 * size
    assert abs(load.stroke(u) + volume(u) - volume(0 * u)) <= 1e-13 * size
    jvp = load.jvp(u, du)
    assert np.abs(load.force(u + du) - load.force(u - du) - 2 * jvp).max() <= 1e-13 * np.abs(load.force(u)).max()
    assert np.abs(load.stiffness(u) @ du.ravel() + jvp.ravel()).max() <= 1e-12 * np.abs(jvp).max()
    part = of.surface[of.whole_facets(of.facet_centroids[:, 2] > EDGES[2] * 0.999)]
    over = PressureLoad(of, part)
    places, pieces = (matrix @ (of.coordinates + u) for matrix in over.rim())
    total = -np.cross(places, pieces).sum(axis=0) / 2
    assert np.abs(over.force(u).sum(axis=0) - total).max() <= 1e-12 * np.abs(total).max()


INNER, OUTER, LENGTH, C10, C01, POISSON = 0.010, 0.016, 0.004, 4.5e4, 4.5e3, 0.4999  # m, Pa


def quarter(path):
    """Of a thick-walled tube, of curved hexahedra: three through the wall, two around."""
    points, cells, faces = hexahedra((3, 2, 1), 20)
    radius, angle = INNER + (OUTER - INNER) * points[:, 0], np.pi / 2 * points[:, 1]
    placed = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), LENGTH * points[:, 2]])
    return write_bricks(path, placed, cells, faces)


def pressure_of(stretch):
    """p = ∫ W'(λ)/(λ² - 1) dλ from the outer to the inner stretch, Pa; W is neo-Hooke's in plane strain."""
    outer = np.sqrt(1 + (stretch**2 - 1) * (INNER / OUTER) ** 2)
    return quad(lambda λ: 2 * (C10 + C01) * (λ - λ**-3) / (λ**2 - 1), outer, stretch, epsrel=1e-10)[0]


@pytest.mark.parametrize("control", ["pressure", "gas"])
def test_a_thick_tube_is_inflated_as_the_closed_form_says(tmp_path, control):
    held = {"front": [0, 1, 0], "back": [1, 0, 0], "bottom": [0, 0, 1], "top": [0, 0, 1]}
    supports = [f'[[supports.held]]\nsurface = "{name}"\nnormal = {normal}\n' for name, normal in held.items()]
    volume = np.pi / 4 * INNER**2 * LENGTH
    effects = f'large_deformation = {{ material = "mooney_rivlin", constants = [{C10}, {C01}] }}\n'
    effects += f'[effects.pressure.air]\nsurface = "left"\ncontrol = "{control}"\n'
    effects += f"gas = {{ volume = {volume} }}\n" * (control == "gas")
    material = f"young = {4 * (C10 + C01) * (1 + POISSON)}\npoisson = {POISSON}\ndensity = 1000.0"
    tables = {"supports": None, "material": material, "contacts": '[contacts.right]\nsurface = "right"'}
    text = scene_text(quarter(tmp_path / "tube.msh"), degree=2, integration="selective", effects=effects, **tables)
    system = fr.assemble(parse_scene("".join(supports) + text))
    body = FullOrderSimulator(system, 1.0, system.scene.environment)
    inner = np.hypot(*system.body.nodes[:, :2].T) < INNER * 1.001
    for stretch in (1.1, 1.3, 1.6):
        expected = pressure_of(stretch)
        given = volume * (stretch**2 * (1 + expected / ATMOSPHERE) - 1) if control == "gas" else expected
        body.step(np.array([0.0, 0.0, 0.0, given]))
        places = (system.body.nodes + body.displacement())[inner]
        radii = np.hypot(*places[:, :2].T) / (INNER * stretch)
        assert np.abs(radii - 1).max() <= 2e-3
        if control == "gas":
            assert body.reactions["air"] == pytest.approx(expected, rel=2e-3)
    assert body.stepper.negative_pivots == 0


def test_a_chamber_holds_its_gas_at_full_order_and_reduced(meshes):
    """Of hexahedra of degree 1: the pressure is that of the volume which is read, and the account closes."""
    effects = (
        'large_deformation = { material = "neo_hookean" }\n[effects.pressure.air]\ninner = true\ncontrol = "gas"\n'
    )
    tables = {
        "material": "young = 1e5\npoisson = 0.4\ndensity = 1000.0",
        "readings.inside": 'quantity = "volume"\nof = "air"',
        "run": 'dt = 1.0\nduration = 4.0\nload = [{ actuator = "air", force = [1e-6] }]',
        "contacts": '[contacts.right]\nsurface = "right"\nforce = "resultant"',
    }
    system = fr.assemble(acted_on(meshes[8], effects, integration="selective", **tables))
    reduced = fr.Simulator(fr.reduce(system, order=8, method="modal+derivatives"), 1.0)
    bodies = FullOrderSimulator(system, 1.0, system.scene.environment), reduced
    rest = float(reduced.reading("inside"))
    for amount in (2e-7, 1e-6, -5e-7):
        for body in bodies:
            body.step(np.array([0.0, 0.0, 0.0, amount]))
            held = (rest + amount) / float(body.reading("inside"))
            assert body.reactions["air"] == pytest.approx(ATMOSPHERE * (held - 1), rel=1e-10)
            ledger = body.ledger
            gone = ledger.dissipated + ledger.numerical + ledger.lost_in_switching
            assert abs(body.energy - ledger.supplied + gone) <= 1e-11 * max(abs(ledger.supplied), body.energy)
        full, few = bodies
        assert few.reactions["air"] == pytest.approx(full.reactions["air"], rel=2e-3)
