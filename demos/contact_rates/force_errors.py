"""How far contact forces of a pad are off while it settles, beside what full order itself leaves open."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pads import SIZE, STEP
from touching import DEGREE, FINER, run_moved, slid

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

COMPARED = ("sticks", "in part slides", "slides", "on a ball, sticks")  # with full order
WAY = 0.075 * DEGREE  # m, as far as turning the pad moves its sides

Array = np.ndarray


def table_of_errors(rom: fr.Rom, scenes: dict[str, fr.Scene], out: Path) -> dict[str, list[float]]:
    """Errors of the force of the obstacle against full order, in the 2-norm from the start on.

    Of a case: with and without residual compliance, and of full order at smaller steps and on another mesh.
    """
    errors = {}
    for name, scene in scenes.items():
        full = fr.simulate(scene)
        sensitive = [*(fr.simulate(scene, dt=STEP / n) for n in FINER), run_moved(scene, full, moved_aside)]
        contact = replace(scene.effects.contact, residual_compliance=False)
        stiff = replace(scene, effects=replace(scene.effects, contact=contact))
        runs = fr.simulate(rom, scene=scene), fr.simulate(rom, scene=stiff), *sensitive
        (obstacle,) = full.forces
        errors[name] = [fr.compare(run, full)[f"force of {obstacle}"].relative for run in runs]
    rows = [(name, *(f"{each:.1e}" for each in several)) for name, several in errors.items()]
    heading = (
        "error of the force, while it settles",
        "reduced",
        "without residual compliance",
        *FINER.values(),
        "full order, nodes 1.3 mm aside",
    )
    table = markdown(heading, rows)
    (out / "errors.md").write_text(table)
    print(table)
    return errors


def moved_aside(nodes: Array) -> Array:
    """Nodes (N, 3), m, of the same pad, moved along its sides."""
    for axis in (0, 1):
        nodes = slid(nodes, axis=axis, ends=(0.0, SIZE[axis]), way=WAY / np.sqrt(2))
    return nodes
