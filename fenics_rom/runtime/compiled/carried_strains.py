"""An elastic law whose strains are carried along, compiled: `steppers.elastic.carried_strains`, of strains in tables.

It knows the body by its shape q and mid-step velocity v̂ alone. A step asks it in this order:

    look_ahead -> force_ahead -> expect -> close         f̂ = pull + matrix v̂ after `expect`, at any v̂
"""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.branches import add_pull, growth, move, step_branches
from fenics_rom.runtime.compiled.material_points import (
    Points,
    add_geometric,
    add_resultants,
    displacement_gradients,
    set_piola,
    set_volume_viscosity,
    volume_piola,
)
from fenics_rom.runtime.compiled.small_matrices import dot, factor, invert
from fenics_rom.runtime.compiled.strain_tables import add_rates, read, set_products, set_strains, unfold


class Law(NamedTuple):
    """Of a body with m modes in steps of h s."""

    h: float
    viscosity: float  # β, s
    radius: float  # largest |q| that was trained
    most: float  # largest c, J
    steepest: float  # largest slope of s, 1/s
    relaxation: float  # by which branches resist strain rates, s
    damping: Array  # D without strains (m, m)
    springs: Array  # K_s (m, m)
    steady: Array  # D + h/2 K_s, of what f̂ changes by with v̂ (m, m)
    stiffness: Array  # folded table (N, N), see `strain_tables`
    gram: Array  # the same of strains, after a row and a column of zeros
    branches: Array  # coefficients of those of a material that relaxes (8, N); N = 0 where it does not
    points: Points  # whose energy is not that of these strains alone; P = 0 where there are none


class Strains(NamedTuple):
    """What steps carry along and set; see `deformation_maps.Carried`."""

    velocity: Array  # v̂ of the step before (m,)
    carried: Array  # ε and C₀ε (2, n - 1)
    numbers: Array  # in this order:
    stressed: Array  # (2, N), after a 0: C₀ E of the shape, and of what is strained and damped in the middle of the
    force: Array  # next step, if v̂ stays; and its force (m,)
    relaxed: Array  # strains of the branches, and C₀ times them (N, 2, n - 1)
    tangent: Array  # T (m, m) that steps are expected with
    expected: Array  # v̂ of the step (m,), no longer than what was trained
    at: Array  # q in the middle with that (m,)
    K: Array  # there (m, m)
    pull: Array  # (m,)
    matrix: Array  # (m, m)
    pulled: Array  # what of `pull` strains have (m,)
    slope: Array  # b of s (m,)
    vectors: Array  # for what is found on the way (2, m),
    matrices: Array  # (m, m),
    products: Array  # (2, N),
    uppers: Array  # and (2, N)
    volumes: Array  # what viscosity in volumes has of `matrix` (m, m), where points are


class Memory(NamedTuple):
    """Where `Strains` are."""

    vectors: Array  # (9, m)
    tangent: Array  # T (m, m)
    carried: Array
    numbers: Array
    stressed: Array
    relaxed: Array
    within: Array  # what is needed in a step alone, (4, m, m),
    products: Array  # (4, N)


@jit_part
def strains_in(memory: Memory) -> Strains:
    """As parts of few arrays, as each that is handed to a compiled function takes time."""
    v, T, carried, numbers, stressed, relaxed, within, products = memory
    return Strains(
        v[VELOCITY],
        carried,
        numbers,
        stressed,
        v[1],
        relaxed,
        T,
        v[2],
        v[3],
        within[0],
        v[4],
        within[1],
        v[5],
        v[6],
        v[7:],
        within[2],
        products[:2],
        products[2:],
        within[3],
    )


VELOCITY = 0  # of the vectors of a memory
LEFT, C, TANK, ENERGY, IS_CARRIED = 0, 1, 2, 3, 4  # J; and whether ε is not that of the shape
AHEAD, LEFT_AHEAD, IS_AHEAD = 5, 6, 7  # energy of the shape, of its strains and beside, J; whether it is known
HAS_TANGENT, MADE_TANGENT, GAP, NUMBERS = 8, 9, 10, 11  # the square of what ε lacks, J


