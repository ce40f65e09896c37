"""A contact model as the state space of control: x' = A x + B u, y = C x, or the map of a step.

In energy coordinates x = [e, r], e = ω q, so that E = ½ xᵀx is the stored energy:

    A = [0  ω; -ω  -D],  B = [0; G],  A + Aᵀ = -2 [0 0; 0 D] ≤ 0

which is passive between u and Gᵀr. Rigid motions store nothing, and have their displacement itself in e: e' = r.
Discrete, x_{k+1} = A x_k + B u_k is the step of passive midpoint integration, exactly, with u_k constant in it.

A material that relaxes has strains b_k = ω w_k of its branches as further states, b_k' = ω r - b_k/τ_k, which pull with
g_k ω b_k. Without inertia e follows forces at once: y = D u, or as a step e_{k+1} = G u_k/ω.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.linear_readings import ReadRows
from fenics_rom.rom.midpoint_map import compliance, matrices

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import PronySeries


class OperatingPoint(NamedTuple):
    """About what a body that is not linear was linearised.

    x_{k+1} = after + A (x_k - state) + B (u_k - input), and y_k = output + C (x_k - state).
    """

    state: Array  # (s,)
    input: Array  # (p,)
    after: Array  # (s,) the state after the step from there
    output: Array  # (o,)


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear model; unpacks to A, B, C, D.

    Attributes:
        A, B, C, D: (s, s), (s, p), (o, s), (o, p), with s = 2 m states, and more where a step carries more along.
        dt: time step, s; 0 in continuous time.
        states, inputs, outputs: unit of each, by name, in their order.
        about: of a body that is not linear, where; None: the model is linear, and exact everywhere.

    Example:
        >>> plant = rom.state_space("middle", dt=1e-3)
        >>> A, B, C, D = plant
        >>> list(plant.inputs.items())[2], list(plant.outputs.items())[0], A.shape
        (('middle[2]', 'N'), ('tip[0,0]', 'm'), (40, 40))
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float
    states: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    about: OperatingPoint | None = None

    def __iter__(self) -> Iterator[Array]:
        return iter((self.A, self.B, self.C, self.D))

    def __repr__(self) -> str:
        when = f"steps of {self.dt:g} s" if self.dt else "continuous time"
        where = "" if self.about is None else ", linearised about a state"
        return (
            f"StateSpace in {when}{where}: {len(self.states)} states\n"
            f"  inputs: {', '.join(self.inputs)}\n  outputs: {', '.join(self.outputs)}"
        )


def state_space(
    model: ContactModel,
    dt: float | None,
    inputs: Mapping[str, tuple[int, str]],
    outputs: Mapping[str, ReadRows],
    series: "PronySeries | None" = None,
    has_inertia: bool = True,
) -> StateSpace:
    """That of a contact model.

    Args:
        model: the contact model.
        dt: time step, s; None: continuous time.
        inputs: number of columns and unit of each, by name.
        outputs: what is read, by name.
        series: of a material that relaxes.
        has_inertia: whether the body has inertia.
    """
    m, rigid = model.order, model.rigid
    ω = np.sqrt(model.eigenvalues)
    travel = np.where(ω == 0, 1.0, ω)  # e' = travel r
    rows = np.vstack([np.zeros((0, m)), *(read.rows for read in outputs.values())]) / travel
    displacements = {f"e[{k}]": "m kg^0.5" if k < rigid else "J^0.5" for k in range(m)}
    rates = {f"r[{k}]": "J^0.5" for k in range(m)}
    names = column_names(inputs), output_names(outputs)
    if not has_inertia:
        at_rest = model.inputs / ω[:, None]
        if dt is None:
            empty = np.zeros((0, 0)), np.zeros((0, len(names[0]))), np.zeros((len(rows), 0))
            return StateSpace(*empty, rows @ at_rest, 0.0, {}, *names)
        D = np.zeros((len(rows), len(names[0])))
        return StateSpace(np.zeros((m, m)), at_rest, rows, D, dt, displacements, *names)
    strains: dict[str, str] = {}
    if series is not None:
        AB = _relaxing_rate(model, series) if dt is None else _relaxing_step(model, series, dt)
        strains = {f"b{branch}[{k}]": "J^0.5" for branch in range(len(series.times)) for k in range(m)}
    elif dt is None:
        D = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
        AB = np.block(
            [[np.zeros((m, m)), np.diag(travel), np.zeros_like(model.inputs)], [-np.diag(ω), -D, model.inputs]]
        )
    else:
        AB, _ = matrices(model, dt)
    if dt is not None:
        AB[:rigid] += dt / 2 * AB[m : m + rigid]  # h v̂ = h/2 (r⁺ + r)
        AB[:rigid, m : m + rigid] += dt / 2 * np.eye(rigid)
    s = 2 * m + len(strains)
    return StateSpace(
        A=AB[:, :s].copy(),
        B=AB[:, s:].copy(),
        C=np.hstack([rows, np.zeros((len(rows), s - m))]),
        D=np.zeros((len(rows), AB.shape[1] - s)),
        dt=dt or 0.0,
        states=displacements | rates | strains,
        inputs=names[0],
        outputs=names[1],
    )


def column_names(inputs: Mapping[str, tuple[int, str]]) -> dict[str, str]:
    """The unit of each column of inputs, by name, of which the number and the unit are given."""
    return {
        name if count == 1 else f"{name}[{column}]": unit
        for name, (count, unit) in inputs.items()
        for column in range(count)
    }


def output_names(outputs: Mapping[str, ReadRows]) -> dict[str, str]:
    """The unit of each number that is read, by name."""
    return {
        f"{name}[{','.join(map(str, place))}]" if place else name: read.unit
        for name, read in outputs.items()
        for place in np.ndindex(read.shape)
    }


def _relaxing_rate(model: ContactModel, series: "PronySeries") -> Array:
    """[A B] in continuous time, with branches."""
    m, branches, (_, p) = model.order, len(series.times), model.inputs.shape
    ω = np.sqrt(model.eigenvalues)
    D = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
    AB = np.zeros(((2 + branches) * m, (2 + branches) * m + p))
    AB[:m, m : 2 * m] = np.diag(np.where(ω == 0, 1.0, ω))
    pulls = (-g * np.diag(ω) for g in series.ratios)
    AB[m : 2 * m] = np.hstack([-np.diag(ω), -D, *pulls, model.inputs])
    for k, τ in enumerate(series.times):
        own = slice((2 + k) * m, (3 + k) * m)
        AB[own, m : 2 * m], AB[own, own] = np.diag(ω), -np.eye(m) / τ
    return AB


def _relaxing_step(model: ContactModel, series: "PronySeries", h: float) -> Array:
    """[A B] of a step, with branches."""
    m, branches = model.order, len(series.times)
    ω = np.sqrt(model.eigenvalues)
    a, _ = compliance(model, h, series.stiffening_time(h))
    pull, decay, gain = series.coefficients(h)
    right = np.hstack([-np.diag(ω), 2 / h * np.eye(m), *(-share * np.diag(ω) for share in pull), model.inputs])
    v = a[:, None] * right if a.ndim == 1 else a @ right
    AB = np.vstack([h * ω[:, None] * v, 2 * v, *(share * ω[:, None] * v for share in gain)])
    AB[:, : (2 + branches) * m] += np.diag(np.concatenate([np.ones(m), -np.ones(m), np.repeat(decay, m)]))
    return AB
