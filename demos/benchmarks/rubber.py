"""Nearly incompressible solids, whose volumes are taken in the middle of cells."""

from collections.abc import Iterator

import numpy as np
from solids import PLANE_STRAIN, Row, bar, mesh_of

import fenics_rom as fr
from fenics_rom.mechanics.step import StepInput

Array = np.ndarray


def cook(quick: bool) -> Iterator[Row]:
    """Cook's membrane of rubber, μ 80.194, κ 400,889.8, under 100 (Simo & Armero, 1992): its corner rises by 6.9."""
    bricks = (8, 8, 1) if quick else (16, 16, 1)
    for integration, nodes, degree, allowed in (
        ("full", 4, 2, 0.1), ("selective", 4, 2, 0.01), ("selective", 8, 1, 0.06 if quick else 0.02),
        ("selective", 8, 2, 0.01),
    ):  # fmt: skip
        system, rise = cook_of(bricks, integration, nodes, degree)
        cells = "" if nodes == 4 else f", hexahedra of degree {degree}"
        yield Row(f"Cook's membrane, {integration}{cells}", mesh_of(system, bricks), "its corner", 6.9, rise, allowed)


def cook_of(bricks: tuple[int, int, int], integration: str, nodes: int, degree: int) -> tuple[fr.System, float]:
    """The membrane of cells of so many nodes, and how far its corner rises."""
    shear, poisson = 80.194, 0.4999

    def place(p: Array) -> Array:
        return np.column_stack([48 * p[:, 0], 44 * p[:, 0] + p[:, 1] * (44 - 28 * p[:, 0]), p[:, 2]])

    effects = 'large_deformation = { material = "neo_hookean" }\n'
    corner = "[outputs.corner]\npoints = [[48.0, 60.0, 1.0]]"
    parts = {"supports": PLANE_STRAIN, "integration": integration, "tables": corner}
    young = 2 * shear * (1 + poisson)
    system = bar(bricks, place, young, poisson, 1.0, effects, nodes=nodes, degree=degree, **parts)
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array([0.0, 100.0, 0.0])))
    rise = float(body.displacement("corner")[0, 1])
    body.close()
    return system, rise


def pressed_cube(_quick: bool) -> Iterator[Row]:
    """Dragon Skin 10 (Yeoh) is pressed to half its height by the force of the closed form, and slides at its sides."""
    side, poisson, height = 0.02, 0.499, 0.5
    C1, C2, C3 = 36e3, 250.0, 23.0
    stretch = height**2 + 2 / height - 3  # of an incompressible one
    force = 2 * (height - height**-2) * (C1 + 2 * C2 * stretch + 3 * C3 * stretch**2) * side**2
    effects = f'large_deformation = {{ material = "yeoh", constants = [{C1}, {C2}, {C3}] }}\n'
    slides = "".join(
        f'\n[[supports.held]]\nsurface = "{surface}"\nnormal = {normal}'
        for surface, normal in (("left", [1.0, 0.0, 0.0]), ("front", [0.0, 1.0, 0.0]), ("bottom", [0.0, 0.0, 1.0]))
    )
    bricks, young = (2, 2, 2), 4 * C1 * (1 + poisson)
    system = bar(bricks, lambda p: p * side, young, poisson, 1070.0, effects, slides, "", "selective")
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array([force, 0.0, 0.0])))
    u = system.deformation.model.nodal_field(body.x)
    body.close()
    width, depth, length = (float(1 + np.ptp(u[:, axis]) / side * np.sign(u[:, axis].sum())) for axis in (1, 2, 0))
    case, mesh = "silicone cube, pressed", mesh_of(system, bricks)
    yield Row(case, mesh, "its height, shares", height, length, 0.01)
    yield Row(case, mesh, "its volume, shares", 1.0, width * depth * length, 0.01)
