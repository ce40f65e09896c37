"""What resists the shape of a body that deforms largely, and what follows it, as arrays for compiled steps."""

from collections.abc import Sequence
from typing import TypeAlias, TypeGuard
from weakref import WeakKeyDictionary

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.tendon import cable_length
from fenics_rom.rom.carried_strains import MonomialStrains
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon
from fenics_rom.rom.strain_tables import StrainTables
from fenics_rom.runtime.compiled.carried_strains import HAS_TANGENT, IS_AHEAD, NUMBERS, Law, Memory, Strains
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.material_points import Points
from fenics_rom.runtime.compiled.sampled_points import Sampled
from fenics_rom.runtime.compiled.strain_tables import folded, padded
from fenics_rom.runtime.compiled.threads import threads_of
from fenics_rom.runtime.steppers.acts.following import FollowingLoads, Pressure
from fenics_rom.runtime.steppers.deformation_maps import E_OF_Q, Carried
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.sampled import SampledPoints

LAWS = "st_venant_kirchhoff", "neo_hookean"  # that are compiled, in the order of `material_points`,
Known: TypeAlias = StrainsCarried | SampledPoints  # by these steps


def is_known(law: object, body: ReducedDeformation) -> TypeGuard[Known]:
    """Whether loops know what resists the shape of a body."""
    has_tables = isinstance(law, StrainsCarried) and isinstance(law.strains, MonomialStrains)
    return body.law in LAWS and (has_tables or isinstance(law, SampledPoints))


def handed_on(velocity: Array, carried: Array, numbers: Array) -> Carried:
    """As a law has it."""
    left, c, tank, energy, is_carried, *_ = numbers.tolist()
    return Carried(velocity.copy(), carried.copy() if is_carried else E_OF_Q, left, c, tank, energy)


def take_on(strains: Strains, law: Known, tangent: Array) -> None:
    """Has loops go on from what a law carries along."""
    if law.branches is not None:
        strains.relaxed[:] = law.branches.state
    if isinstance(law, SampledPoints):
        return
    numbers, carried = strains.numbers, law.carried
    strains.velocity[:] = carried.velocity
    numbers[:5] = *carried[2:], len(carried.strained) > 0
    if len(carried.strained):
        strains.carried[:] = carried.strained
    numbers[IS_AHEAD], numbers[HAS_TANGENT] = 0.0, len(tangent) > 0
    if len(tangent):
        strains.tangent[:] = tangent


def memory_of(m: int, branches: Array) -> Memory:
    """Of a body with m modes, whose material has branches of such states (N, 2, strains)."""
    n = (m + 1) * (m + 2) // 2
    sizes = (9, m), (m, m), (2, n - 1), (NUMBERS,), (2, padded(n)), branches.shape, (4, m, m), (4, padded(n))
    return Memory(*map(np.zeros, sizes))


def branches_of(law: Known) -> Array:
    """States (N, 2, strains) of branches of a material; N = 0 where it does not relax."""
    return np.empty((0, 2, 0)) if law.branches is None else law.branches.state


def _tables_of(body: ReducedDeformation, tables: StrainTables) -> tuple[Array, Array]:
    """Folded stiffness and gram of a body, made once."""
    if body not in _folded:
        _folded[body] = folded(tables.stiffness / tables.half), folded(tables.gram, first=1)
    return _folded[body]


_folded: WeakKeyDictionary[ReducedDeformation, tuple[Array, Array]] = WeakKeyDictionary()


def law_of(body: ReducedDeformation, law: Known, h: float) -> Law:
    """In steps of h s; of sampled points what is not of these."""
    steady, most, P, tables = body.external_damping + h / 2 * body.springs, 0.0, 0, (np.empty((0, 0)),) * 2
    viscosity, steepest = 0.0, 0.0
    if isinstance(law, StrainsCarried):
        assert isinstance(law.strains, MonomialStrains)
        viscosity, steepest, tables = law.strains.viscosity, law.steepest, _tables_of(body, law.strains.tables)
        if law.points is not None:
            most, P = law.points.most, len(body.weights)
    return Law(
        h,
        viscosity,
        body.training_radius,
        most,
        steepest,
        0.0 if law.branches is None else law.branches.stiffening_time,
        body.external_damping.copy(),
        body.springs.copy(),
        steady,
        *tables,
        np.zeros((8, 0)) if law.branches is None else law.branches.numbers,
        _points_of(body, P),
    )


def _points_of(body: ReducedDeformation, P: int) -> Points:
    """The first of a body's."""
    gradients, material = body.gradients[:, :, :P].reshape(-1, body.order).T.copy(), body.material.scaled(body.weights)
    moduli = np.stack([material.first_lame, material.shear])[:, :P].copy()
    return Points(gradients, moduli, np.array([LAWS.index(body.law)]), *threads_of(material.fibres if P else (), P))


def sampled_of(body: ReducedDeformation, law: Known) -> Sampled | None:
    """Points as Newton's steps have them; None of strains that are carried along."""
    if not isinstance(law, SampledPoints):
        return None
    added = 0.0 if law.branches is None else law.branches.stiffening_time
    viscosity, round_off = np.stack([body.viscosity, body.viscosity + added]), float(np.max(law.round_off))
    return Sampled(_points_of(body, len(body.weights)), viscosity, round_off, body.material.is_quadratic)


def polynomials_of(pressures: Sequence[Array], m: int) -> Array:
    """Of forces of pressures (c, m, N), of products of which squares have the half."""
    n = (m + 1) * (m + 2) // 2
    polynomials = np.array(pressures).reshape(len(pressures), m, n)
    polynomials[:, :, np.cumsum([0, *range(m + 1, 1, -1)])] *= 2
    return polynomials


def segments_of(tendons: Sequence[ReducedTendon], m: int) -> tuple[Array, Array, Array]:
    """Of cables: segments at rest (s, 3), m, what they are with q (s, 3, m), and lengths of the cables at rest, m."""
    at_rest = [np.diff(each.points, axis=0) for each in tendons]
    shapes = [np.diff(each.shapes.reshape(-1, 3, m), axis=0) for each in tendons]
    lengths = np.array([cable_length(each.points) for each in tendons])
    return np.concatenate([np.empty((0, 3)), *at_rest]), np.concatenate([np.empty((0, 3, m)), *shapes]), lengths


def following_of(loads: FollowingLoads | None, m: int, found: Sequence[int]) -> Following:
    """As arrays, but for what acts in some columns."""
    followers = [] if loads is None else [each for each in loads.followers if each[0] not in found]
    pressures = [(column, each.polynomial) for column, each in followers if isinstance(each, Pressure)]
    tendons = [(column, each) for column, each in followers if isinstance(each, ReducedTendon)]
    columns = [np.full(len(each.points) - 1, column) for column, each in tendons]
    return Following(
        np.array([column for column, _ in pressures], dtype=np.int64),
        polynomials_of([each for _, each in pressures], m),
        np.concatenate([np.empty(0, dtype=np.int64), *columns]),
        *segments_of([each for _, each in tendons], m)[:2],
    )
