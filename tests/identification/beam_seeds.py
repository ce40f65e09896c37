"""`python tests/identification/beam_seeds.py [SEEDS]`: how often intervals hold the truth of a beam that bends largely.

A silicone beam, 100 x 30 x 30 mm, is held level at one end and let go, alone and with 52 g at its tip. A camera sees
three markers at the tip 100 times a second, with 0.05 mm of noise, which is another one for each seed. E, ν, ρ, α and β
are sought from start values that are 5 to 20 % off. A seed takes about a minute.
"""

import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from bodies import box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.scene.file import parse_scene

TRUTH = {"young": 2.6e5, "poisson": 0.47, "density": 1070.0, "alpha": 1.0, "beta": 2.5e-3}
START = {"young": 3.0e5, "poisson": 0.45, "density": 1150.0, "alpha": 1.2, "beta": 3e-3}
NOISE = 5e-5  # m
LOADS = ("", "point_masses.weight = { point = [0.1, 0.015, 0.015], mass = 0.052 }")
DURATION = 0.6  # s: some four periods alone


def beam(mesh: Path, values: dict[str, float], more: str, duration: float) -> fr.Scene:
    """The beam for a time, s; `more` goes into its effects."""
    return parse_scene(f"""
[mesh]
file = "{mesh}"
degree = 2
[material]
young = {values["young"]!r}
poisson = {values["poisson"]!r}
density = {values["density"]!r}
[supports]
clamped = ["left"]
[contacts.tip]
surface = "right"
[outputs.tip]
points = [[0.1, 0.015, 0.03], [0.1, 0.0, 0.024], [0.1, 0.03, 0.006]]
[effects]
inertia = {{}}
damping = {{ alpha = {values["alpha"]!r}, beta = {values["beta"]!r} }}
gravity = {{ acceleration = [0.0, 0.0, -9.81] }}
large_deformation = {{}}
{more}
[run]
dt = 0.005
duration = {duration!r}
""")


def filmed(file: Path, run: fr.Trajectory, rng: np.random.Generator) -> Path:
    """What the camera sees in every second step."""
    seen = run.outputs["tip"][2::2].reshape(-1, 9)
    rows = np.column_stack([run.times[2::2], 1e3 * (seen + NOISE * rng.standard_normal(seen.shape))])
    heading = ",".join(["time (s)", *(f"tip[{k}].{axis} (mm)" for k in range(3) for axis in "xyz")])
    np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=heading, comments="")
    return file


def found(
    folder: Path, seeds: Iterable[int], duration: float = DURATION, sought: Sequence[str] | None = None
) -> Iterator[fr.Identification]:
    """What is found with each seed, of recordings of a duration, s; what is not sought is as it is."""
    mesh = write_arrays(folder / "beam.msh", *box_arrays((0.1, 0.03, 0.03), (4, 1, 1)))
    start = {name: (TRUTH if sought and name not in sought else START)[name] for name in TRUTH}
    scenes = [beam(mesh, start, more, duration) for more in LOADS]
    runs = [fr.simulate(beam(mesh, TRUTH, more, duration)) for more in LOADS]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        data = [
            read_markers(filmed(folder / "film.csv", run, rng), scene) for run, scene in zip(runs, scenes, strict=True)
        ]
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
            yield fr.identify(scenes[0], data, parameters=sought)


def holding(result: fr.Identification) -> list[str]:
    """The parameters whose intervals hold the truth."""
    return [
        one.parameter.name
        for one in result.found
        if one.low is not None and one.high is not None and one.low <= TRUTH[one.parameter.name] <= one.high
    ]


def main() -> None:
    """Prints how often each interval holds the truth, and how often all do."""
    seeds, held, whole = int(sys.argv[1]) if len(sys.argv) > 1 else 20, Counter[str](), 0
    with tempfile.TemporaryDirectory() as folder:
        for seed, result in enumerate(found(Path(folder), range(seeds))):
            names = holding(result)
            held.update(names)
            whole += len(names) == len(TRUTH)
            print(f"seed {seed}: {', '.join(names)}", flush=True)
    print(f"of {seeds}: {', '.join(f'{name} {held[name]}' for name in TRUTH)}; all at once {whole}")


if __name__ == "__main__":
    main()
