"""Every claim in the table of hard cases fails with some variant that is broken on purpose.

A case is run under each variant that is named for it; what it claims, and what failed under one of them, must be the
same. So neither a new case nor a new claim gets by without a variant that it was seen to fail with.
"""

import ast
import functools
import importlib
import inspect
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.fem import assemble, linear_stepper, loads, restriction
from fenics_rom.reduction import gramians, validation
from fenics_rom.reduction import reduce as reduction
from fenics_rom.reduction.methods import balanced
from fenics_rom.rom import midpoint_map, switch_maps
from fenics_rom.runtime import rollout
from fenics_rom.runtime.steppers import midpoint

FOLDER = Path(__file__).parents[2] / "demos" / "hard_cases"
KINDS = ("contact", "damping", "material", "order", "precision", "shape", "steps", "support")
ROWS = ("Iterator[Row]", "Row")
SHORT = {"quick": True, "steps": 200, "ratios": (0.49, 0.4999)}  # arguments of cases
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")]


def cases():
    """Names of all functions that a kind's `rows` is made of."""
    for kind in KINDS:
        functions = {f.name: f for f in ast.parse((FOLDER / f"cases_{kind}.py").read_text()).body if hasattr(f, "name")}
        called = {node.id for node in ast.walk(functions["rows"]) if isinstance(node, ast.Name)}
        for name, function in functions.items():
            if name in called and isinstance(function, ast.FunctionDef) and ast.unparse(function.returns) in ROWS:
                yield f"{kind}.{name}"


@pytest.fixture
def demo(monkeypatch):
    """The modules of the demo."""
    monkeypatch.syspath_prepend(FOLDER)
    names = [*(f"cases_{kind}" for kind in KINDS), "boxes", "measures"]
    modules = SimpleNamespace(**{name.removeprefix("cases_"): importlib.import_module(name) for name in names})
    box = modules.material.box
    monkeypatch.setattr(
        modules.material, "box", lambda *given, **more: (finer if max(given[1]) > 6 else box)(*given, **more)
    )
    return modules


@functools.cache
def finer(*given, **more):
    """A reference, assembled once for all variants."""
    return importlib.import_module("boxes").box(*given, **more)


def kinds_of_claims(rows):
    """What is measured, without the numbers in it."""
    return {re.sub(r"\d[\d.,e-]*", "#", row.measured) for row in rows}


def stiffness_halved_in_steps(patch, demo):
    """The midpoint step, with half of the stiffness on its left-hand side."""

    def too_soft(mode, h):
        R, S = mode.damping_root, 2 / h + h / 4 * mode.eigenvalues
        a = 1 / (S + (mode.damping if mode.damping.ndim == 1 else mode.damping.diagonal()))
        return a, (R if R.ndim == 1 else np.diag(R)) * a

    for module in (midpoint_map, midpoint):
        patch.setattr(module, "compliance", too_soft)


def products_off_at_full_order(patch, demo):
    """M v that the account of the full order goes by is another than that of the step."""
    right = linear_stepper.FullOrderStepper._refined

    def off(self, factor, force, v):
        Mv, Kv = right(self, factor, force, v)
        return (1 + 1e-3) * Mv, Kv

    patch.setattr(linear_stepper.FullOrderStepper, "_refined", off)


def steps_off(patch, demo):
    """Both."""
    stiffness_halved_in_steps(patch, demo)
    products_off_at_full_order(patch, demo)


def work_that_is_not_booked(patch, demo):
    """A tenth of the work and of the heat."""
    right = midpoint.matrices

    def off(mode, h):
        after, account = right(mode, h)
        return after, 0.9 * account

    for module in (midpoint, rollout):
        patch.setattr(module, "matrices", off)


def reduced(change):
    """A variant that changes every ROM after its reduction."""

    def broken(patch, demo):
        right = fr.reduce
        patch.setattr(fr, "reduce", lambda *given, **more: change(right(*given, **more)))

    return broken


def other_modes(rom, change):
    return replace(
        rom, contact_models={name: replace(mode, **change(mode)) for name, mode in rom.contact_models.items()}
    )


def inputs_off(rom):
    """The force is a tenth too large."""
    return other_modes(rom, lambda mode: {"inputs": 1.1 * mode.inputs})


