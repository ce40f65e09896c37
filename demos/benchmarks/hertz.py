"""Hertz: elastic balls on a rigid plane, on one another, and on a block (Johnson, Contact Mechanics, 1985, ch. 4).

Frictionless bodies of revolution that approach one another by δ touch within a = √(R δ), 1/R the sum of their
curvatures, and press with F = 4/3 E* √R δ^1.5, 1/E* = Σ (1 - ν²)/E, by at most 3 F / (2 π a²) in the middle. Theory is
of half-spaces, a << R. What a ball on a plane feels is read by taxels, rings of the sector that the wedge shows.

A body is a thin wedge about its axis of symmetry, whose sides slide in their planes; what 2π of it feel is told. It has
no inertia: every step ends in an equilibrium. Of two soft bodies the upper one is carried down by a hand. Balls are
held where they are cut, at half of their height, and not far away, as theory has it: that is not corrected.
"""

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import gmsh
import numpy as np
from boxes import msh, outer_triangles
from solids import Row

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Sphere

Array = np.ndarray
ANGLE, POISSON = np.radians(6.0), 0.3
PATCH, GROWS = 2.2, 0.5  # of a: how far there are contact points, and per m: how elements grow beyond 1.5 a
STEPS, ORDER, AWAY = 4, 40, 5.0  # m, where the hand is
TAXELS = 20  # rings, of PATCH a / 20
FELT = 0.03  # of the peak pressure and the area, beside theory
ALLOWED, EXACT = 0.02, 1e-6  # of force: beside theory; of order 40 beside full order, as contact is exact at rest


class Solid(NamedTuple):
    """Half a ball, or half a ball's flat side, that is held where it is cut or round; it touches at the origin."""

    young: float  # Pa
    size: float  # m, radius
    is_ball: bool = True

    @property
    def curvature(self) -> float:
        """At the origin, 1/m."""
        return 1 / self.size if self.is_ball else 0.0


def hertz_force(solids: list[Solid], depth: float) -> float:
    """N, at an approach, m; of one solid on a rigid plane."""
    young = 1 / sum((1 - POISSON**2) / each.young for each in solids)
    return float(4 / 3 * young / np.sqrt(sum(each.curvature for each in solids)) * depth**1.5)


