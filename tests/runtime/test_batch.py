"""Many bodies at once against one body in plain linear algebra, and the exact laws for each of them."""

import pickle
import tracemalloc
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_energy_laws import CLOSES_TO, NONE_ADDED, random_rom

from fenics_rom.errors import StepError
from fenics_rom.rom.rom import check_rom
from fenics_rom.runtime.batch import Batch

ROUND_OFF = 1e-12  # of the largest state, where two ways of computing the same differ


def varied_rom(random, dense=False):
    """Contact modes of orders 9, 4 and 7 with 2, 1 and 3 contact columns, an actuator with 2, and an output."""
    rom = random_rom(random, 12, [9, 4, 7], 3, dense)
    widths = dict(zip(rom.contact_models, (4, 3, 5), strict=True))
    modes = {
        name: replace(mode, inputs=random.standard_normal((mode.order, widths[name])))
        for name, mode in rom.contact_models.items()
    }
    return check_rom(
        replace(rom, contact_models=modes, actuators={"pull": 2}, outputs={"tip": random.standard_normal((6, 12))})
    )


class Body:
    """One body by the formulas of the papers, in (q, r), with dense linear algebra."""

    def __init__(self, rom):
        self.rom, self.name = rom, next(iter(rom.contact_models))
        self.q, self.r = np.zeros((2, self.mode.order))

    @property
    def mode(self):
        return self.rom.contact_models[self.name]

    def step(self, u, h):
        mode, contact = self.mode, self.rom.contacts[self.name]
        used = np.concatenate([u[:contact], u[max(self.rom.contacts.values()) :]])
        K = np.diag(mode.eigenvalues)
        D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
        A = 2 / h * np.eye(mode.order) + D + h / 2 * K
        v = np.linalg.solve(A, mode.inputs @ used + 2 / h * self.r - K @ self.q)
        self.q, self.r = self.q + h * v, 2 * v - self.r

    def switch(self, name):
        if name == self.name:
            return
        start, end = self.mode, self.rom.contact_models[name]
        stiffness = end.coordinates.T @ (self.rom.stiffness[:, None] * start.coordinates)
        self.q, self.r = stiffness @ self.q / end.eigenvalues, end.coordinates.T @ (start.coordinates @ self.r)
        self.name = name

    @property
    def strained(self):
        """√γ q and r."""
        return np.concatenate([np.sqrt(self.mode.eigenvalues) * self.q, self.r])


def strained(batch, body):
    mode = batch.rom.contact_models[batch.contact[body]]
    q, r = (part[0, : mode.order] for part in batch.state(body))
    return np.concatenate([np.sqrt(mode.eigenvalues) * q, r])


def everything(batch):
    return [*batch.state(), batch.contact, batch.time, batch.energy]


def assert_same(one, other):
    for before, after in zip(one, other, strict=True):
        np.testing.assert_array_equal(after, before)


def moving(rom, size, seed=0, **choice):
    """A batch in any contact modes, after a few random steps."""
    random = np.random.default_rng(seed)
    batch = Batch(rom, size, 1e-2, **choice)
    for _ in range(5):
        batch.switch(random.choice(list(rom.contact_models), size))
        batch.step(random.standard_normal((size, batch.inputs)))
    return batch


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch):
    """Of some twenty bodies, so that small batches have several."""
    monkeypatch.setattr("fenics_rom.runtime.batch_arrays.CHUNK_BYTES", 1 << 13)


@pytest.fixture(scope="module", params=[False, True], ids=["diagonal", "dense"])
def rom(request):
    return varied_rom(np.random.default_rng(0), request.param)


