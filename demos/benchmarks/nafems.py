"""NAFEMS' plates: FV32 and FV52 vibrate, LE10 is pressed; and a solid that is hot, LE11."""

import warnings
from collections.abc import Iterator

import numpy as np
from solids import MIDDLE, Row, bar, mesh_of

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning

Array = np.ndarray
LOWER_EDGES = "[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 0.0]]"
TARGETS = (45.897, 109.44, 109.44, 167.89, 193.59, 206.19, 206.19)
OF_BRICKS = (44.762, 110.52, 110.52, 169.08, 193.93, 206.64, 206.64)  # published of 4 x 4 x 1 bricks of 20 nodes
MIDDLE_LINE = "{ box = { corners = [[0.0, 0.0, 0.3], [9.0, 9.0, 0.3]] } }"


def tapered_membrane(quick: bool) -> Iterator[Row]:
    """FV32: 10 m long, 5 m to 1 m wide, 0.05 m thick; half of it, which slides in its middle plane."""

    def place(p: Array) -> Array:
        return np.column_stack([10 * p[:, 0], (p[:, 1] - 0.5) * (5 - 4 * p[:, 0]), 0.025 * p[:, 2]])

    bricks = (16, 8, 1) if quick else (32, 16, 1)
    system = bar(bricks, place, 200e9, 0.3, 8000.0, "inertia = {}\n", MIDDLE)
    γ, _ = system.algebra.eigenpairs(system.mass, system.stiffness, 6)
    for k, (published, found) in enumerate(
        zip((44.623, 130.03, 162.70, 246.05, 379.90, 391.44), np.sqrt(γ) / (2 * np.pi), strict=True), start=1
    ):
        yield Row("NAFEMS FV32", mesh_of(system, bricks), f"frequency {k}, Hz", published, float(found), 0.002)


def solid_plate(_quick: bool) -> Iterator[Row]:
    """FV52: 10 x 10 x 1 m, which rests on its lower edges and is free to slide; three motions are rigid.

    Where a line carries a solid its displacement has no limit: the finer the mesh, the softer. So these are coarse.
    """
    yield from _plate_on_edges((8, 8, 2), 4, TARGETS, 0.045)
    yield from _plate_on_edges((4, 4, 1), 20, OF_BRICKS, 0.02)


