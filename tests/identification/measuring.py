"""Scenes to identify, and what markers on them would show, by full-order runs."""

import csv
import warnings
from pathlib import Path

import numpy as np
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.scene.file import parse_scene

RUN = 'dt = 0.01\nduration = 0.6\nload = [{ contact = "right", stop = 0.2, force = [1.0, 2.0, 3.0] }]'
TRUTH = {"young": 2e4, "poisson": 0.35, "density": 1200.0, "alpha": 2.0, "beta": 5e-3}
START = {"young": 1.2e4, "poisson": 0.2, "density": 1500.0, "alpha": 1.0, "beta": 1e-2}
PUSHES = [("right", (0.0, 0.0, 2.0)), ("top", (1.0, 0.5, 0.0)), ("right", (0.0, 1.0, 0.0))]
POINTS = {"outputs.tip": "points = [[1.0, 0.0, 0.3], [1.0, 0.4, 0.3]]", "outputs.side": "points = [[0.5, 0.0, 0.1]]"}


def box_mesh(folder: Path, bricks=(3, 1, 1)) -> Path:
    return write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), bricks, shake=0.2))


def text_of(mesh: Path, values: dict[str, float], more: str = "", **parts: str | None) -> str:
    """A box of one material with marker points; `more` goes into its effects."""
    damping = f"damping = {{ alpha = {values['alpha']!r}, beta = {values['beta']!r} }}"
    return scene_text(
        mesh,
        **{
            "material": "\n".join(f"{key} = {values[key]!r}" for key in ("young", "poisson", "density")),
            "effects": f"inertia = {{}}\n{damping}\n{more}",
            "run": RUN,
            **POINTS,
            **parts,
        },
    )


def scene_of(mesh: Path, values: dict[str, float], more: str = "", tables=None, **parts: str | None) -> fr.Scene:
    return parse_scene(text_of(mesh, values, more, **parts), tables=tables)


def film(file: Path, scene: fr.Scene, *, every: int = 2, noise: float = 0.0, seed: int = 0) -> Path:
    """What markers show in the scene's run, at its steps, in mm."""
    run, rng = fr.simulate(scene), np.random.default_rng(seed)
    markers = [("tip[0]", "tip", 0), ("tip[1]", "tip", 1), ("side", "side", 0)]
    rows = []
    for n in range(every, run.steps + 1, every):
        seen = np.concatenate([run.outputs[name][n, point] for _, name, point in markers])
        rows.append([float(run.times[n]), *(1e3 * (seen + noise * rng.standard_normal(9))).tolist()])
    write(file, ["time (s)", *(f"{place}.{axis} (mm)" for place, _, _ in markers for axis in "xyz")], rows)
    return file


def weigh(file: Path, scene: fr.Scene, pushes: list[tuple[str, tuple[float, float, float]]], loads=()) -> Path:
    """What the tip shows at rest under forces and values of loads, in m."""
    system = fr.assemble(scene)
    factor = system.algebra.factor((1.0, system.stiffness))
    rows = []
    for contact, force in pushes:
        x = factor.solve(system.input_matrix(contact) @ np.concatenate([force, loads])[:, None])
        rows.append([contact, *force, *system.algebra.inner(system.outputs["tip"], x)[:, 0].tolist()])
    factor.close()
    heading = ["contact", *(f"force.{axis} (N)" for axis in "xyz")]
    write(file, [*heading, *(f"tip[{k}].{axis} (m)" for k in (0, 1) for axis in "xyz")], rows)
    return file


def write(file: Path, heading: list[str], rows: list[list[object]]) -> None:
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(heading)
        writer.writerows(rows)


def found_by(scene, data, **choice):
    """The result, and what it warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FenicsRomWarning)
        result = fr.identify(scene, data, **choice)
    said = tuple(str(one.message) for one in caught if issubclass(one.category, FenicsRomWarning))
    assert said == result.warnings
    return result
