"""Many bodies on bases of their own, against bodies that are carried one by one, and the account of each."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from test_moving_frame import CLAMPED, FORCE, GRAVITY, reduced, some_way_on, with_dense_damping

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector

SIZE = 4
ROUND_OFF = 1e-11  # of the largest, after some 100 steps: rounding that stiff modes carry on
TENDON = {"effects.tendon.flexor": "points = [[0.0, 0.015, 0.015], [0.15, 0.015, 0.015], [0.3, 0.015, 0.015]]"}
TIP = {"outputs.tip": "points = [[0.3, 0.015, 0.01], [0.3, 0.0, 0.0]]"}

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.fixture(autouse=True)
def in_numpy():
    """What is compiled has tests of its own."""
    with numpy_alone():
        yield


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    """A beam held by a base, under gravity, a force at its end and a tendon; two contact modes."""
    folder = tmp_path_factory.mktemp("carried")
    return reduced(folder, order=8, **CLAMPED, **GRAVITY, **FORCE, **TENDON, **TIP)


def together(bases):
    return BaseState(*(np.array(part) for part in zip(*bases, strict=True)))


@pytest.mark.parametrize("kind", ["full", "quasi-rigid", "dense"])
def test_bodies_of_a_batch_are_carried_as_single_ones(rom, kind):
    """On random paths, under inputs of each, with steps of other lengths and resets; states, accounts and wrenches."""
    detail = "full" if kind == "dense" else kind
    if kind == "dense":
        rom = with_dense_damping(rom)
    batch = fr.Batch(rom, SIZE, 2e-3, ledger=True, detail=detail)
    bodies = [fr.Simulator(rom, 2e-3, detail=detail) for _ in range(SIZE)]
    second, width = list(rom.contact_models)[1], batch.inputs
    batch.switch(second, [1, 2])
    for body in bodies[1:3]:
        body.switch(second)
    random = np.random.default_rng(0)
    bases = [body.pose for body in bodies]
    for step in range(80):
        batch.dt = 10 ** random.uniform(-4, -2)
        if step == 40:
            batch.reset([0])
            bodies[0].reset()
            bases[0] = bodies[0].pose
        bases = [some_way_on(base, batch.dt, random) for base in bases]
        u = 0.05 * random.standard_normal((SIZE, width))
        batch.step(u, base=together(bases))
        for body, base, given in zip(bodies, bases, u, strict=True):
            body.dt = batch.dt
            body.step(given, base=base)
    poses = together([body.pose for body in bodies])
    for found, exact in zip(batch.base, poses, strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-14)
    for read in (
        lambda b: b.state[0],
        lambda b: b.state[1],
        lambda b: b.energy,
        lambda b: b.base_wrench[0],
        lambda b: b.base_wrench[1],
        lambda b: b.displacement("tip"),
        lambda b: b.velocity("tip"),
        lambda b: b.displacement(),
    ):
        exact = np.array([read(body) for body in bodies])
        assert np.abs(read(AsOne(batch)) - exact).max() <= ROUND_OFF * np.abs(exact).max()
    for found, name in ((batch.supplied, "supplied"), (batch.dissipated, "dissipated")):
        exact = np.array([getattr(body.ledger, name) for body in bodies])[1:]  # that of a simulator goes on at a reset
        np.testing.assert_allclose(found[1:], exact, rtol=1e-9)


class AsOne:
    """A batch, read as a simulator is."""

    def __init__(self, batch):
        self.batch = batch
        self.state, self.energy, self.base_wrench = batch.state(), batch.energy, batch.base_wrench
        self.velocity = batch.velocity

    def displacement(self, output=None):
        if output is not None:
            return self.batch.displacement(output)
        return np.array([self.batch.shape(body) for body in range(SIZE)])


def test_account_of_every_body_closes_at_any_step(rom):
    light = {"gravity": 0.01}  # or its work would hide all other
    random = np.random.default_rng(1)
    batch = fr.Batch(rom, SIZE, 1e-3, ledger=True, signals=light)
    bases = [BaseState(*(part[k] for part in batch.base)) for k in range(SIZE)]
    start, scale = batch.energy, np.full(SIZE, 1e-9)
    for _ in range(100):
        batch.dt = 10 ** random.uniform(-4, -1.3)
        bases = [some_way_on(base, batch.dt, random) for base in bases]
        batch.step(0.02 * random.standard_normal((SIZE, batch.inputs)), base=together(bases))
        scale = np.max([scale, batch.energy, np.abs(batch.supplied), batch.dissipated], axis=0)
        assert (np.abs(batch.energy - start - batch.supplied + batch.dissipated) <= 1e-12 * scale).all()
    assert (batch.dissipated > 1e-4 * scale).all()
    assert (batch.base_misfit < 0.1).all()


def test_a_base_that_fails_stops_only_its_body(rom):
    """Its pose not finite, not a unit quaternion, or turning too fast: told, held or begun anew, as asked."""
    batch = fr.Batch(rom, SIZE, 1e-2)
    for _ in range(3):
        batch.step(np.full(batch.inputs, 0.1))
    wrench = batch.base_wrench[1]
    for bad, message in (
        ({"position": np.full(3, np.nan)}, "step 3, body 2: base: use finite numbers"),
        ({"rotation": np.array([2.0, 0, 0, 0])}, "step 3, body 2: base: use finite numbers"),
        ({"angular_velocity": np.array([0.0, 0.0, 400.0])}, "step 3, body 2: its base turns by more than 1.5 rad"),
    ):
        bases = BaseState(*(part.copy() for part in batch.base))
        for name, value in bad.items():
            getattr(bases, name)[2] = value
        before = [*batch.state(), batch.time, *batch.base]
        with pytest.raises(StepError, match=message):
            batch.step(np.zeros(batch.inputs), base=bases)
        for part, kept in zip([*batch.state(), batch.time, *batch.base], before, strict=True):
            np.testing.assert_array_equal(part, kept)
        np.testing.assert_array_equal(batch.base_wrench[1], wrench)
        held, reset, other = copy(batch), copy(batch), copy(batch)
        assert held.step(np.zeros(batch.inputs), base=bases, on_error="hold").tolist() == [2]
        assert reset.step(np.zeros(batch.inputs), base=bases, on_error="reset").tolist() == [2]
        other.step(np.zeros(batch.inputs))
        for one in (held, reset):
            for part, expected in zip(one.state(), other.state(), strict=True):
                np.testing.assert_array_equal(np.delete(part, 2, axis=0), np.delete(expected, 2, axis=0))
        for part, kept in zip([*held.state(), *held.base], [*before[:2], *before[3:]], strict=True):
            np.testing.assert_array_equal(part[2], kept[2])
        assert not held.base_wrench[0][2].any()
        assert held.base_wrench[0][1].any()
        assert not reset.state(2)[1].any()
        assert reset.time[2] == 0


def test_a_step_that_is_refused_tells_no_tension(rom):
    batch, pushes = fr.Batch(rom, 2, 1e-2), np.zeros(4)
    pushes[3] = -1.0
    with pytest.raises(StepError, match="turns by more than"):
        batch.step(pushes, base=batch.base._replace(angular_velocity=np.full((2, 3), 400.0)))
    assert batch.least_tensions["flexor"].tolist() == [0.0, 0.0]
    batch.step(pushes)
    assert batch.least_tensions["flexor"].tolist() == [-1.0, -1.0]


def test_bases_follow_the_environment_at_the_time_of_their_bodies(rom):
    there = BaseState(np.array([1.0, 2.0, 3.0]), quaternion_of_vector((0, 0, 2.0)), np.ones(3), np.array([0, 0, 1.0]))
    path = {"base_path": lambda t: there._replace(position=there.position + t)}
    batch = fr.Batch(rom, 2, 1e-3, signals=path)
    np.testing.assert_array_equal(batch.base.position, np.tile(there.position, (2, 1)))
    batch.step(np.zeros(batch.inputs))
    batch.reset(1)
    batch.step(np.zeros(batch.inputs))
    np.testing.assert_allclose(batch.base.position, there.position + np.array([[2e-3], [1e-3]]), rtol=1e-15)


def test_what_is_beyond_the_model_is_told(rom):
    batch = fr.Batch(replace(rom, moving_frame=replace(rom.moving_frame, stiffening=None)), 3, 1e-3)
    still = batch.base
    batch.step(np.zeros(batch.inputs), base=still._replace(angular_velocity=np.outer([0, 6, 0], [0.0, 1.0, 0.0])))
    assert batch.beyond_training.tolist() == [False, True, False]
    assert batch.base_misfit[1] > 0.1
    q, r = batch.state()
    q[2, 0] = 0.05
    batch.set_state(q, r)
    assert not batch.beyond_training.any()
    batch.step(np.zeros(batch.inputs))
    assert batch.beyond_training.tolist() == [False, False, True]


@pytest.mark.parametrize("detail", ["full", "quasi-rigid"])
@pytest.mark.parametrize("part", ["velocity", "position"])
def test_bases_that_jump_or_whose_velocities_move_nothing_are_told(rom, detail, part):
    """One of 5 m/s that stands, and one that is 1 m away after a step; alone and among others."""
    batch, body = fr.Batch(rom, 2, 1e-3, detail=detail), fr.Simulator(rom, 1e-3, detail=detail)
    changes = {"velocity": [5.0, 0.0, 0.0], "position": body.pose.position + np.eye(3)[0]}
    body_at_rest = body.pose
    base = body_at_rest._replace(**{part: np.array(changes[part])})
    for _ in range(2):
        body.step(np.zeros(batch.inputs), base=base)
        batch.step(np.zeros(batch.inputs), base=together([base, body_at_rest]))
    far = {"velocity": "0.005", "position": "1"}[part]
    assert any(f"base: in a step it went {far} m and turned 0 rad otherwise" in text for text in body.warnings)
    assert batch.base_misfit[0] == pytest.approx(1.0)
    assert batch.base_misfit[1] == 0.0


def test_bases_are_placed_and_what_cannot_be_done_is_said(rom, tmp_path):
    batch = fr.Batch(rom, SIZE, 1e-3)
    turned = BaseState(np.ones(3), quaternion_of_vector((0, 0.5, 0)), np.zeros(3), np.zeros(3))
    batch.place(turned, [1, 3])
    np.testing.assert_array_equal(batch.base.position[:, 0], [0, 1, 0, 1])
    batch.step(np.full(batch.inputs, 0.1))
    for message, attempt in (
        ("arrays of shapes", lambda: batch.step(np.zeros(batch.inputs), base=np.zeros(3))),
        ("arrays of shapes", lambda: batch.place(turned._replace(position=np.zeros((3, 3))), [1, 3])),
        ("base of body 3: use finite", lambda: batch.place(turned._replace(velocity=np.full(3, np.inf)), 3)),
        ("no detail 'rough'; there is full, quasi-rigid", lambda: fr.Batch(rom, 2, 1e-3, detail="rough")),
    ):
        with pytest.raises(StepError, match=message):
            attempt()