def _plate_on_edges(
    bricks: tuple[int, int, int], nodes: int, published: tuple[float, ...], off: float
) -> Iterator[Row]:
    held = f"\n[[supports.held]]\nalong = {{ points = {LOWER_EDGES} }}\nnormal = [0, 0, 1]"
    of_steel = (200e9, 0.3, 8000.0)
    system = bar(bricks, lambda p: p * (10.0, 10.0, 1.0), *of_steel, "inertia = {}\n", held, "", nodes=nodes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        mode = fr.reduce(system, method="modal", order=10).contact_models["tip"]
    frequencies = np.sqrt(mode.eigenvalues[mode.rigid :][:7]) / (2 * np.pi)
    assert mode.rigid == 3
    case = "NAFEMS FV52" if nodes == 4 else "NAFEMS FV52, hexahedra"
    for k, (target, found) in enumerate(zip(published, frequencies, strict=False), start=4):
        yield Row(case, mesh_of(system, bricks), f"frequency {k}, Hz", target, float(found), off)


def pressed_plate(quick: bool) -> Iterator[Row]:
    """LE10: a quarter of an elliptic plate, 0.6 m thick, under 1 MPa; σ_yy at D, at the upper edge of its hole."""
    yield _pressed((4, 6, 2) if quick else (10, 16, 6), 4, 0.05 if quick else 0.03)
    for bricks, off in ({(6, 8, 4): 0.01} if quick else {(6, 8, 4): 0.01, (8, 12, 4): 0.01, (8, 12, 6): 0.011}).items():
        yield _pressed(bricks, 20, off)


def _pressed(bricks: tuple[int, int, int], nodes: int, off: float) -> Row:
    """Of hexahedra evenly and curved as the ellipses are, of tetrahedra finer towards D and straight."""

    def place(p: Array) -> Array:
        finer = (1.5, 1.3) if nodes == 4 else (1.0, 1.0)
        outwards, angle = p[:, 0] ** finer[0], np.pi / 2 * p[:, 1] ** finer[1]
        x, y = (2 + 1.25 * outwards) * np.cos(angle), (1 + 1.75 * outwards) * np.sin(angle)
        return np.column_stack([x, y, 0.6 * p[:, 2]])

    sides = {"front": [0, 1, 0], "back": [1, 0, 0], "right": [1, 0, 0]}
    held = "".join(f'\n[[supports.held]]\nsurface = "{side}"\nnormal = {normal}' for side, normal in sides.items())
    held += '\n[[supports.held]]\nsurface = "right"\nnormal = [0, 1, 0]'
    held += f'\n[[supports.held]]\nall = ["right", {MIDDLE_LINE}]\nnormal = [0, 0, 1]'
    reading = '[readings.D]\nquantity = "stress"\npoints = [[2.0, 0.0, 0.6]]'
    run = 'dt = 1.0\nduration = 1.0\nload = [{ actuator = "press", force = [1e6] }]'
    press = 'pressure.press = { surface = "top" }\n'
    system = bar(bricks, place, 210e9, 0.3, 7800.0, press, held, "", tables=reading, run=run, nodes=nodes)
    _, yy, *_, spread = fr.simulate(system).readings["D"].values[-1, 0, [0, 1, -1]] / 1e6
    what = "σ_yy at D, MPa" + (f" (cells around differ by {spread:.2f})" if spread else "")
    case = "NAFEMS LE10" if nodes == 4 else "NAFEMS LE10, hexahedra"
    return Row(case, mesh_of(system, bricks), what, -5.38, float(yy), off)


def hot_solid(quick: bool) -> Iterator[Row]:
    """LE11: a quarter of a hollow solid of revolution, a sphere, then a taper, then a cylinder; σ_zz at A, inside."""
    for bricks, off in ({(4, 6, 18): 0.02} if quick else {(6, 6, 26): 0.01, (8, 8, 36): 0.01}).items():
        yield _hot(bricks, off)


def _hot(bricks: tuple[int, int, int], off: float) -> Row:
    """Of hexahedra as curved as it is: across the wall, around the axis, and along it."""
    ends = np.round(np.array([0.0, 0.34, 0.78, 1.0]) * bricks[2]) / bricks[2]

    def place(p: Array) -> Array:
        across, angle, s = p[:, 0], np.pi / 2 * p[:, 1], np.interp(p[:, 2], ends, np.arange(4.0))
        φ, taper, z = np.minimum(s, 1.0), np.clip(s - 1, 0.0, 1.0), 1.39 + 0.4 * (s - 2)
        inner = np.array([np.cos(φ * np.pi / 4), np.sin(φ * np.pi / 4) + taper * (1.39 - 0.5**0.5)])
        outer = 1.4 * np.array([np.cos(φ * np.pi / 6), np.sin(φ * np.pi / 6)])
        outer += taper * (np.array([[1.0], [1.39]]) - 1.4 * np.array([[np.cos(np.pi / 6)], [0.5]]))
        inner[1], outer[1] = (np.where(s > 2, z, part[1]) for part in (inner, outer))
        r, z = (1 - across) * inner + across * outer
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])

    sides = {"front": [0, 1, 0], "back": [1, 0, 0], "bottom": [0, 0, 1], "top": [0, 0, 1]}
    held = "".join(f'\n[[supports.held]]\nsurface = "{side}"\nnormal = {normal}' for side, normal in sides.items())
    heat = 'temperature.heat = { field = "sqrt(x**2 + y**2) + z", amplitude = 1.0 }\n'
    reading = '[readings.A]\nquantity = "stress"\npoints = [[1.0, 0.0, 0.0]]'
    of_steel, run = (210e9, 0.3, 7800.0), "dt = 1.0\nduration = 1.0"
    system = bar(bricks, place, *of_steel, heat, held, "", tables=reading, run=run, nodes=27, expansion="2.3e-4")
    zz = fr.simulate(system).readings["A"].values[-1, 0, 2] / 1e6
    return Row("NAFEMS LE11", mesh_of(system, bricks), "σ_zz at A, MPa", -105.0, float(zz), off)
