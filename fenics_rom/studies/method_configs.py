"""The methods that a study compares, and the orders and steps that it tries."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fenics_rom.arguments import names_in
from fenics_rom.errors import SceneError, check_known
from fenics_rom.mechanics.environment import Run
from fenics_rom.scene.scene import ORDER, Scene
from fenics_rom.scene.values import Number
from fenics_rom.studies.study_results import RATE_RUNS


class MethodConfig(NamedTuple):
    """A method that makes a basis, with energy-orthogonal switching."""

    label: str  # for tables and pictures
    method: str  # as `reduce` takes it


METHOD_CONFIGS = {
    "balanced": MethodConfig("balanced", "balanced"),
    "selection": MethodConfig("V-selection (the paper's)", "eigenvector-selection"),
    "modal": MethodConfig("lowest modes", "modal"),
    "modal+static": MethodConfig("static shapes and modes", "modal+static"),
    "pod": MethodConfig("POD", "pod"),
    "static": MethodConfig("static shapes", "static"),
}
STUDIED_ORDERS = (4, 6, 8, 10, 14, 20, 28, 40, 56, 80)
STUDIED_STEP_FACTORS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25)  # times the scene's
STUDIED_METHODS = ("balanced", "selection", "modal", "modal+static", "pod")
QUICK_METHODS = ("balanced", "modal")
QUICK_ORDERS = (5, 10, 20, 40)
QUICK_STEP_FACTORS = (4.0, 2.0, 1.0)
REFERENCE_REFINEMENT = 4  # steps of the reference in the smallest that is studied: a sixteenth of its error
QUICK_REFINEMENT = 2
QUICK_WORK = 6e6  # unknowns times steps of all full-order runs of a quick study: with contact about 20 s of one core
QUICK_STEPS = 20  # smallest steps that a quick study has at least
MAX_SNAPSHOTS = 100  # whole shapes that are compared
SNAPSHOT_MEMORY_BYTES = 2e8  # bytes that those of one run may take


@dataclass(frozen=True)
class StudyGrid:
    """What is tried.

    Attributes:
        methods: names of METHOD_CONFIGS.
        orders: ascending.
        steps: falling, s.
        quick: whether a first look is enough: a less fine reference, each method reduced once (to the largest order, of
            which the others are truncations), rates of one run, and of a long run only the beginning.
    """

    methods: tuple[str, ...]
    orders: tuple[int, ...]
    steps: tuple[float, ...]
    quick: bool

    @property
    def reference_step(self) -> float:
        """Step of the reference, s."""
        return self.steps[-1] / (QUICK_REFINEMENT if self.quick else REFERENCE_REFINEMENT)

    @property
    def rate_runs(self) -> int:
        """Runs of which the fastest tells the rate."""
        return 1 if self.quick else RATE_RUNS

    def duration(self, whole: float, size: int) -> float:
        """How much of a run of a body of so many unknowns is studied, s."""
        if not self.quick:
            return whole
        steps = QUICK_WORK / size / 1.5  # of a run at the reference's step, beside one of half as many
        return min(whole, max(steps * self.reference_step, QUICK_STEPS * self.steps[-1], 2 * self.steps[0]))


def first_method(scene: Scene) -> str:
    """The method to begin with: without inertia there are only shapes at rest to reduce to."""
    return "static" if scene.effects.inertia is None else "balanced"


def make_grid(
    scene: Scene,
    run: Run,
    size: int,
    *,
    quick: bool = False,
    methods: Sequence[str] | None = None,
    orders: Sequence[int] | None = None,
    steps: Sequence[float] | None = None,
) -> StudyGrid:
    """A checked grid, without orders that are too large and steps that are too long; what is None is a choice of ours.

    Raises:
        SceneError: an unknown method, an order below 1, steps that do not divide each other, or all too long.
    """
    if methods is None:
        first = first_method(scene)
        methods = (QUICK_METHODS if quick else STUDIED_METHODS) if first == "balanced" else (first,)
    for name in names_in("methods", methods, SceneError):
        check_known("method", name, METHOD_CONFIGS, SceneError)
    orders = (QUICK_ORDERS if quick else STUDIED_ORDERS) if orders is None else orders
    factors = QUICK_STEP_FACTORS if quick else STUDIED_STEP_FACTORS
    steps = [factor * run.dt for factor in factors] if steps is None else steps
    for order in orders:
        ORDER.check(order, "order")
    for step in steps:
        Number(above=0.0, unit="s").check(step, "step")
    if not (methods and orders and steps):
        raise SceneError("nothing to study: at least one method, one order and one step are needed")
    reachable = sorted({order for order in orders if order <= size}) or [size]
    falling = sorted(set(steps), reverse=True)
    for step in falling:
        ratio = step / falling[-1]
        if abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise SceneError(f"steps: {step:g} s is no whole multiple of the smallest, {falling[-1]:g} s")
    short = tuple(step for step in falling if step <= run.duration / 2)
    if not short:
        raise SceneError(f"steps: {falling[-1]:g} s is too long for a run of {run.duration:g} s")
    return StudyGrid(tuple(methods), tuple(reachable), short, quick)


def select_compared_instants(duration: float, steps: Sequence[float], nodes: int) -> tuple[float, int]:
    """A duration, and a number of whole shapes evenly spread over it, so that runs with all steps meet at each of them.

    A little of the end may be left out. Steps fall, and each is a whole multiple of the smallest.
    """
    ratios = [round(step / steps[-1]) for step in steps]
    common = int(np.lcm.reduce(ratios))
    count = max(round(duration / steps[-1]) // common, 1)
    largest = max(1, min(MAX_SNAPSHOTS, int(SNAPSHOT_MEMORY_BYTES / (24 * nodes)), count))
    shapes = min(range(largest, largest // 2, -1), key=lambda s: count % s)
    return (count - count % shapes) * common * steps[-1], shapes