def section(solid: Solid, a: float, fine: float) -> tuple[Array, Array]:
    """Radii and heights (N, 2), m, and triangles of half of a section, fine within 1.5 a of the origin."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, (low, beside) = gmsh.model.geo, (-solid.size, -solid.size if solid.is_ball else 0.0)
        top, bottom, rim = (geo.addPoint(*at, 0.0) for at in ((0.0, 0.0), (0.0, low), (solid.size, beside)))
        arc = geo.addCircleArc(top, bottom, rim) if solid.is_ball else geo.addCircleArc(rim, top, bottom)
        flat = geo.addLine(rim, bottom) if solid.is_ball else geo.addLine(top, rim)
        outline = [arc, flat] if solid.is_ball else [flat, arc]
        geo.addPlaneSurface([geo.addCurveLoop([*outline, geo.addLine(bottom, top)])])
        geo.synchronize()
        field = gmsh.model.mesh.field.add("MathEval")
        gmsh.model.mesh.field.setString(field, "F", f"{fine} + {GROWS} * max(0, sqrt(x*x + y*y) - {1.5 * a})")
        gmsh.model.mesh.field.setAsBackgroundMesh(field)
        for other in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{other}", 0)
        gmsh.model.mesh.generate(2)
        tags, places, _ = gmsh.model.mesh.getNodes()
        row = np.zeros(int(tags.max()) + 1, dtype=int)
        row[tags.astype(int)] = np.arange(len(tags))
        used, triangles = np.unique(row[gmsh.model.mesh.getElementsByType(2)[1].astype(int)], return_inverse=True)
        return places.reshape(-1, 3)[used, :2], triangles.reshape(-1, 3)
    finally:
        gmsh.finalize()


def wedge(places: Array, triangles: Array) -> tuple[Array, Array]:
    """Points (P, 3), m, and tetrahedra of a section turned by ANGLE; a triangle gives three, less on the axis."""
    on_axis = places[:, 0] < 1e-12 * places[:, 0].max()
    radius, other = np.where(on_axis, 0.0, places[:, 0]), np.arange(len(places))
    other[~on_axis] = len(places) + np.arange((~on_axis).sum())
    sides = [np.column_stack([radius * np.cos(s), radius * np.sin(s), places[:, 1]]) for s in (-ANGLE / 2, ANGLE / 2)]
    first = np.sort(triangles, axis=1)
    second = other[first]
    cells = np.concatenate([np.hstack([first[:, : k + 1], second[:, k:]]) for k in range(3)])
    whole = (np.diff(np.sort(cells, axis=1), axis=1) > 0).all(axis=1)
    return np.concatenate([sides[0], sides[1][~on_axis]]), cells[whole]


def assemble(solid: Solid, a: float, fine: float, degree: int, upper: bool) -> fr.System:
    """A wedge of it; the upper one is the other way up, and may be carried."""
    places, triangles = section(solid, a, fine)
    points, cells = wedge(places, triangles)
    outer = outer_triangles(cells)
    x, y, z = (points[outer][..., k] for k in range(3))
    r, s, c = np.hypot(x, y), np.sin(ANGLE / 2), np.cos(ANGLE / 2)
    small = 1e-9 * solid.size
    left, right = ((np.abs(s * x + sign * c * y) < small).all(axis=1) for sign in (1, -1))
    far = (z < small - solid.size) if solid.is_ball else (np.abs(r * r + z * z - solid.size**2) < small * solid.size)
    held = far.all(axis=1)
    pole = (r < PATCH * a).all(axis=1) & ~(left | right | held)
    surfaces = {"left": outer[left], "right": outer[right], "held": outer[held], "pole": outer[pole]}
    up = -1.0 if upper else 1.0
    points = points * [1.0, 1.0, up]
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "wedge.msh"
        mesh.write_text(msh(points, {2: surfaces, 3: {"body": cells}}))
        return fr.assemble(
            parse_scene(f"""
