"""The gradient of a number that comes of many steps, with respect to all that went into them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from numpy import ndarray as Array

from fenics_rom.arguments import check_function, names_in
from fenics_rom.errors import StepError, check_known, check_type
from fenics_rom.runtime.differentiation.gradient import Objective, RolloutGradient
from fenics_rom.runtime.differentiation.linear_steps import differentiate_linear
from fenics_rom.runtime.rollout import check_bases, plan_steps
from fenics_rom.runtime.simulator import Simulator

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState


def differentiate(
    body: Simulator,
    inputs: Sequence[Sequence[float]] | Array,
    objective: Objective,
    *,
    base: "Sequence[BaseState] | None" = None,
    contact: str | Sequence[str] | None = None,
    dt: float | Sequence[float] | Array | None = None,
    outputs: Sequence[str] | None = None,
) -> RolloutGradient:
    """Value and gradient of an objective over many steps of a body, from where it is; it is not moved.

    Costs up to three times the steps. Through contact each point keeps what it was found to do, touch, stick or slip;
    where it is about to do otherwise J has a kink, which is warned of.

    Args:
        body: with small strains or large deformation, by any steps, or from equilibrium to equilibrium; with contact,
            strokes and switches or without; held, free, or carried by a base.
        inputs, base, contact, dt: of each step, as in `Simulator.rollout`.
        objective: gets the displacements of outputs by name, m, (steps, points, 3), and the stored energies (steps,),
            J, after each step; returns J, its derivatives with each output, by name, and with each energy (None: 0).
        outputs: names of those that the objective gets; None: all.

    Raises:
        SceneError: something else than a Simulator was given.
        StepError: as in `Simulator.rollout`, or an objective that returns something else, or what is not finite.

    Example:
        >>> body, target = fr.Simulator(rom, dt=1e-3), np.array([0.0, 0.0, 1e-3])
        >>> def miss(outputs, energies):  # of both tips at the end
        ...     apart = outputs["tip"][-1] - target
        ...     slope = np.zeros_like(outputs["tip"])
        ...     slope[-1] = 2 * apart
        ...     return (apart**2).sum(), {"tip": slope}, None
        >>> gradient = fr.differentiate(body, np.zeros((200, 3)), miss)
        >>> gradient.value, gradient.inputs.shape, bool(gradient.inputs[:, 2].sum() < 0)
        (2e-06, (200, 3), True)
    """
    check_type("differentiate", body, Simulator, "fr.Simulator(rom, dt)")
    check_function("objective", objective, StepError, "of outputs and energies")
    names = tuple(body.rom.outputs) if outputs is None else names_in("outputs", outputs, StepError)
    for name in names:
        check_known("output", name, body.rom.outputs, StepError)
    u, plan = plan_steps(body, inputs, contact, dt)
    check_bases(base, len(u))
    if not len(u):
        raise StepError("differentiate: inputs of no step were given; use at least one")
    if body.rom.deformation is None and not (body.needs_each_step or body.relaxes or base is not None):
        return differentiate_linear(body, u, plan, objective, names)
    from fenics_rom.runtime.differentiation.taken_steps import differentiate_taken  # here, as linear bodies need it not

    return differentiate_taken(body, u[:, : body.inputs], plan, objective, names, base, switches=contact is not None)