def no_push_of_rigid_motions(rom):
    return other_modes(
        rom, lambda mode: {"inputs": np.where(np.arange(mode.order)[:, None] < mode.rigid, 0.0, mode.inputs)}
    )


def elements(degree_of):
    """A variant whose elements have another degree than was asked for."""

    def broken(patch, demo):
        for module in (demo.material, demo.shape):
            right = module.box

            def other(lengths, bricks, *, degree=1, poisson=0.3, right=right, **more):
                degree = degree_of(degree, poisson, bricks)
                return right(lengths, bricks, degree=degree, poisson=poisson, **more)

            patch.setattr(module, "box", other)

    return broken


linear_elements = elements(lambda degree, *about: 1)
quadratic_elements = elements(lambda degree, *about: 2)
linear_in_the_hardest_case = elements(
    lambda degree, poisson, bricks: 1 if poisson > 0.4995 and bricks[0] <= 6 else degree
)


def one_material_for_all(patch, demo):
    """The mean of all materials everywhere."""
    right = assemble.material_of_cells

    def mean(scene, mesh):
        values = right(scene, mesh)
        return np.tile(np.sqrt(values.min(0) * values.max(0)), (len(values), 1))

    patch.setattr(assemble, "material_of_cells", mean)


def mass_for_safety(patch, demo):
    """A constant of 1e-9 kg on the diagonal of M, which nobody sees in bodies of a metre."""
    right = restriction._symmetrize

    def shifted(matrix):
        matrix = right(matrix)
        largest = matrix.norm() / np.sqrt(matrix.getSize()[0])
        matrix.shift(1e-9 if largest < 1e-5 else 0.0)
        return matrix

    patch.setattr(restriction, "_symmetrize", shifted)


def singular_values_above_a_constant(patch, demo):
    """An absolute tolerance for σ, which have units."""
    right = reduction._truncated

    def absolute(problem, name, found):
        kept = max(1, int((found.singular_values > 1e-6).sum()))
        return right(replace(problem, order=min(problem.order_of(name), kept)), name, found)

    patch.setattr(reduction, "_truncated", absolute)


def oblique(patch, demo):
    right = fr.reduce
    patch.setattr(fr, "reduce", lambda *given, **more: right(*given, **more, switching="oblique"))


def maps_that_add(patch, demo):
    """A switch adds a little, between equal models too."""
    right = switch_maps._clip_cosines
    patch.setattr(switch_maps, "_clip_cosines", lambda cosines: 1.001 * right(cosines))


def held_patches_pass(patch, demo):
    """A surface that cannot move is no error."""
    right = loads.patch_columns

    def lenient(nodes, surface, unknowns, where):
        try:
            return right(nodes, surface, unknowns, where)
        except fr.errors.SceneError:
            return np.eye(unknowns.components)[:, unknowns.free[:3]]

    patch.setattr(loads, "patch_columns", lenient)


def damping_from_nowhere(patch, demo):
    """Motions without damping get a little, so that Gramians exist."""
    right = gramians.gramian_factors
    patch.setattr(balanced, "gramian_factors", right)
    for module in (balanced, importlib.import_module("fenics_rom.reduction.balancing")):
        patch.setattr(
            module, "gramian_factors", lambda γ, d, *more: right(γ, np.maximum(d, 1e-9), *more), raising=False
        )


def validated_next_to_infinite_resonances(patch, demo):
    """Of modes that are stiffer than they should be, by a millionth."""
    samples = validation._samples

    def stiffer(problem, name, mode, W, width):
        return samples(problem, name, replace(mode, eigenvalues=(1 + 1e-6) * mode.eigenvalues), W, width)

    patch.setattr(validation, "_samples", stiffer)
    patch.setattr(validation, "sample_frequencies", lambda mode: np.sqrt(mode.eigenvalues[:1]) * (1 + 1e-9))


def dashpots_that_do_not_couple(rom):
    return other_modes(rom, lambda mode: {"damping": mode.damping if mode.damping.ndim == 1 else np.diag(mode.damping)})