@pytest.mark.parametrize("size", [1, 7, 40])
def test_batch_is_the_formulas_for_each_body(rom, size):
    random = np.random.default_rng(size)
    batch, bodies, names = Batch(rom, size, 1e-2), [Body(rom) for _ in range(size)], list(rom.contact_models)
    assert batch.inputs == 5
    worst = scale = 0.0
    for _ in range(60):
        batch.dt = h = 10 ** random.uniform(-4, 0)
        for _ in range(random.integers(3)):  # several switches between two steps, too
            chosen, targets = np.flatnonzero(random.random(size) < 0.3), random.choice(names, size)
            batch.switch(targets[chosen], chosen)
            for k in chosen:
                bodies[k].switch(targets[k])
        if random.random() < 0.1:
            rest = random.random(size) < 0.2
            batch.reset(rest)
            bodies = [Body(rom) if rest[k] else body for k, body in enumerate(bodies)]
        u = random.standard_normal((size, 5)) * 10 ** random.uniform(-2, 2, (size, 1))
        batch.step(u)
        for body, own in zip(bodies, u, strict=True):
            body.step(own, h)
        scale = max(scale, *(np.abs(body.strained).max() for body in bodies))
        worst = max(worst, *(np.abs(strained(batch, k) - body.strained).max() for k, body in enumerate(bodies)))
    assert batch.contact.tolist() == [body.name for body in bodies]
    assert worst <= ROUND_OFF * scale
    np.testing.assert_allclose(batch.energy, [body.strained @ body.strained / 2 for body in bodies], rtol=1e-9)
    for read, part in ((batch.displacement, "q"), (batch.velocity, "r")):
        exact = [rom.outputs["tip"] @ (body.mode.coordinates @ getattr(body, part)) for body in bodies]
        assert read("tip").shape == (size, 2, 3)
        np.testing.assert_allclose(read("tip").reshape(size, 6), exact, rtol=0, atol=1e-10 * np.abs(exact).max())
    shape = np.zeros(36)
    shape[:12] = bodies[-1].mode.coordinates @ bodies[-1].q
    np.testing.assert_allclose(batch.shape(size - 1).ravel(), shape, atol=1e-10 * np.abs(shape).max())


ACTIONS = st.lists(st.sampled_from(["switch", "dt", "reset", "step", "step", "step"]), min_size=5, max_size=60)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), decades=st.floats(0, 8), dense=st.booleans(), actions=ACTIONS)
def test_account_of_each_body_closes(seed, decades, dense, actions):
    random = np.random.default_rng(seed)
    free, size = int(random.integers(3, 25)), 6
    rom = random_rom(random, free, random.integers(1, free + 1, 3), decades, dense)
    batch, names, scale = Batch(rom, size, 1e-3, ledger=True), list(rom.contact_models), np.zeros(6)
    for action in actions:
        some = random.random(size) < 0.5
        if action == "switch":
            before, lost = batch.energy, batch.lost_in_switching
            batch.switch(random.choice(names, some.sum()), some)
            assert (before - batch.energy >= -NONE_ADDED * before).all()
            assert (batch.lost_in_switching - lost >= -CLOSES_TO * scale).all()
        elif action == "dt":
            batch.dt = 10 ** random.uniform(-6, -1)
        elif action == "reset":
            batch.reset(some)
            assert not any(entry[some].any() for entry in (batch.energy, batch.supplied, batch.time))
        else:
            before, u = batch.state()[1], random.standard_normal((size, batch.inputs)) * 10 ** random.uniform(-3, 3)
            batch.step(u)
            for k, v in enumerate(np.abs(before + batch.state()[1]) / 2):  # as work_one_by_one
                G = rom.contact_models[batch.contact[k]].inputs
                scale[k] = max(scale[k], batch.dt * v[: len(G)] @ np.abs(G) @ np.abs(u[k]))
        spent = batch.dissipated + batch.lost_in_switching
        scale = np.max([scale, batch.energy, np.abs(batch.supplied), batch.dissipated], axis=0)
        assert (np.abs(batch.energy - batch.supplied + spent) <= CLOSES_TO * scale).all()
        assert (batch.dissipated >= 0).all()


@pytest.mark.parametrize("ledger", [False, True])
def test_neighbours_change_nothing(rom, ledger):
    """The same seven bodies alone, together, among 293 others, and in another order."""
    random = np.random.default_rng(4)
    names, chosen = list(rom.contact_models), random.permutation(300)[:7]
    contacts, inputs = random.choice(names, (30, 300)), random.standard_normal((30, 300, 5))

    def run(bodies):
        batch = Batch(rom, len(bodies), 1e-2, ledger=ledger)
        for names, u in zip(contacts[:, bodies], inputs[:, bodies], strict=True):
            batch.switch(names)
            batch.step(u)
        return np.hstack([*batch.state(), batch.energy[:, None], *([batch.dissipated[:, None]] if ledger else [])])

    among = run(np.arange(300))[chosen]
    shuffle = random.permutation(7)
    for other in (run(chosen), np.vstack([run([k]) for k in chosen]), run(chosen[shuffle])[np.argsort(shuffle)]):
        np.testing.assert_allclose(other, among, rtol=0, atol=ROUND_OFF * np.abs(among).max())


def test_account_changes_no_bit_of_the_motion(rom):
    assert_same(everything(moving(rom, 20)), everything(moving(rom, 20, ledger=True)))
    with pytest.raises(StepError, match="ledger=True"):
        moving(rom, 2).supplied  # noqa: B018


