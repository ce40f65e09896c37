"""How good reduced bodies in a moving frame are: known problems of rotating beams, and what may be left out."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from link_chain import tip_lag

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.step import StepInput
from fenics_rom.scene.file import parse_scene

BENDING, WEIGHT, LENGTH, SIDE = 566.0, 0.2019, 8.0, 0.05  # EI, N m²; kg/m; m
MATERIAL = f"young = {12 * BENDING / SIDE**4}\npoisson = 0.0\ndensity = {WEIGHT / SIDE**2}"
SPIN_UP, SPEED = 15.0, 4.0  # s, rad/s


def moving(mesh, **parts):
    return fr.assemble(parse_scene('frame = "moving"\n' + scene_text(mesh, degree=2, **parts)))


@pytest.fixture(scope="module")
def slewing(tmp_path_factory):
    """A slender beam on a hub: ω₁ = 2.915 rad/s in theory, of this mesh 2.917."""
    mesh = tmp_path_factory.mktemp("slewing") / "beam.msh"
    write_arrays(mesh, *box_arrays((LENGTH, SIDE, SIDE), (8, 1, 1)))
    tip = {"outputs.tip": f"points = [[{LENGTH}, {SIDE / 2}, {SIDE / 2}]]"}
    effects = f"inertia = {{}}\nbase_path = {{ origin = [0.0, {SIDE / 2}, {SIDE / 2}] }}"
    return fr.reduce(moving(mesh, material=MATERIAL, effects=effects, **tip), order=10, method="modal")


def hub_motion(time, speed):
    """Angle, rad, and rate of a hub that is spun up from rest to a speed in 15 s, smoothly."""
    τ = SPIN_UP / (2 * np.pi)
    if time >= SPIN_UP:
        return speed * (time - SPIN_UP / 2), speed
    angle = speed / SPIN_UP * (time**2 / 2 + τ**2 * (np.cos(time / τ) - 1))
    return angle, speed / SPIN_UP * (time - τ * np.sin(time / τ))


def largest_lag(length, bending, weight, speed):
    """Of a beam that is spun up, m, by chains of 6 and 12 links, whose errors go with 1/N²."""
    lags = [tip_lag(N, length, bending, weight, lambda t: hub_motion(t, speed)[0], 7.5).max() for N in (6, 12)]
    return lags[1] + (lags[1] - lags[0]) / 3


def hub(rom, speed=SPEED):
    """Such a hub as a base."""

    def state(time):
        angle, rate = hub_motion(time, speed)
        rotation = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        return fr.BaseState(rom.moving_frame.origin, rotation, np.zeros(3), np.array([0.0, 0.0, rate]))

    return state


def tip_motion(rom, dt=0.02, speed=SPEED):
    """Where the tip is in the frame beside where it is at rest, in each step of 16 s, (steps, 3), m."""
    path = hub(rom, speed)
    body = fr.Simulator(rom, dt, signals={"base_path": path})
    body.place(path(0.0))
    rows, tip = body.output_rows("tip"), []
    for _ in range(round(16 / dt)):
        body.step(np.zeros(3))
        tip.append(rows @ body.state[0])
    return np.array(tip)


def lags(rom, dt=0.02):
    """How far the tip lags behind the hub in each step of 16 s, m."""
    return -tip_motion(rom, dt)[:, 1]


def test_slewing_beam_lags_behind_its_hub_by_half_a_metre(slewing):
    """As a chain of links, which turn as far as they like: 0.534 m, at 6.76 s; without stiffening it flies apart."""
    exact = largest_lag(LENGTH, BENDING, WEIGHT, SPEED)
    assert exact == pytest.approx(0.5343, abs=1e-4)  # what chains of 8 to 32 links come to
    for order in (5, 10):
        lag = lags(fr.truncate(slewing, order))
        assert lag.max() == pytest.approx(exact, rel=6e-3)
        assert (lag.argmax() + 1) * 0.02 == pytest.approx(6.76, abs=0.03)
    soft = replace(slewing, moving_frame=replace(slewing.moving_frame, stiffening=None))
    with np.errstate(over="ignore", invalid="ignore"), pytest.warns(FenicsRomWarning):
        assert np.abs(lags(soft)).max() > LENGTH


def test_spin_up_of_simo_and_vu_quoc(tmp_path):
    """Their beam (Comput. Methods Appl. Mech. Eng. 66, 1988, 125-161; also VM258 of Ansys' verification manual).

    It is spun up to 6 rad/s in 15 s. Before, it lags by at most 5.7 % of its length, as a chain of links does to half a
    percent; then it is stretched by ρA ω² L³/(3 EA) = 5.14e-4 m, and rings by less than a percent of that lag.
    """
    length, stretching, bending, weight, speed = 10.0, 2.8e7, 1.4e4, 1.2, 6.0
    side = np.sqrt(12 * bending / stretching)
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((length, side, side), (12, 1, 1)))
    material = f"young = {stretching / side**2}\npoisson = 0.0\ndensity = {weight / side**2}"
    tip = {"outputs.tip": f"points = [[{length}, {side / 2}, {side / 2}]]"}
    effects = f"inertia = {{}}\nbase_path = {{ origin = [0.0, {side / 2}, {side / 2}] }}"
    beam = fr.reduce(moving(mesh, material=material, effects=effects, **tip), order=12, method="modal+static")
    along, across, _ = tip_motion(beam, speed=speed).T
    lag, exact = -across, largest_lag(length, bending, weight, speed)
    assert along[760:].mean() == pytest.approx(weight * speed**2 * length**3 / (3 * stretching), rel=2e-3)
    assert exact == pytest.approx(0.57375, abs=1e-4)  # what chains of 8 to 32 links come to
    assert lag.max() == pytest.approx(exact, rel=5e-3)
    assert (lag.argmax() + 1) * 0.02 == pytest.approx(6.76, abs=0.03)
    assert np.abs(lag[760:]).max() < 0.01 * lag.max()


@pytest.mark.slow
def test_slewing_beam_lags_as_one_of_large_deformation(slewing, tmp_path):
    """At order 10 as by St. Venant-Kirchhoff's law at full order, same mesh, which inertia pushes in the hub's frame.

    These forces, of the step's means, are those of the displacements that they lead to, by iteration.
    """
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((LENGTH, SIDE, SIDE), (8, 1, 1)))
    large = 'inertia = {}\n[effects.large_deformation]\nmaterial = "st_venant_kirchhoff"'
    tip = {"outputs.tip": f"points = [[{LENGTH}, {SIDE / 2}, {SIDE / 2}]]"}
    system = fr.assemble(parse_scene(scene_text(mesh, material=MATERIAL, degree=2, effects=large, **tip)))
    body = FiniteStrainStepper(
        replace(system, contacts={"all": np.eye(system.size)}), system.deformation.model, dt := 0.04
    )
    path, y = hub(slewing), system.body.nodes - slewing.moving_frame.origin
    field, v̂, lag = system.deformation.model.nodal_field, body.v, []
    for k in range(round(7.0 / dt)):
        ω, ω_end = (path(time).angular_velocity for time in (k * dt, (k + 1) * dt))
        ω̂, x, v̂, change = (ω + ω_end) / 2, body.x, 2 * body.v - v̂, np.inf
        while change > 1e-9 * max(np.abs(v̂).max(), 1e-3):
            turning = np.cross(ω_end - ω, y + field(x + dt / 2 * v̂)) / dt + 2 * np.cross(ω̂, field(v̂))
            turning += np.cross(ω̂, np.cross(ω̂, y + field(x + dt / 2 * v̂)))
            if np.isfinite(change):
                body.rollback()
            body.step(StepInput(-(system.mass @ turning.ravel()[system.body.free, None])[:, 0]))
            v̂, change = (body.x - x) / dt, np.abs((body.x - x) / dt - v̂).max()
        lag.append(-body.displacement("tip")[0, 1])
    body.close()
    reduced = lags(slewing, dt)[: len(lag)]
    assert reduced.max() == pytest.approx(max(lag), rel=0.02)
    assert np.linalg.norm(reduced - lag) <= 0.02 * np.linalg.norm(lag)
    assert abs(int(reduced.argmax()) - int(np.argmax(lag))) <= 1


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A soft beam that nothing holds, linear and with large deformation, and its mesh's model of order 12."""
    mesh = tmp_path_factory.mktemp("free") / "beam.msh"
    write_arrays(mesh, *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    parts = {"supports": None, "material": "young = 5e5\npoisson = 0.4\ndensity = 1100.0"}
    linear = moving(mesh, effects="inertia = {}", **parts)
    large = 'inertia = {}\n[effects.large_deformation]\nmaterial = "st_venant_kirchhoff"'
    return fr.reduce(linear, order=12, method="modal"), parse_scene(scene_text(mesh, degree=2, effects=large, **parts))


AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)


def bent(rom, share, spin, dt, **options):
    """A body that begins bent in its first mode by a share of its length, and spinning, rad/s."""
    body = fr.Simulator(rom, dt, **options)
    q = np.zeros(len(body.state[0]))
    q[0] = share * 0.3 / np.abs(rom.basis[:, rom.rigid]).max()
    body.state = q, np.zeros_like(q)
    body.place(fr.BaseState(rom.moving_frame.origin, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), spin * AXIS))
    return body