@jit_part
def root_of(energy: float) -> float:
    """s of ½ s², J."""
    return math.sqrt(2 * max(energy, 0.0))


@jit_part
def look_ahead(law: Law, strains: Strains, q: Array, v: Array) -> None:
    """From q, to which a step with v̂ led."""
    middle, y, numbers = strains.vectors[0], strains.products, strains.numbers
    for i in range(len(q)):
        middle[i] = q[i] + law.h / 2 * v[i]
    y[:] = 0.0
    set_strains(q, y[0, 1:])
    if not law.points.moduli.size:
        set_strains(middle, y[1, 1:])
    add_rates(middle, v, law.viscosity + law.relaxation, y[1, 1:])
    read(law.gram, y, strains.stressed)
    numbers[AHEAD], numbers[LEFT_AHEAD], numbers[IS_AHEAD] = dot(y[0], strains.stressed[0]) / 2, 0.0, 1.0
    pull_by(strains.stressed[1, 1:], middle, strains.matrices, strains.force)
    if law.points.moduli.size:
        before, H = displacement_gradients(law.points, q), displacement_gradients(law.points, middle)
        viscous = volume_piola(law.points, H, before, 2 / law.h, law.viscosity)
        numbers[LEFT_AHEAD] = set_piola(law.points, before) - numbers[AHEAD]
        set_piola(law.points, H)
        for c in range(9):
            for p in range(H.shape[1]):
                H[c, p] += viscous[c, p]
        add_resultants(law.points, H, strains.force)


@jit_part
def pull_by(z: Array, q: Array, geometric: Array, force: Array) -> None:
    """Sets Aᵀz (m,) at q, and what is geometrically stiff by z (m, m)."""
    unfold(z[len(q) :], geometric)
    for i in range(len(q)):
        force[i] = dot(geometric[i], q) + z[i]


@jit_part
def add_force_ahead(law: Law, strains: Strains, q: Array, force: Array) -> None:
    """Adds f̂ (m,) of a step from q with v̂ of the step before."""
    v, middle = strains.velocity, strains.vectors[0]
    if law.branches.size:
        for i in range(len(q)):
            middle[i] = q[i] + law.h / 2 * v[i]
        _add_branches(law, strains, middle, force)
    for i in range(len(q)):
        force[i] += (
            strains.force[i] + dot(law.damping[i], v) + dot(law.springs[i], q) + law.h / 2 * dot(law.springs[i], v)
        )


@jit_part
def _add_branches(law: Law, strains: Strains, q: Array, force: Array) -> None:
    """Adds Aᵀ at q (m,) of what the branches add to stresses in the step."""
    stress, added = strains.uppers[1], strains.vectors[1]
    stress[:] = 0.0
    add_pull(law.branches, strains.relaxed, stress[1:])
    pull_by(stress[1:], q, strains.matrices, added)
    for i in range(len(q)):
        force[i] += added[i]


@jit_part
def _set_matrix(law: Law, K: Array, volumes: Array, matrix: Array) -> None:
    """Sets Aᵀ (h/2 + β) C₀ A of K there, that of volumes, and what does not change (m, m)."""
    size = 2 * (law.h / 2 + law.viscosity + law.relaxation)
    for i in range(len(K)):
        row, at, steady, beside = matrix[i], K[i], law.steady[i], volumes[i]
        for j in range(len(K)):
            row[j] = size * at[j] + steady[j] + beside[j]


@jit_part
def add_inertia(law: Law, matrix: Array) -> None:
    """Adds 2/h."""
    for i in range(len(matrix)):
        matrix[i, i] += 2 / law.h


@jit_part
def make_tangent(law: Law, strains: Strains, q: Array) -> None:
    """Sets T of a held body: the inverse of the slope there."""
    set_slope(law, strains, q, strains.tangent)
    invert(strains.K, strains.tangent)


