"""What a body feels in one run of a world: the largest force and pressure, and the energy that it is given."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.load_history import count_steps
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.certificate_checks import joined_to
from fenics_rom.scene.world_format import WorldScene
from fenics_rom.world.records import RigidBody
from fenics_rom.world.world import World
from fenics_rom.world_run import inputs_at, make_world

QUANTITIES = {"force": "N", "pressure": "Pa", "energy": "J"}
GROWS = 1e-4  # in a step, of what is felt: less than that is of a body that swings on, and of round-off


class Impact(NamedTuple):
    """A run of so many steps.

    Attributes:
        times: (S,) ends of the steps, s.
        felt: (S, 3) by QUANTITIES: the size of the sum of the forces that hit; the largest pressure on a node of the
            body, or of those that hit it where it is rigid; work of all that pushes the body and what is joined to it.
        warnings: of the run.
    """

    times: Array
    felt: Array
    warnings: tuple[str, ...]

    @property
    def peaks(self) -> Array:
        """(3,) the largest, at least 0."""
        return np.maximum(self.felt.max(axis=0), 0.0)


def strike(scene: WorldScene, roms: Mapping[str, Rom], dt: float) -> Impact:
    """Runs a world through its load history.

    Args:
        scene: with a certificate.
        roms: models of its soft bodies.
        dt: time step, s.

    Raises:
        SceneError, StepError: as `make_world` and its steps.
    """
    file = scene.file
    assert file.run is not None
    assert file.certificate is not None
    world = make_world(scene, dt, roms)
    hit, by = file.certificate.body, file.certificate.by
    group = joined_to(hit, file)
    skins = [name for name in ((hit,) if _is_soft(world, hit) else by) if _is_soft(world, name)]
    steps = count_steps(file.run.duration, dt, 1)
    felt = np.zeros((steps, len(QUANTITIES)))
    for step in range(steps):
        world.step(inputs_at(scene, (step + 0.5) * world.dt, world))
        force = np.sum([world.force_between(hit, name) for name in by], axis=0)
        pressure = 0.0
        if force.any() and skins:
            pressure = max(float(world.simulator(name).contact_pressure().max()) for name in skins)
        energy = sum(world.account(name).obstacles for name in group)
        felt[step] = np.linalg.norm(force), pressure, energy
    return Impact(dt * np.arange(1, steps + 1), felt, world.warnings)


def check_end(impact: Impact) -> None:
    """A SceneError of a run that ends while something that is felt still grows."""
    before, last = np.vstack([np.zeros(len(QUANTITIES)), impact.felt])[-2:]
    grows = (last >= impact.felt.max(axis=0)) & (last - before > GROWS * last)
    if grows.any():
        quantity = [*QUANTITIES][int(grows.argmax())]
        raise SceneError(f"the {quantity} still grows when the run ends, at {impact.times[-1]:g} s; use a longer one")


def _is_soft(world: World, name: str) -> bool:
    return not isinstance(world.bodies[name], RigidBody)