def without_stiffening(rom):
    return replace(rom, moving_frame=replace(rom.moving_frame, stiffening=None))


def test_what_may_be_left_out_of_slow_bodies(free):
    """Stiffening, to about 25 (ω/ω₁)²; all but the inertia of the rigid shape, where there is next to no spin."""
    rom, ω = free[0], np.sqrt(free[0].stiffness[6])
    dt, errors = 2 * np.pi / ω / 100, {}
    for spin in (0.003, 0.01, 0.03):
        models = {"full": (rom, {}), "soft": (without_stiffening(rom), {}), "quasi": (rom, {"detail": "quasi-rigid"})}
        runs = {}
        for name, (model, options) in models.items():
            body = bent(model, 0.01, spin * ω, dt, **options)
            runs[name] = np.array([body.state[0] for _ in range(200) if body.step(np.zeros(3)) is None])
        for name in ("soft", "quasi"):
            errors[name, spin] = np.linalg.norm(runs[name] - runs["full"]) / np.linalg.norm(runs["full"])
    assert errors["soft", 0.03] / errors["soft", 0.01] == pytest.approx(9, rel=0.1)
    assert 5 <= errors["soft", 0.03] / 0.03**2 <= 50
    assert 1e-6 < errors["quasi", 0.003] < 5e-3


