"""Contact with meshes: as flat as a plane, all walls of a corner, and no way in, whatever bodies do."""

import numpy as np
import pytest
from test_contact import Points, chain
from triangle_meshes import blob, groove, plate, room

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.obstacles import HalfSpace, Mesh
from fenics_rom.mechanics.triangle_surface import TriangleSurface

G = 9.81  # m/s²
TURN, PLACE = (0.3, -0.2, 0.7), np.array([0.02, 0.01, -0.03])


def test_a_pad_slides_over_triangles_as_over_a_half_space():
    """10,082 of them in one plane: forces are the same to what they are found to, 1e-9, and so is the way."""
    mesh = Mesh(*plate(71), PLACE, TURN, open=1)
    normal, side = mesh.surface.normals[0], mesh.surface.vertices[1] - mesh.surface.vertices[0]
    along = side / np.linalg.norm(side)
    across = np.cross(normal, along)
    x = np.linspace(-0.02, 0.02, 4)
    points = PLACE + 1e-4 * normal + np.concatenate([a * along + x[:, None] * across for a in x])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 0.015
    stiffness = np.kron(500 * (np.diag(near.sum(axis=1)) - near), np.eye(3))
    forces, places = [], []
    for obstacle in (mesh, HalfSpace(PLACE, normal)):
        motion = {"mass": 1e-3, "K": stiffness, "D": 1e-4 * stiffness, "v": 0.3 * along + 0.2 * across}
        pad = Points(points, [obstacle], ContactLaw(friction=0.2), 2e-3, force=-0.005 * normal, **motion)
        pressed = []
        for _ in range(80):
            pad.step()
            pressed.append(np.zeros(points.shape) if pad.resolution is None else pad.resolution.forces)
        forces.append(np.array(pressed))
        places.append(pad.position)
    assert np.abs(forces[0] - forces[1]).max() < 1e-9 * np.abs(forces[1]).max()
    assert np.abs(places[0] - places[1]).max() < 1e-12
    assert np.linalg.norm((places[0] - points).mean(axis=0)) > 2 * 0.4 / 71, "over several triangles"


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_body_lies_in_a_groove_on_both_its_sides(friction):
    """Without friction each side bears 1/(2 cos α) of the weight; with it the body stays where it fell."""
    law = ContactLaw(friction=friction)
    body = Points([1e-3, 0, 0.01], [groove(0.5)], law, 2e-3, D=20 * np.eye(3), force=(0, 0, -G), v=(0.02, 0, 0))
    for _ in range(600):
        assert body.step().gap > -1e-15
    np.testing.assert_allclose(body.velocity, 0.0, atol=1e-12)
    if friction:
        assert body.position[0, 0] > 5e-4
    else:
        pressed = np.linalg.norm(body.resolution.pair_forces, axis=1)
        np.testing.assert_allclose(pressed, G / 2 * np.sqrt(1.25), rtol=1e-9)
        np.testing.assert_allclose(body.position[0], 0.0, atol=1e-14)


def test_what_flies_into_a_corner_stops_at_three_walls_at_once():
    """In two steps, as at one: though the nearest of them is not the one that it meets first."""
    body = Points([0.03, 0.02, 0.025], [room()], ContactLaw(), 1e-2, v=(-3.0, -1.0, -2.0))
    for _ in range(6):
        body.step()
        assert body.position.min() > -1e-15
    np.testing.assert_allclose(body.position[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(body.velocity, 0.0, atol=1e-14)


def test_a_mesh_that_moves_pushes_what_lies_in_it():
    body = Points([0, 0, 1e-3], [groove(1.0)], ContactLaw(), 2e-3, force=(0, 0, -G))
    for _ in range(100):
        body.step(w=(0.2, 0.0, 0.1))
        assert body.gap > -1e-14
    np.testing.assert_allclose(body.velocity[0], (0.2, 0, 0.1), atol=1e-12)
    assert body.sums()[0] > 0


def dropped(seed):
    """A chain of points that is thrown at a rough mesh, by a law and steps of chance: gaps, energies, what misses."""
    rng = np.random.default_rng(seed)
    mesh, h, count = blob(seed), 10 ** rng.uniform(-3, -2), 6
    points = rng.uniform(-0.03, 0.03, (count, 3)) + np.append(rng.uniform(-0.02, 0.02, 2), 0.18)
    stiffness = chain(count, 10 ** rng.uniform(1, 4))
    law = ContactLaw(float(rng.choice([0, 0, 0.5, 1])), float(rng.choice([0, 0.3, 1])))
    damping, velocity = 1e-4 * stiffness + 0.01 * np.eye(3 * count), 0.3 * rng.standard_normal(3) - [0, 0, 1.5]
    body = Points(points, [mesh], law, h, mass=0.02, K=stiffness, D=damping, force=(0, 0, -0.2), v=velocity)
    energies, gaps = [body.energy], []
    for _ in range(int(0.2 / h)):
        body.step()
        energies.append(body.energy - body.work)
        gaps.append(body.gap)
    _, contact, friction, _ = body.sums()
    lost = energies[0] - energies[-1] - body.heat
    missed = (lost - contact - friction) / (energies[0] + contact + friction + body.heat + abs(body.work))
    return min(gaps), np.array(energies), missed, len(body.accounts)


@pytest.mark.parametrize("seed", range(8))
def test_nothing_gets_into_a_rough_mesh_or_gains_energy(seed):
    deepest, energies, missed, touched = dropped(seed)
    assert touched
    assert deepest > -1e-13
    assert np.diff(energies).max() < 1e-13 * np.abs(energies).max()
    assert abs(missed) < 1e-12


def test_without_planes_of_ways_things_do_get_in(monkeypatch):
    """So that the test above would tell."""
    monkeypatch.setattr(TriangleSurface, "first_crossed", lambda self, starts, ends: np.full(len(starts), -1))
    assert min(dropped(seed)[0] for seed in range(4)) < -1e-4


def test_a_body_that_begins_in_a_mesh_is_told_where_and_how_deep():
    body = Points([[0, 0, 0.1], [0.1, 0, 0.03]], [groove(0.5)], ContactLaw(), 1e-3)
    with pytest.raises(StepError, match=r"0.0179 m inside 'vee' is the point at \[0.1, 0.0, 0.03\]"):
        body.contact.check_start(np.zeros((2, 3)), np.zeros((1, 3)), ["vee"])