def springs_that_count_for_nothing(patch, demo):
    """Every motion that strains nothing is taken for free, springs or not."""
    patch.setattr(assemble, "without_energy", lambda M, K, motions, algebra: motions)


def warnings_that_nobody_gives(patch, demo):
    patch.setattr(reduction, "warnings", SimpleNamespace(warn=lambda *given, **more: None))
    patch.setattr(assemble, "warnings_of", lambda scene, mesh, rigid: ())


def light_parts_that_nobody_misses(patch, demo):
    patch.setattr(validation, "WARNING_ERROR", 1.0)


def warnings_of_even_bodies(patch, demo):
    """That a part weighs little is said whatever the weighting is."""
    right = validation._light_part_warnings
    patch.setattr(validation, "WARNING_ERROR", 0.0)
    patch.setattr(validation, "LIGHT_PART_RATIO", 0.0)
    patch.setattr(
        validation, "_light_part_warnings", lambda problem, *more: right(replace(problem, weighting="mass"), *more)
    )


def noisy_singular_values(patch, demo):
    """Gramians with eight digits."""
    right = balanced.ranked_basis

    def noisy(*given):
        found = right(*given)
        σ = found.singular_values
        return replace(found, singular_values=σ * (1 + 1e-8 * np.random.default_rng(0).standard_normal(len(σ))))

    patch.setattr(balanced, "ranked_basis", noisy)


def cut_that_takes_the_first(patch, demo):
    """The more are asked for, the more of the first directions are left out."""
    right = reduction.orthonormal_span
    patch.setattr(reduction, "orthonormal_span", lambda T, m: right(T[:, 2 * max(0, m - 8) :], m))


def half_precision(patch, demo):
    """Single precision that rounds up, and as coarsely as half precision does."""

    class Half(fr.Batch):
        def step(self, u, **more):
            found = super().step(u, **more)
            if self.dtype == np.float32:
                self._bodies._layout.state *= 1 + 2.0**-11
            return found

    patch.setattr(fr, "Batch", Half)


VARIANTS = {
    "contact.many": (maps_that_add, stiffness_halved_in_steps),
    "contact.related": (maps_that_add, work_that_is_not_booked),
    "contact.clamped_edge": (held_patches_pass,),
    "contact.odd_columns": (oblique, work_that_is_not_booked),
    "damping.damped": (reduced(dashpots_that_do_not_couple), steps_off),
    "damping.undamped": (damping_from_nowhere, validated_next_to_infinite_resonances, stiffness_halved_in_steps),
    "material.incompressible": (quadratic_elements, linear_in_the_hardest_case, steps_off),
    "material.contrast": (one_material_for_all, light_parts_that_nobody_misses, warnings_of_even_bodies, steps_off),
    "order.orders": (reduced(inputs_off), oblique, stiffness_halved_in_steps, warnings_that_nobody_gives),
    "order.equal": (noisy_singular_values, cut_that_takes_the_first, oblique, stiffness_halved_in_steps),
    "precision.accuracy": (half_precision,),
    "precision.drift": (half_precision,),
    "shape.slender": (linear_elements, steps_off),
    "shape.bad_cells": (steps_off,),
    "shape.sizes": (mass_for_safety, singular_values_above_a_constant, steps_off),
    "steps.rides": (stiffness_halved_in_steps,),
    "steps.switches": (work_that_is_not_booked,),
    "support.supports": (springs_that_count_for_nothing, steps_off),
    "support.falls": (reduced(no_push_of_rigid_motions),),
}


def test_every_case_has_variants():
    assert set(VARIANTS) == set(cases())


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "material.incompressible")) for name in VARIANTS]
)
def test_every_claim_fails_with_a_variant(demo, name):
    kind, _, function = name.partition(".")
    case = getattr(getattr(demo, kind), function)
    given = {key: SHORT[key] for key in inspect.signature(case).parameters}
    claimed, failed = set(), set()
    for variant in VARIANTS[name]:
        with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
            variant(patch, demo)
            found = case(**given)
            rows = list(found) if inspect.isgenerator(found) else [found]
        broken = kinds_of_claims(row for row in rows if not row.holds)
        assert broken, variant
        claimed |= kinds_of_claims(rows)
        failed |= broken
    assert claimed == failed