frame = "{"moving" if upper else "fixed"}"
[mesh]
file = "{mesh}"
degree = {degree}
[material]
young = {solid.young}
poisson = {POISSON}
density = 1000.0
[supports]
clamped = ["held"]
[[supports.held]]
surface = "left"
normal = [{s}, {c}, 0.0]
[[supports.held]]
surface = "right"
normal = [{s}, {-c}, 0.0]
[contacts.pole]
surface = "pole"
[outputs.skin]
quantity = "touch"
surface = "pole"
taxels = {{ rows = 1, columns = {TAXELS}, along = [1, 0, 0] }}
[effects.contact.obstacles.plane]
shape = "half-space"
point = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, {-up}]
[run]
dt = {1 / STEPS}
duration = 1.0
""")
        )


def lowered(t: float, depth: float) -> fr.BaseState:
    """The hand at a time, s."""
    return fr.BaseState(
        np.array([0, 0, AWAY - depth * t]), np.array([1.0, 0, 0, 0]), np.array([0, 0, -depth]), np.zeros(3)
    )


def forces_on_plane(model: fr.System | fr.Rom, depth: float) -> Array:
    """Of a ball on which a plane is pressed by a depth, m, in STEPS, N."""
    run = fr.simulate(model, signals={"plane": lambda t: [0.0, 0.0, -depth * t]})
    return -run.forces["plane"][-STEPS:, 2] * 2 * np.pi / ANGLE


def felt_on_plane(model: fr.System | fr.Rom, depth: float) -> tuple[float, float]:
    """The largest pressure of taxels, Pa, and the area of contact, m², of a ball on which a plane is pressed."""
    felt = fr.simulate(model, signals={"plane": lambda t: [0.0, 0.0, -depth * t]}).readings["skin"].touch
    return float(felt.pressures[-1].max()), float(felt.area[-1]) * 2 * np.pi / ANGLE


def forces_between(roms: list[fr.Rom], depth: float) -> Array:
    """Of two bodies that approach one another by a depth, m, in STEPS, N."""
    hand = fr.RigidBody(Sphere(1e-3), motion=partial(lowered, depth=depth))
    low, up = fr.SoftBody(roms[0]), fr.SoftBody(roms[1], on="hand", position=(0.0, 0.0, -AWAY))
    world, forces = fr.World({"hand": hand, "low": low, "up": up}, 1 / STEPS), np.zeros(STEPS)
    for step in range(STEPS):
        world.step()
        forces[step] = world.force_between("up", "low")[2] * 2 * np.pi / ANGLE
    return forces


def hertz(quick: bool) -> Iterator[Row]:
    """A ball on a plane, two balls, and, not with quick, a ball on a block at order 40; beside theory and full order.

    Of two soft bodies all modes are the full order: on a mesh that is coarse enough to have them all.
    """
    ball, other, block = Solid(1e5, 0.010), Solid(2e5, 0.015), Solid(5e4, 0.030, is_ball=False)
    a = 0.02 * ball.size
    pairs = {"ball on a plane": [ball], "two balls": [other, ball], "ball on a block": [block, ball]}
    for what, solids in list(pairs.items())[: 2 if quick else 3]:
        case, depth = f"Hertz, {what}", a**2 * sum(each.curvature for each in solids)
        edges = 6 if not quick else 3 if other in solids else 4
        systems = wedges(solids, a, edges, 2)
        mesh = f"{edges} edges on a, {' and '.join(f'{each.size:,}' for each in systems)} unknowns"
        forces = pressed([fr.reduce(system, order=ORDER) for system in systems], depth)
        for k in (STEPS // 2, STEPS):
            told = f"force at a = {a / ball.size * np.sqrt(k / STEPS):.3f} R, order {ORDER}, µN"
            yield Row(case, mesh, told, 1e6 * hertz_force(solids, depth * k / STEPS), 1e6 * forces[k - 1], ALLOWED)
        if len(solids) == 1:
            full = forces_on_plane(systems[0], depth)[-1]
            yield Row(case, mesh, "the same, full order, µN", 1e6 * hertz_force(solids, depth), 1e6 * full, ALLOWED)
            peak, area = 1.5 * hertz_force(solids, depth) / (np.pi * a**2), np.pi * a**2
            for told, model in (("full order", systems[0]), (f"order {ORDER}", fr.reduce(systems[0], order=ORDER))):
                pressure, touched = felt_on_plane(model, depth)
                yield Row(case, mesh, f"largest pressure of {TAXELS} taxels, {told}, Pa", peak, pressure, FELT)
                yield Row(case, mesh, f"area of contact, {told}, mm²", 1e6 * area, 1e6 * touched, FELT)
        else:
            edges = 3 if quick else 4
            systems = wedges(solids, a, edges, 1)
            mesh = f"linear, {edges} edges on a, {' and '.join(f'{each.size:,}' for each in systems)} unknowns"
            full = pressed([fr.reduce(each, order=each.elastic_size, method="modal") for each in systems], depth)[-1]
            forces = pressed([fr.reduce(system, order=ORDER) for system in systems], depth)
        yield Row(case, mesh, f"order {ORDER}, beside full order, µN", 1e6 * full, 1e6 * forces[-1], EXACT)


def wedges(solids: list[Solid], a: float, edges: int, degree: int) -> list[fr.System]:
    """The first, and what is above it, with so many edges on a, and a tenth less, so that nodes do not meet nodes."""
    return [assemble(each, a, (1 + 0.1 * k) * a / edges, degree, k == 1) for k, each in enumerate(solids)]


def pressed(roms: list[fr.Rom], depth: float) -> Array:
    """Of one on a plane, or of two, N, in STEPS."""
    return forces_on_plane(roms[0], depth) if len(roms) == 1 else forces_between(roms, depth)
