"""A contact model as the state space of control: x' = A x + B u, y = C x, or the map of a step.

In energy coordinates x = [e, r], e = ω q, so that E = ½ xᵀx is the stored energy:

    A = [0  ω; -ω  -D],  B = [0; G],  A + Aᵀ = -2 [0 0; 0 D] ≤ 0

which is passive between u and Gᵀr. Rigid motions store nothing, and have their displacement itself in e: e' = r.
Discrete, x_{k+1} = A x_k + B u_k is the step of passive midpoint integration, exactly, with u_k constant in it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.linear_readings import ReadRows
from fenics_rom.rom.midpoint_map import matrices


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear model; unpacks to A, B, C, D.

    Attributes:
        A, B, C, D: (s, s), (s, p), (o, s), (o, p), with s = 2 m states.
        dt: time step, s; 0 in continuous time.
        states, inputs, outputs: unit of each, by name, in their order.

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

    def __iter__(self) -> Iterator[Array]:
        return iter((self.A, self.B, self.C, self.D))

    def __repr__(self) -> str:
        when = f"steps of {self.dt:g} s" if self.dt else "continuous time"
        return (
            f"StateSpace in {when}: {len(self.states)} states\n"
            f"  inputs: {', '.join(self.inputs)}\n  outputs: {', '.join(self.outputs)}"
        )


def state_space(
    model: ContactModel, dt: float | None, inputs: Mapping[str, tuple[int, str]], outputs: Mapping[str, ReadRows]
) -> StateSpace:
    """That of a contact model.

    Args:
        model: the contact model.
        dt: time step, s; None: continuous time.
        inputs: number of columns and unit of each, by name.
        outputs: what is read, by name.
    """
    m, rigid, p = model.order, model.rigid, model.inputs.shape[1]
    ω = np.sqrt(model.eigenvalues)
    travel = np.where(ω == 0, 1.0, ω)  # e' = travel r
    if dt is None:
        D = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
        AB = np.block([[np.zeros((m, m)), np.diag(travel), np.zeros((m, p))], [-np.diag(ω), -D, model.inputs]])
    else:
        AB, _ = matrices(model, dt)
        AB[:rigid] += dt / 2 * AB[m : m + rigid]  # h v̂ = h/2 (r⁺ + r)
        AB[:rigid, m : m + rigid] += dt / 2 * np.eye(rigid)
    rows = np.vstack([np.zeros((0, m)), *(read.rows for read in outputs.values())]) / travel
    displacements = {f"e[{k}]": "m kg^0.5" if k < rigid else "J^0.5" for k in range(m)}
    return StateSpace(
        A=AB[:, : 2 * m].copy(),
        B=AB[:, 2 * m :].copy(),
        C=np.hstack([rows, np.zeros_like(rows)]),
        D=np.zeros((len(rows), p)),
        dt=dt or 0.0,
        states=displacements | {f"r[{k}]": "J^0.5" for k in range(m)},
        inputs={
            name if count == 1 else f"{name}[{column}]": unit
            for name, (count, unit) in inputs.items()
            for column in range(count)
        },
        outputs={
            f"{name}[{','.join(map(str, place))}]" if place else name: read.unit
            for name, read in outputs.items()
            for place in np.ndindex(read.shape)
        },
    )
