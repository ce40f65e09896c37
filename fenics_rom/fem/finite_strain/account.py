"""What the energy account is told of a part of a step, before the body moves on: works of loads and contact, heat."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.model import multiply
from fenics_rom.fem.finite_strain.newton import NewtonIterate
from fenics_rom.fem.finite_strain.residuals import MidpointResidual, QuasiStaticResidual, StepResidual
from fenics_rom.fem.finite_strain.stresses import IDENTITY, MidpointStresses
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.points_of_step import PointsOfStep
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ObstacleMotion, equilibrium_work
from fenics_rom.mechanics.hyperelastic import strain


def book_motion(
    body: FullOrderBody, equation: MidpointResidual, solution: NewtonIterate, points: PointsOfStep | None, heat: float
) -> None:
    """Of a midpoint step, whose branches dissipate a heat, J; every rank must call it."""
    if body.ledger is None:
        return
    m, trial, h, contact = equation.model, solution.trial, equation.h, solution.found.contact
    assert isinstance(trial.stresses, MidpointStresses)
    rubbed, _ = _rubbed(body.actuators, equation, trial.v, solution.found.actuators)
    supplied = h * m.dot(trial.external_force - rubbed, trial.v)
    if contact is not None and points is not None:
        body.ledger.book_contact(*contact.work(points.velocities(trial.v), h))
    heat += h * m.dot(trial.v, equation.dragged(trial.v)) + m.points.integrate(trial.stresses.heat)
    body.ledger.book(supplied=supplied, dissipated=heat)
    body.ledger.book(dissipated=-h * m.dot(rubbed, trial.v))
    change = 2 * (trial.v - equation.start.v)
    body.time_step_monitor.add(m.dot(change, m.mass @ change), m.dot(trial.v, m.mass @ trial.v))


def book_equilibrium(
    body: FullOrderBody,
    equation: QuasiStaticResidual,
    solution: NewtonIterate,
    points: PointsOfStep | None,
    obstacles: ObstacleMotion | None,
) -> None:
    """The same between equilibria, as Equilibrium of runtime/steppers does."""
    if body.ledger is None:
        return
    m, h, trial, contact = equation.model, equation.h, solution.trial, solution.found.contact
    x_start = equation.start.x
    x = x_start + h * trial.v
    start = equation.evaluate(np.zeros_like(x), body.reactions)
    elastic = equation.elastic_force(start) + equation.elastic_force(trial)
    stored = m.elastic_energy(strain(trial.stresses.F_end - IDENTITY)) + m.dot(x, multiply(m.spring, x)) / 2
    stored -= m.points.integrate(equation.start.W) + m.dot(x_start, multiply(m.spring, x_start)) / 2
    before, _ = _rubbed(body.actuators, equation, 0 * x, body.reactions)
    after, power = _rubbed(body.actuators, equation, trial.v, solution.found.actuators)
    loads = elastic - before - after
    if points is not None and obstacles is not None:
        loads = loads - points.force_before(body.contact) - points.force(contact)
        velocities, solver = points.velocities(trial.v), points.interface.solver
        of_step = velocities, h, obstacles, solver.law, solver.speeds
        body.ledger.book_contact(*equilibrium_work(body.contact, contact, *of_step))
    done, rubbed = h / 2 * m.dot(elastic, trial.v), h / 2 * m.dot(before + after, trial.v)
    numerical = done - stored - rubbed + h * power
    body.ledger.book(supplied=h / 2 * m.dot(loads, trial.v), dissipated=-h * power, numerical=numerical)


def _rubbed(actuators: ActuatorForces | None, equation: StepResidual, v: Array, found: Array) -> tuple[Array, float]:
    """Force (rows here, 1), N, of guides at a mid-step velocity (rows here, 1), and its power, W."""
    if actuators is None or not actuators.guides:
        return np.zeros_like(v), 0.0
    (columns, rates, _), k = equation.strokes(v), len(actuators.names)
    return actuators.parts(columns, found)[1][:, None], float(rates[k:].dot(found[k:]))