def test_one_input_or_contact_stands_for_all(rom):
    one, other = moving(rom, 9), moving(rom, 9)
    one.switch("mode1")
    one.step(np.arange(5.0))
    other.switch(["mode1"] * 9)
    other.step(np.tile(np.arange(5.0), (9, 1)))
    assert_same(everything(one), everything(other))


def test_columns_that_a_contact_mode_lacks_do_nothing(rom):
    one, other = moving(rom, 3), moving(rom, 3)
    for batch, ignored in ((one, 0.0), (other, 1e3)):
        batch.switch("mode1")  # one contact column of three
        batch.step([1.0, ignored, ignored, -1.0, 2.0])
    assert_same(everything(one), everything(other))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_bad_input_names_body_and_step_and_changes_no_bit(rom, dtype, bad):
    batch = moving(rom, 8, dtype=dtype, ledger=True)
    before = [*everything(batch), batch.supplied, batch.dissipated]
    u = np.ones((8, 5))
    u[3, 2] = u[6, 0] = bad
    with pytest.raises(StepError, match=r"step 5, body 3: input .*: use finite numbers within"):
        batch.step(u)
    assert_same(before, [*everything(batch), batch.supplied, batch.dissipated])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_held_bodies_stand_still_while_the_others_go_on(rom, dtype, bad):
    batch, other = (moving(rom, 8, dtype=dtype, ledger=True) for _ in range(2))
    before = [*everything(batch), batch.supplied, batch.dissipated]
    u = np.random.default_rng(1).standard_normal((8, 5))
    u[[3, 6]] = 0
    assert other.step(u).tolist() == []
    u[[3, 6], 1] = bad
    assert batch.step(u, on_error="hold").tolist() == [3, 6]
    held = np.isin(np.arange(8), [3, 6])
    for old, now, alone in zip(
        before,
        [*everything(batch), batch.supplied, batch.dissipated],
        [*everything(other), other.supplied, other.dissipated],
        strict=True,
    ):
        np.testing.assert_array_equal(now[held], old[held])
        np.testing.assert_array_equal(now[~held], alone[~held])


