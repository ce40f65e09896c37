"""What of a pad is in contact: how many points touch, push and slide."""

from dataclasses import dataclass

import numpy as np
from pads import COEFFICIENT

import fenics_rom as fr

NEAR = 1e-4  # m; a point stops up to one step before the ground, and need not be pressed on

Array = np.ndarray


@dataclass(frozen=True)
class Seen:
    """What is in contact, mean over some steps."""

    touching: float
    pushing: float
    sliding: float
    force: Array  # (3,), N, of the obstacle


def look(body: fr.Simulator, steps: int = 20) -> Seen:
    """What is in contact in the next steps.

    More points touch than the model has freedoms to tell apart, so that some of them need not push. A point slides
    where its friction is as large as it can be.
    """
    (name, obstacle), *_ = body.environment.obstacles.items()  # type: ignore[union-attr]
    points = body.contact_points
    touching, pushing, sliding, force = [], [], [], []
    for _ in range(steps):
        body.step()
        gaps, normals = obstacle.distance(body.rom.nodes[points] + body.displacement()[points])
        forces = body.contact_forces()
        pressure = (forces * normals).sum(axis=1)
        pushes = pressure > 1e-9 * pressure.max(initial=0.0)
        aside = np.linalg.norm(forces - pressure[:, None] * normals, axis=1)
        touching.append(np.count_nonzero(gaps < NEAR))
        pushing.append(np.count_nonzero(pushes))
        sliding.append(np.count_nonzero(pushes & (aside > 0.999 * COEFFICIENT * pressure)))
        force.append(body.contact_forces(name))
    counts = [float(np.mean(count)) for count in (touching, pushing, sliding)]
    return Seen(counts[0], counts[1], counts[2], np.mean(force, axis=0))