def test_large_deformation_of_a_free_body_is_refused_but_at_full_order(free):
    with pytest.raises(
        SceneError, match="turns as far as it likes, which no fixed basis follows; take frame = 'moving'"
    ):
        fr.reduce(fr.assemble(free[1]), order=4)


@pytest.mark.slow
def test_spinning_beam_is_that_of_large_deformation(free):
    """A free beam that bends by 0.1 % of its length, at a tenth of its first frequency: 0.6 s at full order."""
    rom, large = free
    system = fr.assemble(large)
    full = FullOrderSimulator(system, 1e-3, large.environment)
    X, m, spin = system.body.nodes - rom.moving_frame.origin, system.body.node_mass, 3.0
    start = bent(rom, 0.001, 0.0, 1e-3).displacement()
    full.stepper.set_state(start.ravel(), np.cross(spin * AXIS, X + start).ravel())
    models = [bent(model, 0.001, spin, 1e-3) for model in (rom, without_stiffening(rom))]

    def strained(body):
        """Displacements less the nearest rigid motion, weighted by mass."""
        moved = X + body.displacement()
        moved = moved - m @ moved / m.sum()
        U, _, Wᵀ = np.linalg.svd((m[:, None] * X).T @ moved)
        return np.sqrt(m)[:, None] * (moved @ (U @ np.diag([1, 1, np.linalg.det(U @ Wᵀ)]) @ Wᵀ).T - X)

    errors, size = np.zeros(2), 0.0
    for step in range(600):
        for body in (full, *models):
            body.step(np.zeros(3))
        if step % 5 == 4:
            truth = strained(full)
            size += (truth**2).sum()
            errors += [((strained(body) - truth) ** 2).sum() for body in models]
    stiffened, soft = np.sqrt(errors / size)
    assert stiffened <= 8e-3
    assert 0.07 <= soft <= 0.3