@pytest.mark.parametrize(("dtype", "strength"), [(float, 1.0), (float, 1e90), (np.float32, 1.0), (np.float32, 1e15)])
def test_the_largest_inputs_stay_within_the_numbers(rom, dtype, strength):
    """What the limit promises: inputs below it lead nowhere near the largest number, however they are turned."""
    modes = {name: replace(mode, inputs=strength * mode.inputs) for name, mode in rom.contact_models.items()}
    batch = Batch(replace(rom, contact_models=modes), 3, 1e-2, dtype=dtype, ledger=True)
    batch.switch(list(modes))
    with pytest.raises(StepError) as error:
        batch.step(np.full(5, np.inf))
    limit = float(str(error.value).split("within ")[1].split(",")[0])  # to one digit
    with pytest.raises(StepError):
        batch.step(np.full(5, 2 * limit))
    for step in range(300):
        batch.step(np.full(5, limit / 2 * (-1) ** (step // 7)))
        batch.switch(np.roll(list(modes), step))
    batch.dt = 1e-6
    batch.step(np.full(5, limit / 1e4))
    assert all(np.isfinite(values).all() for values in (*batch.state(), batch.energy, batch.supplied, batch.dissipated))


def test_what_cannot_be_done_is_said_and_changes_no_bit(rom):
    batch = moving(rom, 4)
    batch.switch("mode1", 2)
    before, fine = everything(batch), np.zeros((4, 9))
    for message, attempt in (
        ("got an array of shape", lambda: batch.step(np.zeros((4, 4)))),
        ("got an array of shape", lambda: batch.step(np.zeros((3, 5)))),
        ("got an array of shape", lambda: batch.step(0.0)),
        ("did you mean 'raise'", lambda: batch.step(np.zeros(5), on_error="rise")),
        ("did you mean 'mode1'", lambda: batch.switch("mode_1")),
        ("did you mean 'mode0'", lambda: batch.switch(["mode1", "moed0"], [0, 1])),
        (r"use one name or 4 \(got 3\)", lambda: batch.switch(["mode1"] * 3)),
        ("use None, a mask", lambda: batch.switch("mode1", [0, 4])),
        ("use None, a mask", lambda: batch.switch("mode1", -1)),
        ("use None, a mask", lambda: batch.switch("mode1", [2, 2])),
        ("use None, a mask", lambda: batch.reset([True, False])),
        ("use None, a mask", lambda: batch.reset([0.5])),
        ("use None, a mask", lambda: batch.shape(4)),
        ("no output 'tup'; there is tip", lambda: batch.displacement("tup")),
        ("shape", lambda: batch.set_state(np.zeros((4, 8)), np.zeros((4, 8)))),
        ("finite", lambda: batch.set_state(fine, fine + np.nan)),
        ("finite", lambda: batch.set_state(fine + 1e200, fine)),
        ("only zeros", lambda: batch.set_state(fine, fine + 1)),
    ):
        with pytest.raises(StepError, match=message):
            attempt()
        assert_same(before, everything(batch))


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf, "1", None, 1e-300, 1e300])
def test_bad_step_size_is_refused(rom, dt):
    batch = moving(rom, 4)
    before = everything(batch)
    for attempt in (lambda: Batch(rom, 4, dt), lambda: setattr(batch, "dt", dt)):
        with pytest.raises(StepError, match="dt = "):
            attempt()
    assert batch.dt == 1e-2
    assert_same(before, everything(batch))


@pytest.mark.parametrize("choice", [{"size": 0}, {"size": 2.5}, {"dtype": np.int64}])
def test_bad_batches_are_refused(rom, choice):
    with pytest.raises(StepError, match="use "):
        Batch(rom, **{"size": 3, "dt": 1e-3} | choice)


def test_state_comes_back_as_it_was_put(rom):
    random = np.random.default_rng(3)
    batch = moving(rom, 6)
    q, r = random.standard_normal((2, 2, 9))
    q[1, 7:] = r[1, 7:] = 0
    batch.switch(["mode0", "mode2"], [4, 1])
    batch.set_state(q, r, [4, 1])
    np.testing.assert_allclose(batch.state([4, 1]), [q, r], rtol=2e-15)
    batch.switch("mode1", 0)
    batch.displacement("tip")  # moves rows
    np.testing.assert_allclose(batch.state([4, 1]), [q, r], rtol=2e-15)
    γ = np.pad(rom.contact_models["mode2"].eigenvalues, (0, 2))
    assert batch.energy[1] == pytest.approx((r[1] @ r[1] + q[1] @ (γ * q[1])) / 2, rel=1e-14)
    batch.reset()
    assert_same(everything(Batch(rom, 6, 1e-2)), everything(batch))
    batch.set_state(q[0], r[0])
    np.testing.assert_array_equal(batch.state()[1], np.tile(r[0], (6, 1)))


@pytest.mark.parametrize("copied", [copy, lambda batch: pickle.loads(pickle.dumps(batch))], ids=["copy", "pickle"])
def test_copies_go_their_own_way(rom, copied):
    batch, reference = (moving(rom, 5, ledger=True) for _ in range(2))
    other = copied(batch)
    before = everything(batch)
    for one in (other, reference):
        one.step(np.ones(5))
        one.switch("mode2", 3)
        one.dt = 2e-2
        one.step(np.ones(5))
    assert_same(before, everything(batch))
    assert_same(everything(reference), everything(other))


def test_single_precision_follows_double(plate_rom):
    """Over 1000 steps: the tip to 1e-4 of its way, and no energy that was not supplied."""
    random = np.random.default_rng(0)
    double, single = (Batch(plate_rom, 4, 1e-3, dtype=dtype, ledger=True) for dtype in (np.float64, np.float32))
    error, way, names = 0.0, 0.0, list(plate_rom.contact_models)
    for step in range(1000):
        u = random.standard_normal((4, 3))
        for batch in (double, single):
            if step % 100 == 50:
                batch.switch(names[step // 100 % 2], [0, 2])
            batch.step(u)
        exact, read = double.displacement("tip"), single.displacement("tip")
        assert read.dtype == np.float32
        error, way = max(error, np.abs(read - exact).max()), max(way, np.abs(exact).max())
        scale = np.maximum(single.dissipated, single.energy)
        assert (single.energy - single.supplied <= 1e-5 * scale).all()
    assert error <= 1e-4 * way


def test_steps_allocate_nothing_that_stays_and_no_arrays(plate_rom):
    batch = Batch(plate_rom, 500, 1e-3)
    batch.switch("middle", np.arange(0, 500, 3))
    u = np.ones((500, 3))
    batch.step(u)
    tracemalloc.start()
    try:
        for _ in range(2):  # first until Python's free lists have what they keep
            before, _ = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
            for _ in range(200):
                batch.step(u)
            after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 1000
    assert peak - before < 8 * 500  # not even one number for each body
