"""Slopes of what a step of a body in a moving frame balances, part by part, against differences of the fourth order."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, carried_along
from fenics_rom.mechanics.frame_motion import cayley, quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, PointsMoved, Slopes, StepTurn
from fenics_rom.runtime.steppers.ground_ties import GroundTies

Array = np.ndarray
M, P, H, REACH = 5, 4, 0.03, 1e-3
AGREES = 1e-8  # of the largest slope: differences of the fourth order at this reach leave 1e-11
random = np.random.default_rng(3)


class Start(NamedTuple):
    """What a step begins with, and its velocities x."""

    p: Array
    R: Array
    q: Array
    v: Array
    ω: Array
    r: Array
    x: Array
    given: tuple[Array, Array] | None = None  # p and R where a base ends

    def moved(self, place: Array, velocity: Array, x: Array, end: Array) -> "Start":
        """The same by small (k,) each, and by (6,)."""
        turn, given = rotation_matrix(quaternion_of_vector(place[3:6])), self.given
        if given is not None:
            given = given[0] + end[:3], given[1] @ rotation_matrix(quaternion_of_vector(end[3:6]))
        return Start(
            self.p + place[:3],
            self.R @ turn,
            self.q + place[6:],
            self.v + velocity[:3],
            self.ω + velocity[3:6],
            self.r + velocity[6:],
            self.x + x,
            given,
        )

    @property
    def step(self) -> StepTurn:
        t, given = H * self.x[3:6], self.given
        end = self.R @ cayley(t) if given is None else given[1]
        return StepTurn(Geometry(self.R.tolist(), end.tolist(), tuple(t)), H, self.x[3:6], given is not None)

    @property
    def ends(self) -> tuple[Moving, Moving]:
        v̂, ω̂, r̂ = np.split(self.x, [3, 6])
        before = Moving(self.p, self.v, self.ω, self.q, self.r)
        position = self.p + H * v̂ if self.given is None else self.given[0]
        return before, Moving(position, 2 * v̂ - self.v, 2 * ω̂ - self.ω, self.q + H * r̂, 2 * r̂ - self.r)


def symmetric(*shape: int) -> Array:
    A = random.standard_normal(shape)
    return A + np.swapaxes(A, -1, -2)


@pytest.fixture(scope="module", params=["free", "carried"])
def start(request) -> Start:
    R = rotation_matrix(quaternion_of_vector(random.standard_normal(3)))
    p, q, v, ω, r, x = (random.standard_normal(n) for n in (3, M, 3, 3, M, 6 + M))
    begun = Start(p, R, q, v, 5 * ω, r, 5 * x)
    away = rotation_matrix(quaternion_of_vector(0.1 * random.standard_normal(3)))  # from where twists lead
    return begun if request.param == "free" else begun._replace(given=(p + 0.1, begun.step.turn.end @ away))


@pytest.fixture(scope="module")
def frame(start) -> MovingFrame:
    G, carried = random.standard_normal((3, M, M)), start.given is not None
    return MovingFrame(
        carried=carried,
        origin=random.standard_normal(3),
        mass=1.7,
        first_moment=carried * random.standard_normal(3),
        moment_modes=carried * random.standard_normal((3, M)),
        inertia0=random.standard_normal(6),
        inertia1=random.standard_normal((6, M)),
        inertia2=symmetric(6, M, M),
        coupling0=random.standard_normal((3, M)),
        coupling=G - G.transpose(0, 2, 1),
        springs=symmetric(4 + 3 * M, 4 + 3 * M),
        dashpots=symmetric(4 + 3 * M, 4 + 3 * M),
    )


def check(slopes: Slopes, start: Start, value: Callable[[Start], Array]) -> None:
    """That they are those of a value."""
    for number, found in enumerate(slopes if start.given is not None else slopes[:3]):
        expected = np.empty_like(found)
        for column, unit in enumerate(np.eye(6 + M)[: found.shape[1]]):

            def along(reach, number=number, unit=unit):
                return value(start.moved(*(reach * unit * (number == each) for each in range(4))))

            near, far = along(REACH) - along(-REACH), along(2 * REACH) - along(-2 * REACH)
            expected[:, column] = (8 * near - far) / (12 * REACH)
        assert np.abs(found - expected).max() <= AGREES * max(np.abs(expected).max(), 1.0)


def test_inertia(start, frame):
    """As in the equations of `free_frame`, and what is stored."""
    I1, I2, G = frame.inertia1, frame.inertia2, frame.coupling

    def momenta(at):
        inertia = (frame.inertia0 + I1 @ at.q + np.einsum("kij,i,j->k", I2, at.q, at.q))[VOIGT_INDEX]
        b = frame.coupling0 + G @ at.q
        return inertia @ at.ω + b @ at.r, at.r + at.ω @ b, inertia, b

    def balance(start):
        before, after = start.ends
        (L, s, *_), (L_end, s_end, *_), (x, middle) = momenta(before), momenta(after), (start.x, before.q + after.q)
        ω, ω_end = before.ω, after.ω
        bent = (I1 + I2 @ middle)[VOIGT_INDEX]
        coordinates = (s_end - s) / H + np.einsum("k,kij,j->i", ω, G, after.r) / 2
        coordinates += np.einsum("k,kij,j->i", ω_end, G, before.r) / 2 - np.einsum("k,l,klm->m", ω, ω_end, bent) / 2
        turning = (L_end - L) / H + np.cross(x[3:6], (L + L_end) / 2)
        pulled = (after.v - before.v) / H + (np.cross(ω, after.v) + np.cross(ω_end, before.v)) / 2
        coordinates += frame.moment_modes.T @ pulled
        return np.concatenate([frame.mass * (after.v - before.v) / H, turning, coordinates])

    inertia = InertiaSlopes(frame, I2)
    slopes = inertia.balance(*start.ends, start.step)
    if start.given is None:
        check(slopes, start, balance)
    else:  # what the base bears is left out
        check(Slopes(*(each[6:] for each in slopes)), start, lambda s: balance(s)[6:])

    def stored(start):
        before, _ = start.ends
        _, _, inertia, b = momenta(before)
        turning = before.ω @ inertia @ before.ω / 2 + before.ω @ b @ before.r
        moment = frame.first_moment + frame.moment_modes @ before.q
        carried = before.v @ (np.cross(before.ω, moment) + frame.moment_modes @ before.r)
        return np.array([frame.mass * before.v @ before.v / 2 + turning + before.r @ before.r / 2 + carried])

    place, velocity = inertia.stored(start.ends[0])
    check(Slopes(place[None], velocity[None], np.zeros((1, 6 + M)), np.zeros((1, 6))), start, stored)


def test_points_and_forces_on_them(start):
    """Their velocities in the middle of the step, those with the velocities of its start, and what forces do."""
    rest, rows, f = random.standard_normal((P, 3)), random.standard_normal((M, 3 * P)), random.standard_normal((P, 3))
    yielded, yields, yielding = random.standard_normal((3, P, 3))

    def moved(q):
        return (q @ rows).reshape(-1, 3)

    def of(start, velocities, inside):
        v, ω, r = velocities
        turn, y, û = start.step.turn, rest + moved(start.q) + yielded, moved(start.x[6:]) + yields
        arms = arms_of(turn, y, y + H * û)
        v = v if start.given is None else turn.middle @ v
        return turn, arms, (carried_along(turn, arms, ω, moved(r) + inside) + v).ravel()

    points = PointsMoved(start.step, rows, rest + moved(start.q) + yielded, moved(start.x[6:]) + yields)
    mean = points.joined(points.velocity(start.x[3:6], points.inside), start.x[:3], is_mean=True)
    check(mean.slopes, start, lambda s: of(s, np.split(s.x, [3, 6]), yields)[2])
    kept = points.joined(points.velocity(start.ω, moved(start.r) + yielding), start.v, is_mean=False)
    check(kept.slopes, start, lambda s: of(s, (s.v, s.ω, s.r), yielding)[2])

    def pushed(s):
        turn, arms, _ = of(s, np.split(s.x, [3, 6]), yields)
        push = Push.of(f, turn, arms, lambda inside: rows @ inside.ravel())
        return np.concatenate([push.force, push.turning, push.modal])

    push = points.push(f)
    check(push.slopes, start, pushed)
    assert push.by_forces @ f.ravel() == pytest.approx(pushed(start), rel=1e-13)
    check(points.seen(f), start, lambda s: f.dot(s.step.turn.middle).ravel())
    at_rest = np.zeros((3 * P, 6 + M))
    displacement = Slopes(points.displacement(), at_rest, at_rest, at_rest[:, :6])
    check(displacement, start, lambda s: ((rest + moved(s.q) + yielded) @ s.R.T + s.p).ravel())


def test_ties_to_the_ground(start, frame):
    """What they do to a body in a step, and what they store."""

    def tied(start):
        ties = GroundTies(frame)
        ties.set_time_step(H)
        ties.place(start.p, start.R, start.q)
        force = np.zeros(3)
        if start.given is not None:
            nothing, end = np.zeros((M, M)), tuple(start.given[0])
            tied = ties.with_rate(ties.of_carried(nothing, nothing[0], start.step.turn, end)[2], start.x[6:])
            return np.concatenate([tied.push().force, tied.push().turning, tied.push().modal])
        tied = ties.of_free(start.step.turn, start.x[3:], 1.0, tuple(start.v), force)
        # v̂ is given here: P is linear in it
        tied = tied._replace(forces=tied.forces - np.outer(start.x[:3] - tied.velocity, ties.resistance[0]))
        push = tied.push()
        return np.concatenate([push.force, push.turning, push.modal])

    ties = GroundTies(frame)
    ties.set_time_step(H)
    check(ties.push_slopes(*start.ends, start.step), start, tied)

    def stored(start):
        ties.place(start.p, start.R, start.q)
        return np.array([ties.placed.stored])

    nothing = np.zeros((1, 6 + M))
    slopes = ties.stored_slopes(start.ends[0], start.R)[None]
    check(Slopes(slopes, nothing, nothing, nothing[:, :6]), start, stored)
