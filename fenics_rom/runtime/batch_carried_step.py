"""The step of bodies of a batch that rigid bases carry, in one contact mode: that of `steppers/carried_frame.py`.

Arrays have bodies first: vectors (B, 3), rotations (B, 3, 3).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import rotation_of
from fenics_rom.mechanics.largest_turn import LARGEST_TURN
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_ties import BatchTieForces, BatchTies
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.inertia import pairs


class CarriedMotion(NamedTuple):
    """Bodies between two steps, in the axes of their frames."""

    R: Array
    v: Array  # of the base
    ω: Array
    bent: Array  # I2 q, (B, 6, m)
    coupled: Array  # G q, (B, 3, m)
    moment: Array  # x̄ + c q
    P: Array  # momenta, linear and about the frames' origins
    L: Array
    internal: Array  # v·c r + ω·b r, (B,)


class CarriedStep(NamedTuple):
    """What was found of a step of bodies."""

    start: CarriedMotion
    end: CarriedMotion
    v̂: Array
    ω̂: Array
    middle: Array  # R* = R (1 + h/2 ω̂~)
    pushed: Array  # (B, m + 6) by forces that turn with the frames: coordinates, force, torque
    modal: Array  # all forces on the coordinates (B, m)
    r̂: Array
    tied: BatchTieForces | None = None  # by springs and dashpots to the ground


class CarriedMode:
    """One contact mode: its inertia, its loads, and what a time step makes of them."""

    def __init__(self, rom: Rom, name: str, frame: MovingFrame, environment: ActiveEnvironment, detail: str, most: int):
        model = rom.contact_models[name]
        contacts, loads = rom.contacts[name], FrameLoads(rom, name, model, frame, environment.environment)
        self.frame, self.γ, self.D, self.loads = (
            frame.of_mode(model.coordinates),
            model.eigenvalues,
            model.damping,
            loads,
        )
        tied = frame.springs is not None or frame.dashpots is not None
        self.ties = BatchTies(self.frame) if tied else None
        self.watch = FrameWatch(rom, model, detail)
        columns = np.arange(most + loads.width - contacts)
        self.columns = np.delete(columns, slice(contacts, most))  # of the inputs of a batch
        second = self.frame.inertia2 if self.frame.stiffening is None else self.frame.inertia2 - self.frame.stiffening
        self.products = np.concatenate([second, self.frame.coupling])  # I2 and G, (9, m, m)
        self.couples = bool(self.products.any() or self.frame.inertia1.any())

    def set_time_step(self, h: float) -> None:
        """What does not change from step to step, of h s."""
        diagonal = 2 / h + h / 2 * self.γ
        self.fixed = diagonal + self.D if self.D.ndim == 1 else np.diag(diagonal) + self.D
        if (self.couples or self.ties is not None) and self.D.ndim == 1:
            self.fixed = np.diag(self.fixed)
        if self.ties is not None:
            self.ties.set_time_step(h)

    def motion(self, base: BaseState, q: Array, r: Array) -> CarriedMotion:
        """Of bodies at q and r (B, m) on their bases."""
        frame, (B, m) = self.frame, q.shape
        R = np.moveaxis(np.array(rotation_of(*base.rotation.T)), 2, 0)
        v, ω = seen(R, base.velocity), seen(R, base.angular_velocity)
        shaped = (q @ self.products.reshape(9 * m, m).T).reshape(B, 9, m) if self.couples else np.zeros((B, 9, m))
        bent, coupled = shaped[:, :6], shaped[:, 6:]
        inertia = frame.inertia0 + q @ frame.inertia1.T + np.einsum("bkm,bm->bk", bent, q)
        moved = r @ frame.coupling0.T + np.einsum("bkm,bm->bk", coupled, r)
        moment, drift = frame.first_moment + q @ frame.moment_modes.T, r @ frame.moment_modes.T
        P = frame.mass * v + np.cross(ω, moment) + drift
        L = np.einsum("bij,bj->bi", inertia[:, VOIGT_INDEX], ω) + moved + np.cross(moment, v)
        return CarriedMotion(R, v, ω, bent, coupled, moment, P, L, products_of(drift, v) + products_of(moved, ω))

    def energy(self, base: BaseState, q: Array, r: Array) -> Array:
        """Stored (B,), J: of the motion in world axes, and elastic."""
        now = self.motion(base, q, r)
        energy: Array = (
            products_of(now.P, now.v)
            + products_of(now.L, now.ω)
            + now.internal
            + products_of(r, r)
            + products_of(q, self.γ * q)
        ) / 2
        return energy if self.ties is None else energy + self.ties.stored(base.position, now.R, q)

    def step(self, h: float, bases: tuple[BaseState, BaseState], q: Array, r: Array, u: Array) -> CarriedStep:
        """Of h s from q and r (B, m), between bases, under u (B, p)."""
        frame, loads, m = self.frame, self.loads, q.shape[1]
        start = self.motion(bases[0], q, r)
        R, v, ω = start[:3]
        R_end = np.moveaxis(np.array(rotation_of(*bases[1].rotation.T)), 2, 0)
        v_end, ω_end = seen(R_end, bases[1].velocity), seen(R_end, bases[1].angular_velocity)
        v̂, ω̂ = (v + v_end) / 2, (ω + ω_end) / 2
        middle = R + h / 2 * np.cross(R, ω̂[:, None])
        pushed = u[:, loads.turning] @ loads.push.T
        modal = pushed[:, :m].copy()
        if len(loads.pulling):
            modal += seen(middle, u[:, loads.pulling] @ loads.fields) @ frame.moment_modes
        if len(loads.columns):
            modal += (u[:, loads.columns].reshape(len(u), -1, 3) @ middle).reshape(len(u), -1) @ loads.points.rows.T
        turning = (ω_end - ω) / h
        moving = (v_end - v) / h + (np.cross(ω, v_end) + np.cross(ω_end, v)) / 2
        right = modal + 2 / h * r - self.γ * q - turning @ frame.coupling0 - moving @ frame.moment_modes
        lost = h * np.sqrt(np.maximum(products_of(ω, ω), products_of(ω_end, ω_end))) > LARGEST_TURN
        tied = None
        if self.ties is not None:
            tied = self.ties.begin((bases[0].position, bases[1].position), (R, R_end), q)
            right += tied.modal(middle)
        if self.couples:
            spins: Any = ω.T, ω_end.T
            squares = np.stack(pairs(*spins), axis=1)
            by_rate = (r @ self.products[6:].reshape(3 * m, m).T).reshape(-1, 3, m)
            right += np.einsum("bk,bkm->bm", squares, start.bent) + squares / 2 @ frame.inertia1
            right -= np.einsum("bk,bkm->bm", turning, start.coupled + h / 2 * by_rate)
            factors = np.hstack([-h / 2 * squares, 2 * ω̂])
            A = (factors @ self.products.reshape(9, m * m)).reshape(-1, m, m)
            A += self.fixed
            if self.ties is not None:
                A += self.ties.resisting(middle, R_end)
            A[lost] = np.eye(m)
            r̂ = np.linalg.solve(A, right[:, :, None])[:, :, 0]
        elif self.ties is not None:
            r̂ = np.linalg.solve(self.fixed + self.ties.resisting(middle, R_end), right[:, :, None])[:, :, 0]
        else:
            r̂ = right / self.fixed if self.fixed.ndim == 1 else np.linalg.solve(self.fixed, right.T).T
        r̂[lost] = np.nan
        end = self.motion(bases[1], q + h * r̂, 2 * r̂ - r)
        if self.ties is not None and tied is not None:
            tied = self.ties.end(tied, R_end, r̂)
        return CarriedStep(start, end, v̂, ω̂, middle, pushed, modal, r̂, tied)

    def works(self, h: float, step: CarriedStep) -> Array:
        """What was supplied and dissipated in a step (2, B), J."""
        r̂ = step.r̂
        supplied = products_of(step.end.P - step.start.P, step.v̂) + products_of(step.end.L - step.start.L, step.ω̂)
        damped = r̂ * self.D if self.D.ndim == 1 else r̂ @ self.D
        supplied, dissipated = supplied + h * products_of(step.modal, r̂), h * products_of(r̂, damped)
        if self.ties is not None and step.tied is not None:
            supplied += h * (products_of(step.tied.modal(step.middle), r̂) - step.tied.power)
            dissipated += self.ties.dissipated(step.tied)
        return np.stack([supplied, dissipated])

    def wrench(self, h: float, step: CarriedStep, q: Array, u: Array) -> tuple[Array, Array]:
        """Of the base on bodies that were at q (B, m) under u (B, p), in world axes (B, 3)."""
        start, end, v̂, ω̂, middle, pushed, _, r̂, tied = step
        loads, m = self.loads, q.shape[1]
        P̂, L̂ = (start.P + end.P) / 2, (start.L + end.L) / 2
        force = (end.P - start.P) / h + np.cross(ω̂, P̂) - pushed[:, m : m + 3]
        torque = (end.L - start.L) / h + np.cross(ω̂, L̂) + np.cross(v̂, P̂) - pushed[:, m + 3 :]
        if loads.by_shape is not None:
            torque -= np.einsum("kmp,bp,bm->bk", loads.by_shape, u[:, loads.turning], q + h / 2 * r̂)
        if len(loads.pulling):
            a = u[:, loads.pulling] @ loads.fields
            arm = (turned_by(start.R, start.moment) + turned_by(end.R, end.moment)) / 2
            force -= self.frame.mass * seen(middle, a)
            torque -= seen(middle, np.cross(arm, a))
        if len(loads.columns):
            forces = u[:, loads.columns].reshape(len(u), -1, 3)
            before, after = (loads.points.rest + (x @ loads.points.rows).reshape(forces.shape) for x in (q, q + h * r̂))
            arms = (before @ start.R.transpose(0, 2, 1) + after @ end.R.transpose(0, 2, 1)) / 2
            force -= seen(middle, forces.sum(axis=1))
            torque -= seen(middle, np.cross(arms, forces).sum(axis=1))
        if tied is not None:
            force -= seen(middle, tied.force)
            torque -= seen(middle, tied.torque)
        mean = (start.R + end.R) / 2
        return turned_by(mean, force), turned_by(mean, torque)


def seen(R: Array, a: Array) -> Array:
    """Rᵀ a."""
    seen: Array = np.einsum("bij,bi->bj", R, a)
    return seen


def turned_by(R: Array, a: Array) -> Array:
    """R a."""
    turned: Array = np.einsum("bij,bj->bi", R, a)
    return turned


def products_of(a: Array, b: Array) -> Array:
    """Scalar products (B,) of rows."""
    product: Array = np.einsum("bi,bi->b", a, b)
    return product


def lengths(a: Array) -> Array:
    """Lengths (B,) of rows."""
    length: Array = np.sqrt(products_of(a, a))
    return length
