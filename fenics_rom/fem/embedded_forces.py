"""Forces of the membranes and cables in a body, by name: where they push."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.cell_points import gradients_at
from fenics_rom.fem.embedded import EmbeddedPoints, embedded_points
from fenics_rom.fem.nodes import Nodes
from fenics_rom.mechanics.fibres import Fibres
from fenics_rom.mechanics.slack import TOLD_SHARE, Push
from fenics_rom.mechanics.voigt import VOIGT_PAIRS
from fenics_rom.scene.fibres import QUADRATIC
from fenics_rom.scene.scene import Scene


class EmbeddedForces:
    """What is embedded in a body, by name.

    Args:
        nodes: of the body.
        embedded: points in all cells.
        is_large: whether strains are those of large deformation.
    """

    def __init__(self, nodes: Nodes, embedded: EmbeddedPoints, is_large: bool):
        self._cells, self._is_large = nodes.cell_nodes[embedded.cells], is_large
        self._gradients, self._weights = gradients_at(nodes, embedded.cells, embedded.places), embedded.weights
        shapes, _ = nodes.kind.shapes(nodes.degree, embedded.places)
        self._places = np.einsum("pa,pai->pi", shapes, nodes.coordinates[self._cells])
        self._families = dict[str, list[Fibres]]()
        for name, family in zip(embedded.names, embedded.fibres, strict=True):
            self._families.setdefault(name, []).append(family)

    def pushes(self, displacement: Array, time: float) -> dict[str, Push]:
        """As in `system.protocols.Embedded`."""
        H = np.einsum("pai,paj->pij", displacement[self._cells], self._gradients)
        E = (H + H.transpose(0, 2, 1)) / 2
        if self._is_large:
            E += np.einsum("pki,pkj->pij", H, H) / 2
        i, j = VOIGT_PAIRS.T
        strains = (E[:, i, j] * np.where(i == j, 1.0, 2.0)).T
        told = {}
        for name, families in self._families.items():
            force, points = self._least(families, strains)
            least, largest = force.min(axis=0), np.abs(force).max()
            if not least.min() < -TOLD_SHARE * largest:
                continue
            weights, worst = self._weights[points], least.argmin()
            share = float(weights[least < -TOLD_SHARE * largest].sum() / weights.sum())
            told[name] = Push(-float(least[worst]), share, self._places[points[worst]], time)
        return told

    def _least(self, families: list[Fibres], strains: Array) -> tuple[Array, Array]:
        """Forces (any, K) of each family of threads, or the principal ones of a sheet, and of which points (K,)."""
        sizes = np.array([family.modulus for family in families])
        e = np.array([family.strains(strains) for family in families])
        if families[0].law != QUADRATIC:
            whole, *shears = sizes * e
            return np.array([whole - np.hypot(*shears), whole + np.hypot(*shears)]), families[0].points
        pulled = np.sqrt(np.maximum(1 + 2 * e, 0.0)) - 1 if self._is_large else e
        return sizes * pulled, families[0].points


def embedded_forces(scene: Scene, nodes: Nodes) -> EmbeddedForces | None:
    """Of a scene's membranes and cables; None where there are none."""
    if not (scene.effects.membranes or scene.effects.cables):
        return None
    return EmbeddedForces(nodes, embedded_points(scene, nodes), scene.effects.large_deformation is not None)
