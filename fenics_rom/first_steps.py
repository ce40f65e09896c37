"""What the steps of a model need is compiled, and kept on disk, before the first run."""

from os import PathLike
from pathlib import Path

import numpy as np

from fenics_rom.compilation import compiled
from fenics_rom.errors import MissingPackageError
from fenics_rom.io.given import object_or_file
from fenics_rom.lazy_import import load
from fenics_rom.rom.file import ROM_FILE
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch import Batch
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.scene.world_format import WorldScene

STEP = 1e-3  # s, of a ROM without a run


def compile_steps(model: Rom | WorldScene | str | PathLike[str]) -> None:
    """Compiles what steps, rollouts and batches of a model need, by taking a few; it is kept on disk.

    Args:
        model: a ROM, what `read_world` gives, or the name of the file of one.

    Raises:
        MissingPackageError: nothing compiles, as there is no numba.
        SceneError: it is neither a ROM nor a world.
        FileError: the file cannot be read.
        StepError: a step could not be taken.

    Example:
        >>> fr.compile_steps("plate.h5")  # doctest: +SKIP
    """
    if not compiled():
        raise MissingPackageError(
            'nothing is compiled here: pip install "fenics-rom[fast]", and unset FENICS_ROM_COMPILED'
        )
    if isinstance(model, str | PathLike) and Path(model).suffix == ".toml":
        model = load("scene.world_file", "read_world")(model)
    if isinstance(model, WorldScene):
        world = load("world_run", "make_world")(model)  # here, as it needs more than the runtime
        for _ in range(2):
            world.step()
        return
    rom: Rom = object_or_file("compile_steps", model, ROM_FILE)
    run = rom.environment.run
    dt = STEP if run is None else run.dt
    body, batch = Simulator(rom, dt), Batch(rom, 2, dt)
    body.step(np.zeros(body.inputs))
    body.rollout(np.zeros((2, body.inputs)))
    batch.step(np.zeros((2, body.inputs)))
