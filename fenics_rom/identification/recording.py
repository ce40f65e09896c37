"""What was measured on one scene, and the models that answer for it; and those of all scenes together."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.fem.assemble import assemble
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.deformable_model import DIFFERENCE, make_deformable_model
from fenics_rom.identification.experiment import Experiment, Experiments, make_experiment
from fenics_rom.identification.full_order import FullOrderAnswer, answer_of
from fenics_rom.identification.marker_data import Data, Equilibria, Motion
from fenics_rom.identification.parameters import FIRST_CLOCK, scene_with, values_of
from fenics_rom.identification.reduced_model import ReducedModel, make_basis
from fenics_rom.io.progress import Report, silent
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

LEAST_SNAPSHOTS = 100  # of a run that a model is made of


class Model(Protocol):
    """What answers for the markers of one scene at any values θ.

    Attributes:
        precision: to which a fit of it can be brought, relative.
    """

    precision: float

    @property
    def order(self) -> int:
        """Number of its displacements."""

    def predict(self, experiment: Experiment, θ: Array) -> Array:
        """What it says of all values, (N,), m."""

    def linearize(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """What it says, (N,), m, and how that changes in directions of θ, (N, directions)."""


@dataclass(frozen=True)
class JointModel:
    """Models of all scenes, which answer for all experiments."""

    models: tuple[Model, ...]

    @property
    def precision(self) -> float:
        """To which a fit can be brought, relative."""
        return max(model.precision for model in self.models)

    @property
    def order(self) -> int:
        """Number of displacements of the largest."""
        return max(model.order for model in self.models)

    def predict(self, experiments: Experiments, θ: Array) -> Array:
        """What they say of all values, (N,), m."""
        pairs = zip(self.models, experiments.parts, strict=True)
        return experiments.joined([model.predict(part, θ) for model, part in pairs])

    def linearize(self, experiments: Experiments, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """What they say, (N,), m, and how that changes in directions of θ, (N, directions)."""
        pairs = zip(self.models, experiments.parts, strict=True)
        values, slopes = zip(*(model.linearize(part, θ, directions) for model, part in pairs), strict=True)
        return experiments.joined(values), experiments.joined(slopes)


class Recording:
    """One scene and the data of it; every rank must make it, and ask it.

    Args:
        scene: whose values are the start.
        data: of it, at least one.
        first: number of its first motion among those of all scenes.
        tilting: whether gravity's direction is sought.

    Attributes:
        system: at simple values, for what does not depend on them.
        experiment: what was measured.

    Raises:
        SceneError: a scene that cannot be identified.
        DataError: nothing was seen.
    """

    def __init__(self, scene: Scene, data: Sequence[Data], first: int, *, tilting: bool = False):
        check_identifiable(scene, data)
        self._tilting = tilting
        self._scene, self._data, self._first, self._affine = scene, data, first, AffineSystem(scene)
        self.system: System = self._affine.plain
        if self.system.rigid.shape[1] and not scene.effects.springs and any(isinstance(d, Equilibria) for d in data):
            raise SceneError(f"{scene.source}: is not wholly held, so it has no equilibria; use data with times")
        self.experiment = self._experiment_of(scene)

    def _experiment_of(self, scene: Scene) -> Experiment:
        return make_experiment(scene, self._data, self.system, self._first)

    @property
    def finer(self) -> Experiment:
        """The same with steps half as long."""
        run = self._scene.run
        if not self.experiment.steps or run is None:
            return self.experiment
        return self._experiment_of(replace(self._scene, run=replace(run, dt=run.dt / 2)))

    def model_at(self, θ: Array, report: Report) -> Model:
        """The model whose basis is best at θ."""
        system = self._system_at(θ)
        if system.deformation is not None:
            with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # the final check has them
                answer = answer_of(system, self.experiment, report)
            return make_deformable_model(self._affine, system, self.experiment, θ, answer, tilting=self._tilting)
        start, basis = self.experiment.start, make_basis(system, self.experiment, tilting=self._tilting)
        parts = self._affine.parts(basis)
        return ReducedModel(parts, None if start is None else system.algebra.inner(basis, start.fields))

    def answer_at(self, θ: Array, report: Report) -> FullOrderAnswer:
        """What the full order says; what it warns of is in the answer."""
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
            return answer_of(self._system_at(θ), self.experiment, report)

    def derivatives_at(self, θ: Array, directions: Sequence[Array], model: Model, report: Report) -> Array:
        """How what the full order says changes in directions of θ, (N, directions), where a model was made at θ.

        Of a linear body they are the model's own; of one that deforms largely differences of full-order runs, one for
        each direction but of clocks.
        """
        said, slopes = model.linearize(self.experiment, θ, directions)
        if self.deforms_largely:
            for k, dθ in enumerate(directions):
                report("full-order derivatives", k, len(directions))
                if dθ[:, :FIRST_CLOCK].any():
                    after = self.answer_at(θ + DIFFERENCE * dθ, silent)
                    slopes[:, k] = (after.predictions(self.experiment, θ) - said) / DIFFERENCE
            report("full-order derivatives", len(directions), len(directions))
        return slopes

    @property
    def deforms_largely(self) -> bool:
        """Whether the body does."""
        return self._scene.effects.large_deformation is not None

    def _system_at(self, θ: Array) -> System:
        scene = scene_with(self._scene, θ)
        if scene.run is not None and self.deforms_largely:
            scene = replace(scene, run=replace(scene.run, snapshots=max(scene.run.snapshots, LEAST_SNAPSHOTS)))
        return assemble(scene)


def check_identifiable(scene: Scene, data: Sequence[Data]) -> None:
    """Refuses (SceneError) what a fit has no models of."""
    effects, where = scene.effects, f"{scene.source}: effects."
    if scene.frame == "moving":
        raise SceneError(
            f"{scene.source}: frame = 'moving': a fit has no models of a body that turns; use frame = 'fixed', "
            "with a body that its supports hold or that turns but a little"
        )
    if effects.contact is not None:
        raise SceneError(
            f"{where}contact: where obstacles push is not known before the run; use a scene without them, with "
            "the measured contact forces in its [[run.load]]"
        )
    if any(isinstance(part, Motion) for part in data) and effects.inertia is None:
        raise SceneError(f"{scene.source}: data with times need effects.inertia; without it give equilibria")
    for name in ("pressure", "tendon") if effects.large_deformation is not None else ():
        if getattr(effects, name):
            raise SceneError(f"{where}{name}: turns with a body that deforms largely; use loads that do not")


def check_same_values(scene: Scene, other: Scene, *, tilting: bool) -> None:
    """Refuses (SceneError) another scene of a fit whose materials and damping do not begin as those of the first.

    Where gravity's direction is sought, neither may that differ.
    """
    if list(scene.materials) != list(other.materials) or not np.array_equal(values_of(scene), values_of(other)):
        raise SceneError(
            f"{other.source}: its materials or damping are not those of {scene.source}; use scenes that begin "
            "with the same values, as one fit moves them together"
        )
    if tilting and scene.effects.gravity != other.effects.gravity:
        raise SceneError(
            f"{other.source}: effects.gravity is not that of {scene.source}; use the same, as one tilt is sought"
        )