@jit_part
def set_slope(law: Law, strains: Strains, q: Array, slope: Array) -> None:
    """Sets what a step's forces change by with v̂ of the step before (m, m), inertia included; its factor is in K."""
    m, middle, products, upper, factored = len(q), strains.vectors[0], strains.products[0], strains.uppers[0], strains.K
    for i in range(m):
        middle[i] = q[i] + law.h / 2 * strains.velocity[i]
    set_products(1.0, middle, products)
    read(law.stiffness, products, upper)
    unfold(upper[1 + m :], strains.matrix)
    copy(strains.stressed[1], strains.uppers[1])
    add_pull(law.branches, strains.relaxed, strains.uppers[1, 1:])
    unfold(strains.uppers[1, 1 + m :], factored)
    H = displacement_gradients(law.points, middle)
    set_volume_viscosity(law.points, H, law.viscosity, strains.volumes)
    _set_matrix(law, strains.matrix, strains.volumes, slope)
    add_inertia(law, slope)
    for i in range(m):
        for j in range(m):
            slope[i, j] += law.h / 2 * factored[i, j]
    if law.points.moduli.size:
        rates = displacement_gradients(law.points, strains.velocity)
        add_geometric(law.points, H, rates, law.viscosity, law.h / 2, slope)
    copy(slope, factored)
    if not factor(factored):
        _set_matrix(law, strains.matrix, strains.volumes, slope)
        add_inertia(law, slope)
        copy(slope, factored)
        factor(factored)


@jit_part
def expect(law: Law, strains: Strains, q: Array, v: Array) -> None:
    """A step from q near v (m,), which can hardly go further than it was trained: sets what f̂ is then."""
    m, h, products, upper = len(q), law.h, strains.products[0], strains.uppers[0]
    expected, at = strains.expected, strains.at
    far = h / 2 * math.sqrt(dot(v, v))
    share = 0.0 if not math.isfinite(far) else law.radius / far if far > law.radius else 1.0
    for i in range(m):
        expected[i] = share * v[i] if share > 0 else 0.0
        at[i] = q[i] + h / 2 * expected[i]
    set_products(1.0, at, products)
    read(law.stiffness, products, upper)
    unfold(upper[1 + m :], strains.K)
    H = displacement_gradients(law.points, at)
    set_volume_viscosity(law.points, H, law.viscosity, strains.volumes)
    _set_matrix(law, strains.K, strains.volumes, strains.matrix)
    z = strains.carried[1] if strains.numbers[IS_CARRIED] else strains.stressed[0, 1:]
    pull_by(z, at, strains.matrices, strains.pulled)
    if law.branches.size:
        _add_branches(law, strains, at, strains.pulled)
    for i in range(m):
        strains.pull[i] = strains.pulled[i] + dot(law.springs[i], q)
    if law.points.moduli.size:
        _add_slope(law, strains, H)


@jit_part
def _add_slope(law: Law, strains: Strains, H: Array) -> None:
    """Adds what has s, at H (9, P): b = ∂√(2 (Ψ + c))/∂q of the energy Ψ that is left; see `StrainsCarried._slope`."""
    q, b, numbers, m = strains.at, strains.slope, strains.numbers, len(strains.at)
    b[:] = 0.0
    left, upper = set_piola(law.points, H), strains.uppers[0]
    add_resultants(law.points, H, b)
    left -= upper[0] / 4
    for i in range(m):
        of_strains = dot(strains.K[i], q) + upper[1 + i]
        left -= (of_strains + upper[1 + i]) * q[i] / 4
        b[i] -= of_strains
    c = numbers[C]
    if left + c < c / 2:
        c = min(c + 4 * abs(left), law.most)
    size = 1 / math.sqrt(2 * max(left + c, c / 4))
    steep = size * math.sqrt(dot(b, b))
    if not steep <= law.steepest:
        size *= law.steepest / steep
    numbers[C], s = c, root_of(numbers[LEFT] + c)
    for i in range(m):
        b[i] *= size
        strains.pull[i] += s * b[i]
    for i in range(m):
        for j in range(m):
            strains.matrix[i, j] += law.h / 2 * b[i] * b[j]


