"""Points of a body that touch its own surface: their forces have no resultant and no couple, and add no energy."""

import numpy as np
import pytest
from forks import GAP, LONG, cleft, prongs
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.contact import ContactLaw, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.obstacles import HalfSpace
from fenics_rom.mechanics.own_surface import OwnSurface
from fenics_rom.mechanics.self_contact import SelfContact
from fenics_rom.mechanics.surface_checks import check_apart

seeds = st.integers(0, 2**32 - 1)
EPS = float(np.finfo(float).eps)
NO_OBSTACLES = ObstacleMotion(*np.zeros((3, 0, 3)))


def skin_of(points, cells):
    """Triangles of the skin of tetrahedra, counterclockwise from outside."""
    faces = cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3)
    inner = points[cells].mean(axis=1).repeat(4, axis=0)
    (a, b, c), keys = np.moveaxis(points[faces], 1, 0), np.sort(faces, axis=1)
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - inner) < 0
    faces[turned] = faces[turned][:, [0, 2, 1]]
    _, row, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    return faces[row[count == 1]]


def own_surface(points, triangles, touching=None):
    touching = np.arange(len(points)) if touching is None else touching
    return OwnSurface(points, triangles, touching, [""] * len(points))


def two_patches(random, gap):
    """Points of two wavy patches that face one another across a gap, and triangles of both."""
    rows = np.arange(16).reshape(4, 4)
    a, b, c, d = (rows[i : 3 + i, j : 3 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    flat = np.stack([*np.meshgrid(np.arange(4), np.arange(4), indexing="ij"), np.zeros((4, 4))]).reshape(3, -1).T
    lower, upper = (0.01 * (flat + random.uniform(-0.1, 0.1, flat.shape)) for _ in range(2))
    upper += [0.003, 0.002, gap]
    return np.concatenate([lower, upper]), np.concatenate([triangles, triangles[:, ::-1] + 16])


def fall_together(random, friction, beside_floor=False, touching=None):
    """Two patches of free masses that come together aslant: what a solver is made of, and asked."""
    points, triangles = two_patches(random, 3e-3)
    obstacles = [HalfSpace((0.0, 0.0, -2e-3), (0.0, 0.0, 1.0))] if beside_floor else []
    made = points, obstacles, ContactLaw(friction=friction), own_surface(points, triangles, touching)
    h, velocity = 1e-3, random.uniform(-1, 1, (32, 3))
    velocity[:, 2] += np.repeat([2.0, -2.0], 16)
    W = np.diag(np.repeat(h / 2 / random.uniform(0.5, 2.0, 32), 3))
    motion = PointMotion(np.zeros_like(points), velocity, velocity, points + h / 2 * velocity)
    return made, (motion, W, h, ObstacleMotion(*np.zeros((3, len(obstacles), 3))))


@pytest.mark.parametrize("solver_of", [SelfContact, make_contact_solver], ids=["NumPy", "compiled"])
@given(seeds, st.sampled_from([0.0, 0.3, 1.0]), st.booleans())
@settings(deadline=None, max_examples=30)
def test_forces_have_no_resultant_and_no_couple_and_do_no_work(solver_of, seed, friction, beside_floor):
    """With friction, between wavy patches; also beside an obstacle."""
    made, asked = fall_together(np.random.default_rng(seed), friction, beside_floor)
    contact, ((_, velocity, _, middle), W, h, _) = solver_of(*made).solve(*asked), asked
    assert contact.touching >= 3
    mid = velocity + (W @ contact.forces.ravel()).reshape(-1, 3)
    size = np.abs(contact.forces).sum()
    of_floor = contact.by_obstacle.sum(axis=0)
    np.testing.assert_allclose(contact.forces.sum(axis=0), of_floor, rtol=0, atol=1e3 * EPS * size)
    if not beside_floor:
        torque = np.cross(middle, contact.forces).sum(axis=0)
        np.testing.assert_allclose(torque, 0.0, rtol=0, atol=1e3 * EPS * size * 0.04)
    work = contact.work(mid, h)
    scale = h * size * 4.0
    assert work.contact >= -1e-12 * scale
    assert work.friction >= -1e-12 * scale
    assert work.supplied == 0.0
    assert contact.normal_forces.sum() == pytest.approx(
        2 * (contact.pair_forces * contact.normals).sum() - of_floor[2], rel=1e-12
    )


@given(seeds, st.sampled_from([0.0, 0.3]))
@settings(deadline=None, max_examples=30)
def test_compiled_forces_are_those_of_numpy(seed, friction):
    """Where only points of the upper patch may touch, so that W tells their forces apart."""
    made, asked = fall_together(np.random.default_rng(seed), friction, touching=np.arange(16, 32))
    contact, same = make_contact_solver(*made).solve(*asked), SelfContact(*made).solve(*asked)
    np.testing.assert_array_equal(contact.pairs, same.pairs)
    np.testing.assert_allclose(contact.forces, same.forces, rtol=0, atol=1e-9 * np.abs(same.forces).max())


def test_a_point_stops_on_a_triangle_that_it_falls_on():
    """Two bodies of equal mass: by hand, as e = 0 has them go on together along the normal."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0.25, 0.0]])
    points[3, 2] = 0.01
    # the falling point carries a triangle of its own, that looks down
    points = np.concatenate([points, points[3] + np.array([[0.1, 0.0, 0.3], [0.0, 0.1, 0.3]])])
    triangles = np.array([[0, 1, 2], [3, 5, 4]])
    solver = SelfContact(points, [], ContactLaw(), own_surface(points, triangles))
    h, speed = 0.01, 1.0
    velocity = np.zeros((6, 3))
    velocity[3:, 2] = -speed
    W = np.diag(np.repeat([h / 2, h / 2, h / 2, h / 2, 0.0, 0.0], 3))  # masses of 1 kg; two are driven
    contact = solver.solve(PointMotion(np.zeros((6, 3)), velocity, velocity), W, h, NO_OBSTACLES)
    weights = np.array([0.5, 0.25, 0.25])  # of the corners below the point
    own = h / 2 * (1 + weights @ weights)  # of the pair
    target = (-speed / 2 - 0.01 / h) / 2  # (a/2 - g/h)/2, the gap of a step's way, closed in two steps
    force = max(0.0, (target + speed) / own)
    np.testing.assert_allclose(contact.forces[3], [0, 0, force], rtol=1e-12)
    np.testing.assert_allclose(contact.forces[:3], -weights[:, None] * [0, 0, force], rtol=1e-12, atol=1e-15)


def test_pairs_are_of_what_faces_a_point_and_is_no_wall():
    """Of a thin plate none touches its other side; of a cleft block points touch across the cleft alone."""
    plate, block = prongs((8, 4, 1), upper_alone=True)[:2], cleft((6, 2, 3), 1)[:2]
    plate = plate[0] * [1, 1, 0.1], plate[1]
    for (points, cells), touch in ((plate, False), (block, True)):
        found = own_surface(points, skin_of(points, cells)).near(points, 1.5 * GAP)
        across = np.isclose(np.abs(points[:, 2]), GAP / 2) & (points[:, 0] > 1.5 * LONG / 6) if touch else []
        assert len(found.gaps) == np.count_nonzero(across) / 2  # points are opposite to one another
        assert set(np.flatnonzero(across)) >= set(found.row)
        np.testing.assert_allclose(found.gaps, GAP, rtol=1e-12)
        np.testing.assert_allclose(found.normals, np.sign(points[found.row, 2:]) * [0, 0, 1], atol=1e-12)


def test_a_point_between_nodes_touches_as_nodes_do():
    """It lies on a triangle, and is no corner of any."""
    points, cells = cleft((6, 2, 3), 1)[:2]
    triangles = skin_of(points, cells)
    inside = [t for t in triangles if np.allclose(points[t, 2], GAP / 2) and points[t, 0].min() > 0.7 * LONG]
    more = np.concatenate([points, [points[inside[0]].mean(axis=0)]])
    found = own_surface(more, triangles, np.array([len(points)])).near(more, 1.5 * GAP)
    np.testing.assert_allclose(found.gaps, [GAP], rtol=1e-12)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-12)


def test_what_lies_on_itself_at_rest_touches():
    """Two prongs without a gap: also where they have slid by more than an element."""
    points, cells, _ = prongs((6, 2, 1))
    points[:, 2] -= np.sign(points[:, 2]) * GAP / 2
    triangles = skin_of(points, cells)
    inside = np.isclose(points[:, 2], 0.0)
    upper = points[:, 2] + inside * (np.arange(len(points)) < len(points) / 2) > 0
    for slide in (0.0, 0.3 * LONG):
        now = points + upper[:, None] * [slide, 0.0, 0.0]
        found = own_surface(points, triangles).near(now, 1e-4)
        overlap = inside & (now[:, 0] >= slide - 1e-9) & (now[:, 0] <= LONG + 1e-9)
        assert np.count_nonzero(overlap) / 2 <= len(found.row) <= np.count_nonzero(overlap)
        np.testing.assert_allclose(found.gaps, 0.0, atol=1e-12)


def test_surfaces_that_are_through_one_another_are_named_with_their_depth():
    """At rest, and where a body is put."""
    points, cells, _ = prongs((6, 2, 1))
    triangles = skin_of(points, cells)
    half, low = len(points) // 2, points[:, 2] < 0
    modes = {"upper": np.arange(half), "lower": np.arange(half, 2 * half)}

    through = points + low[:, None] * [0.25 * LONG, 0.0, 1.3 * GAP]
    inside = r"self_contact: surface '(upper|lower)' begins 0.0006 m inside surface '(upper|lower)', at"
    with pytest.raises(SceneError, match=inside):
        check_apart(through, triangles, modes, ["upper", "lower"])
    check_apart(points, triangles, modes, ["upper", "lower"])
    own = ContactPoints(modes, modes, points).own_surface(["upper", "lower"], triangles)
    solver = SelfContact(points, [], ContactLaw(), own)
    moved = low[:, None] * [0.0, 0.0, 1.1 * GAP]
    with pytest.raises(StepError, match=r"but '(upper|lower)' is 0.0002 m inside '(upper|lower)' at"):
        solver.check_start(moved, np.empty((0, 3)), [])
    solver.check_start(0 * moved, np.empty((0, 3)), [])
    with pytest.raises(SceneError, match="no contact mode 'none'; there is lower, upper"):
        ContactPoints(modes, modes, points).own_surface(["none"], triangles)
    alone = {"upper": np.array([0, 1])}
    with pytest.raises(SceneError, match="'upper': its contact points are no corners of triangles"):
        ContactPoints(alone, alone, points).own_surface(["upper"], triangles)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_pairs_are_looked_for_as_far_as_they_go_relative_to_one_another(seed):
    """Of all pairs, one by one; what moves as one is never near, however fast."""
    random = np.random.default_rng(seed)
    points, triangles = two_patches(random, random.uniform(1e-3, 2e-2))
    own, ways = own_surface(points, triangles), random.uniform(-5e-3, 5e-3, (2, 32, 3))
    most, expected = 8 * float(np.abs(ways).max()), 0.0
    for point in range(32):
        for nodes in triangles:
            if (point < 16) == (nodes[0] < 16):
                continue  # of its own patch, where it is in no box but its neighbours'
            goes = sum(np.linalg.norm(way[point] - way[nodes], axis=1).max() for way in ways)
            low, high = points[nodes].min(axis=0), points[nodes].max(axis=0)
            if np.linalg.norm(points[point] - points[point].clip(low, high)) <= goes:
                expected = max(expected, goes)
    assert own.margin(points, ways, most) >= expected * (1 - 8 * EPS)
    assert own.margin(points, ways, most) <= most
    assert own.margin(points, np.ones((1, 32, 3)), 4.0) == 0.0
