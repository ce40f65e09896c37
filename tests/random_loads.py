"""`python tests/random_loads.py [COUNT]`: equilibria of soft robots under random loads of up to twice the demos'.

Each is reached, or the limit point that the body comes to is named. They are the fingers of the demos finger and
bending and the trunk of robots, an arm on eight cables, of degree 1, without obstacles and inertia; half of the loads
also push one of the contacts, in any direction.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import SolverError
from fenics_rom.mechanics.step import StepInput
from fenics_rom.scene.effects import LargeDeformation

DEMOS = Path(__file__).parents[1] / "demos"
LARGEST = {  # N and Pa, twice the demo's; forces of contact are the larger the softer the other loads make it
    "finger/finger": {"air": 2e4, "flexor": 5.8, "extensor": 4.4, "push": 4.0},
    "bending/bending": {"air": 1e4, "flexor": 24.0, "push": 4.0},
    "robots/trunk": dict.fromkeys(
        (f"{length}_{side}" for length in ("long", "short") for side in ("north", "west", "south", "east")), 1.0
    )
    | {"push": 0.1},
}
MATERIALS = ("neo_hookean", "st_venant_kirchhoff")


def robot(demo: str, law: str) -> fr.System:
    """That of a demo."""
    scene = fr.read_scene(DEMOS / f"{demo}.toml")
    left_out = dict.fromkeys(("inertia", "damping", "contact", "friction"))
    effects = replace(scene.effects, **left_out, large_deformation=LargeDeformation(law))
    return fr.assemble(replace(scene, degree=1, effects=effects))


def random_loads(system: fr.System, largest: dict[str, float], count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Contact mode and input."""
    random = np.random.default_rng(0)
    for k, contact in zip(range(count), count * list(system.contacts), strict=False):
        columns = system.contacts[contact].shape[1]
        push = random.standard_normal(3)
        push *= (k % 2) * largest["push"] * random.random() / np.linalg.norm(push)
        spread = np.tile(push / (columns // 3), columns // 3)
        yield contact, np.concatenate([spread, [random.random() * largest[name] for name in system.actuators]])


def outcomes(demo: str, law: str, count: int) -> Iterator[str]:
    """What became of each load: "converged", "limit point", or what it failed with."""
    system = robot(demo, law)
    body = system.deformation.stepper(1.0)
    for contact, u in random_loads(system, LARGEST[demo], count):
        body.switch(contact)
        body.set_state(np.zeros(len(body.x)), np.zeros(len(body.x)))
        try:
            body.equilibrium(StepInput(u))
            yield "limit point" if body.negative_pivots else "converged"
        except SolverError as error:
            yield "limit point" if "comes to a limit point" in str(error) else str(error)
    body.close()


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    for demo in LARGEST:
        for law in MATERIALS:
            print(demo, law, dict(Counter(outcomes(demo, law, -(-count // (2 * len(LARGEST)))))), flush=True)
