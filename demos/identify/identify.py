"""Material and damping of a soft body, from where markers on it were seen.

    python demos/identify/identify.py

A silicone tongue, 0.1 x 0.1 x 0.02 m, is held at its root. A camera sees three markers on it, with a noise of 0.1 mm:
while a corner of the tip is pushed for 0.1 s and let go, 400 times a second, and at rest under eight known forces. Here
the camera is a run on a finer mesh with smaller steps, so that the truth is known. The script

1. identifies Young's modulus, Poisson's ratio, density and damping from start values that are far off;
2. does so without noise: what is then left is the error of mesh and time step, which no interval counts;
3. tries to find the density from the data at rest alone, which know nothing of it.

Everything is written to demos/identify/out/. The checks at the end fail if a claim does not hold.
"""

import csv
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gmsh
import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.effects import Damping

HERE = Path(__file__).parent
OUT = HERE / "out"

TRUTH = {"young": 3.45e6, "poisson": 0.45, "density": 1187.4, "alpha": 10.0, "beta": 1e-3}  # Pa, 1, kg/m3, 1/s, s
NOISE = 1e-4  # m
RATE = 400  # frames per second
ACROSS = 3  # cells through the thickness of the mesh that the camera sees; the model has 2
MARKERS = [("tip", 0), ("tip", 1), ("back", 0)]
PUSHES = [  # contact mode and force (N), at rest
    ("left", (0.0, 0.0, 1.5)),
    ("left", (0.0, 0.0, -1.5)),
    ("right", (0.0, 0.0, 1.5)),
    ("right", (0.0, 0.0, -1.5)),
    ("left", (0.0, 10.0, 1.0)),
    ("right", (0.0, -10.0, 1.0)),
    ("left", (20.0, 0.0, -1.0)),
    ("right", (-20.0, 0.0, -1.0)),
]


def main() -> None:
    """Runs the demo."""
    OUT.mkdir(exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # the report lists them
    camera()
    scene = fr.read_scene(HERE / "tongue.toml")
    start = time.perf_counter()
    found = fr.identify(scene, [OUT / "motion.csv", OUT / "rest.csv"])
    seconds = time.perf_counter() - start
    fr.write_identification(OUT, found)
    exact = fr.identify(scene, [OUT / "exact_motion.csv", OUT / "exact_rest.csv"])
    blind = fr.identify(scene, [OUT / "rest.csv"], parameters=["young", "poisson", "density"])

    rows = []
    for one, without_noise in zip(found.estimates, exact.estimates, strict=True):
        name, unit = one.parameter.name, one.parameter.unit
        values = (TRUTH[name], one.parameter.start, one.value, one.low, one.high, without_noise.value)
        rows.append((name, unit, *(f"{value:.5g}" for value in values)))
    table = markdown(("parameter", "unit", "truth", "start", "found", "95 % from", "to", "without noise"), rows)
    (OUT / "found.md").write_text(table)
    size = fr.assemble(scene).size
    print(
        f"{len(found.experiment.measured)} values with a noise of {1e3 * NOISE:g} mm; {1e3 * found.noise:.3g} mm found."
    )
    print(f"{size:,} unknowns, {found.order} in the reduced model, {found.bases} bases, {seconds:.0f} s\n\n{table}")
    print(f"From the data at rest alone: {blind.warnings[-1]}\n")
    check(found, exact, blind)


def camera() -> None:
    """Writes what the camera sees, with noise and without."""
    guess = fr.read_scene(HERE / "tongue.toml")
    assert guess.run is not None
    truth = replace(
        guess,
        mesh_file=mesh_of(OUT / "finer.msh", ACROSS),
        materials={
            "material": replace(guess.materials["material"], **{k: TRUTH[k] for k in ("young", "poisson", "density")})
        },
        effects=replace(guess.effects, damping=Damping(TRUTH["alpha"], TRUTH["beta"])),
        run=replace(guess.run, dt=guess.run.dt / 2),
    )
    system = fr.assemble(truth)
    run = fr.simulate(system)
    every = round(1 / (RATE * truth.run.dt))  # type: ignore[union-attr]
    frames = np.arange(every, run.steps + 1, every)
    moved = np.stack([run.outputs[name][frames, point, 2] for name, point in MARKERS], axis=1)

    factor = system.algebra.factor((1.0, system.stiffness))
    rested = []
    for contact, force in PUSHES:
        x = factor.solve(system.contacts[contact] @ np.array(force)[:, None])
        seen = {name: system.algebra.inner(C, x).reshape(-1, 3) for name, C in system.outputs.items()}
        rested.append(np.concatenate([seen[name][point] for name, point in MARKERS]))
    factor.close()

    places = [name if name == "back" else f"{name}[{point}]" for name, point in MARKERS]
    rng = np.random.default_rng(0)
    for prefix, noise in (("exact_", 0.0), ("", NOISE)):
        times = [(f"{time:.6g}",) for time in run.times[frames]]
        seen = moved + noise * rng.standard_normal(moved.shape)
        write(OUT / f"{prefix}motion.csv", ["time (s)", *(f"{place}.z (mm)" for place in places)], times, seen)
        seen = np.array(rested) + noise * rng.standard_normal((len(PUSHES), 3 * len(MARKERS)))
        heading = ["contact", *(f"force.{axis} (N)" for axis in "xyz")]
        heading += [f"{place}.{axis} (mm)" for place in places for axis in "xyz"]
        write(OUT / f"{prefix}rest.csv", heading, [(contact, *force) for contact, force in PUSHES], seen)


def write(file: Path, heading: list[str], left: Sequence[tuple[object, ...]], seen: np.ndarray) -> None:
    """A file of marker data: displacements (m) become mm."""
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(heading)
        for first, row in zip(left, seen, strict=True):
            writer.writerow([*first, *(f"{1e3 * value:.7g}" for value in row)])


def mesh_of(file: Path, across: int) -> Path:
    """Meshes tongue.geo with a number of cells through the thickness."""
    geometry = OUT / "tongue.geo"
    geometry.write_text((HERE / "tongue.geo").read_text().replace("across = 2", f"across = {across}"))
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.open(str(geometry))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()
    return file


def close(one: fr.Scene, other: fr.Scene) -> bool:
    """Whether two scenes have the same material and mesh, to the digits that are written."""
    a, b = one.materials["material"], other.materials["material"]
    values = ((a.young, b.young), (a.poisson, b.poisson), (a.density, b.density))
    return one.mesh_file.samefile(other.mesh_file) and all(abs(x / y - 1) < 1e-6 for x, y in values)


def check(found: fr.Identification, exact: fr.Identification, blind: fr.Identification) -> None:
    """The claims of this page, measured."""
    bias = {name: value - TRUTH[name] for name, value in exact.values.items()}
    within = {
        f"{one.parameter.name} is in its interval": not one.held and one.low <= TRUTH[one.parameter.name] <= one.high
        for one in found.estimates
    }
    claims = within | {
        "mesh and time step move no parameter by more than half of half its interval": all(
            abs(bias[one.parameter.name]) < (one.high - one.low) / 4 for one in found.found
        ),
        "the noise is told to 10 %": abs(found.noise / NOISE - 1) < 0.1,
        "the full order leaves what the reduced model leaves, to 1e-4": abs(found.full_residual / found.residual - 1)
        < 1e-4,
        "at rest, without gravity, density is not determined": [
            one.parameter.name for one in blind.estimates if one.held
        ]
        == ["density"],
        "the scene that was written is the one that was found": close(
            fr.read_scene(OUT / "identified.toml"), found.scene
        ),
    }
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
