"""Some of the scenes of random_scenes.py: 2,000 are `python tests/random_scenes.py 2000`."""

from contextlib import closing

import numpy as np
import pytest
from drawn_scenes import drawn
from random_scenes import advance, begin, begin_whole, in_all_modes, outcome

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

FOUND = (27, 40, 50, 98, 510, 1810)  # that broke a law once
SEEDS = (*range(1, 11), *FOUND)
MORE = (pytest.param(seed, marks=pytest.mark.slow) for seed in range(11, 21))


@pytest.mark.parametrize("seed", [*SEEDS, *MORE])
def test_random_scene_keeps_all_laws(tmp_path, seed):
    found = outcome(seed, tmp_path)
    assert found.broken == []
    assert found.kept or found.refused


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_forces_that_sweeps_halve_slowly_are_found_to_round_off(tmp_path):
    """Reduced and at full order, where a volume that is given and contact take long steps by turns."""
    scene = drawn(31, tmp_path)
    system = fr.assemble(parse_scene(scene.text))
    rom = in_all_modes(system)
    reduced = fr.Simulator(rom, scene.dt, signals=scene.signals, stepper="newton")
    begin(reduced, scene)
    with closing(FullOrderSimulator(system, scene.dt, system.scene.environment, scene.signals)) as whole:
        begin_whole(whole, scene, rom)
        for step in range(2):
            for body in (reduced, whole):
                advance(body, scene, step)
        assert whole.stepper.contact is not None
        missed = np.abs(reduced.displacement() - whole.displacement()).max()
        assert missed <= 1e-11 * np.abs(whole.displacement()).max()