@jit_part
def close(law: Law, strains: Strains, q: Array, after: Array, v: Array) -> float:
    """Ends a step with v̂ from q to q⁺; what it dissipates, J.

    Strains and s go to those of the shape there as far as dissipation allows: see `StrainsCarried`.
    """
    h, m, numbers, had_points, ε = law.h, len(q), strains.numbers, law.points.moduli.size > 0, strains.carried
    square, lost, power = 0.0, 0.0, dot(v, strains.pulled)
    for i in range(m):
        square += 2 * v[i] * dot(strains.K[i], v)
        lost += v[i] * (dot(law.damping[i], v) + dot(strains.volumes[i], v))
    heat, y, z, size = h * (lost + law.viscosity * square), strains.products, strains.uppers, ε.shape[1]
    relaxes = law.branches.size > 0
    if relaxes:
        y[0] = 0.0
        add_rates(strains.at, v, 1.0, y[0, 1:])
        read(law.gram, y[0], z[0])
        heat += step_branches(law.branches, strains.relaxed, y[0, 1 : 1 + size], z[0, 1 : 1 + size])
    left, c, s, gap_s = numbers[LEFT], numbers[C], 0.0, 0.0
    if had_points:
        grown = h * dot(strains.slope, v)
        left += grown * (root_of(left + c) + grown / 2)
    look_ahead(law, strains, after, v)
    if had_points:
        s = root_of(left + c)
        gap_s = root_of(numbers[LEFT_AHEAD] + c) - s
    energy, budget, share, is_carried = numbers[AHEAD], numbers[TANK] + heat, 1.0, 0.0
    added = energy - numbers[ENERGY] - h * (power + h / 2 * square) + gap_s * (s + gap_s / 2)
    numbers[GAP] = 0.0
    if relaxes or added > budget:
        if numbers[IS_CARRIED]:
            for k in range(size):
                y[0, 1 + k] = ε[0, k]
        else:
            set_strains(q, y[0, 1:])
        add_rates(strains.at, v, h, y[0, 1:])
        set_strains(after, y[1, 1:])
        y[0, 0] = 0.0
        y[1, 0] = 0.0
        for k in range(size):
            y[1, 1 + k] -= y[0, 1 + k]
        read(law.gram, y, z)
        gap_square, slope = dot(y[1], z[1]) + gap_s * gap_s, dot(y[0], z[1]) + gap_s * s
        gap, stress = y[1, 1 : 1 + size], z[1, 1 : 1 + size]
        of_branches = growth(law.branches, strains.relaxed, gap, stress)
        slope, whole = slope + of_branches[0], gap_square + of_branches[1]
        if slope + whole / 2 > budget and whole > 0:
            root = math.sqrt(max(slope * slope + 2 * whole * budget, 0.0))
            share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / whole, 1.0)
        added = share * slope + share**2 * whole / 2
        move(strains.relaxed, share, gap, stress)
        if share < 1:
            for k in range(size):
                ε[0, k], ε[1, k] = y[0, 1 + k] + share * y[1, 1 + k], z[0, 1 + k] + share * z[1, 1 + k]
            energy, is_carried = dot(ε[0], ε[1]) / 2, 1.0
        numbers[GAP] = (1 - share) ** 2 * gap_square
    numbers[LEFT] = left + share * gap_s * (s + share * gap_s / 2)
    numbers[TANK] = min(max(budget - added, 0.0), 2 * numbers[AHEAD])
    numbers[ENERGY], numbers[IS_CARRIED] = energy, is_carried
    copy(v, strains.velocity)
    return heat - added
