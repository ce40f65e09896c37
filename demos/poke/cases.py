"""How close models are in many runs of one kind: one of them, with contact, hangs on too little to tell much."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import fenics_rom as fr
from fenics_rom.scene.scene import Scene

Array = np.ndarray
Model = tuple[str, int]  # what is said of it, and its order
Measure = Callable[[fr.Trajectory, fr.Trajectory], tuple[float, ...]]  # relative errors of a run, by its reference

HALF_STEP = "full order at half the step"


@dataclass(frozen=True)
class Cases:
    """Errors of models in some runs of one kind.

    Attributes:
        errors: (runs, measures) by model.
    """

    errors: dict[Model, Array]

    @property
    def medians(self) -> list[tuple[str | int, ...]]:
        """For a table: model, order and the median of each measure."""
        return [(*model, *(f"{error:.1e}" for error in np.median(of, axis=0))) for model, of in self.errors.items()]

    def __add__(self, other: "Cases") -> "Cases":
        """The runs of both."""
        return Cases({model: np.vstack([of, other.errors[model]]) for model, of in self.errors.items()})

    def ratios(self, model: Model, other: Model, measures: Iterable[str]) -> dict[str, float]:
        """Prints and returns errors of a model over another's in the same runs, of each measure, as geometric means."""
        apart = np.log(self.errors[model] / self.errors[other])
        known = np.exp(apart.std(axis=0, ddof=1) / np.sqrt(len(apart)))
        ratios = dict(zip(measures, np.exp(apart.mean(axis=0)).tolist(), strict=True))
        (what, order), (beside, its) = model, other
        print(f"Errors of order {order}, {what}, over those of order {its}, {beside}, in {len(apart)} runs:")
        for (name, ratio), factor in zip(ratios.items(), known, strict=True):
            print(f"  {name} {ratio:.2f}, known to a factor of {factor:.2f} (standard error)")
        return ratios


def compare_cases(scenes: Iterable[Scene], models: Mapping[Model, tuple[fr.Rom, bool]], measure: Measure) -> Cases:
    """Runs scenes at full order, also at half the step, and reduced.

    Args:
        scenes: with a run, which keeps shapes at as many instants as it is to be compared at.
        models: the ROM, which is of such scenes, and whether its contact points keep their residual compliance.
        measure: what is told of each run beside full order at its step.
    """
    errors: dict[Model, list[tuple[float, ...]]] = {}
    for scene in scenes:
        assert scene.run is not None
        system = fr.assemble(scene)
        full = fr.simulate(system)
        runs = {(HALF_STEP, system.size): fr.simulate(system, dt=scene.run.dt / 2)}
        for model, (rom, yields) in models.items():
            runs[model] = fr.simulate(rom, scene=replace(scene.environment, residual_compliance=yields))
        for model, run in runs.items():
            errors.setdefault(model, []).append(measure(run, full))
    return Cases({model: np.array(of) for model, of in errors.items()})
