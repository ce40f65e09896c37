"""Whatever a simulator takes, rollouts and batches take: the same to the bit where bodies are stepped one by one."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from products import kinds

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import StepError

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DT, STEPS = 1e-3, 50
KINDS = kinds()
JOINT = [("held", "contact"), ("carried", "plain")]
SEPARATE = [kind for kind in KINDS if kind not in JOINT]


@pytest.fixture(autouse=True)
def in_numpy():
    """What is compiled has tests of its own."""
    with numpy_alone():
        yield


def inputs(rom, seed=0, steps=STEPS):
    """Of each step, (steps, p): pushes of some mN, what is pulled 0.1 N, strokes 0.1 mm."""
    random = np.random.default_rng(seed)
    width = max(rom.contacts.values()) + sum(rom.actuators.values())
    u = 5e-3 * random.standard_normal((steps, width))
    u[:, max(rom.contacts.values()) :] = 1e-4 if rom.environment.controls else 0.1 * random.random()
    return u


def numbers(body):
    """All that is there of a body, to the bit."""
    saved = body.save()
    frame = () if body.pose is None else body.pose
    parts = [saved.stepper.state, saved.stepper.auxiliary, saved.stepper.reactions, *frame]
    return [*(part.tolist() for part in parts), saved.sums, body.contact, body.time]


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_a_rollout_takes_what_step_takes(rom_of, kind):
    rom = rom_of(kind)
    body, stepped, u = fr.Simulator(rom, DT), fr.Simulator(rom, DT), inputs(rom)
    read = {name: [] for name in rom.outputs}
    for count, row in enumerate(u, start=1):
        stepped.step(row)
        for name, shown in read.items():
            if count % 7 == 0:
                shown.append(stepped.displacement(name))
    found = body.rollout(u[:20], every=7), body.rollout(u[20:], every=1)
    assert body.steps == stepped.steps == STEPS
    if kind in (("held", "contact"), ("held", "bare")):  # by blocks
        np.testing.assert_allclose(body.displacement(), stepped.displacement(), atol=1e-12)
        return
    for name, shown in read.items():
        np.testing.assert_array_equal(found[0][name], shown[:2])
    assert len(found[1]["tip"]) == 30
    stepped = fr.Simulator(rom, DT)
    for row in u[:20]:
        stepped.step(row)
    stepped.save()
    for row in u[20:]:
        stepped.step(row)
    assert numbers(body) == numbers(stepped)


def test_rollouts_take_inputs_by_name_actuators_alone_and_bases(rom_of):
    rom = rom_of(("carried", "plain"))
    u, pull = np.zeros((20, 4)), np.linspace(0.0, 0.1, 20)
    u[:, 3] = pull
    bases = [
        fr.BaseState(np.array([0, 0, 1e-4 * k]), np.eye(4)[0], np.array([0, 0, 0.1]), np.zeros(3)) for k in range(20)
    ]
    bodies = [fr.Simulator(rom, DT) for _ in range(4)]
    for row, base in zip(u, bases, strict=True):
        bodies[0].step(row, base=base)
    bodies[1].rollout(u, base=bases)
    bodies[2].rollout(pull[:, None], base=bases)
    bodies[3].rollout({"rope": pull}, base=bases)
    for body in bodies[1:]:
        assert numbers(body) == numbers(bodies[0])
    before = numbers(bodies[0])
    for message, attempt in (
        (r"one for each of 20 steps \(got 3\)", lambda: bodies[0].rollout(u, base=bases[:3])),
        ("no input 'rop'", lambda: bodies[0].rollout({"rop": pull})),
        (r"inputs of 'rope': use \(steps, 1\)", lambda: bodies[0].rollout({"rope": np.zeros((3, 2))})),
        ("use a body in a moving frame", lambda: fr.Simulator(rom_of(("free", "plain")), DT).rollout(u, base=bases)),
        ("unit quaternion", lambda: bodies[0].rollout(u, base=[*bases[:19], bases[0]._replace(rotation=np.ones(4))])),
    ):
        with pytest.raises(StepError, match=message):
            attempt()
        assert numbers(bodies[0]) == before


@pytest.mark.parametrize("kind", SEPARATE, ids="-".join)
def test_a_batch_is_simulators_to_the_bit(rom_of, kind):
    """Through steps, inputs that are refused, what is read, copies, and a body that begins anew."""
    rom = rom_of(kind)
    bodies, singles = fr.Batch(rom, 3, DT, ledger=True), [fr.Simulator(rom, DT) for _ in range(3)]
    assert bodies.stepping.startswith("one after another, as of ")
    assert bodies.stepping in repr(bodies)
    u = np.stack([inputs(rom, seed) for seed in range(3)], axis=1)
    u[5, 1, 0] = np.nan
    for step, row in enumerate(u):
        before = bodies.state()[0]
        if step == 5:
            with pytest.raises(StepError, match="step 5, body 1: input"):
                bodies.step(row)
            np.testing.assert_array_equal(bodies.state()[0], before)
        assert bodies.step(row, on_error="hold").tolist() == ([1] if step == 5 else [])
        for k, single in enumerate(singles):
            if (step, k) != (5, 1):
                single.step(row[k])
        if step == 20:
            bodies.reset([2])
            singles[2].reset()
    for k, single in enumerate(singles):
        q, r = single.state
        np.testing.assert_array_equal([part[k, : len(q)] for part in bodies.state()], [q, r])
        np.testing.assert_array_equal(bodies.displacement("tip")[k], single.displacement("tip"))
        np.testing.assert_array_equal(bodies.velocity("tip")[k], single.velocity("tip"))
        np.testing.assert_array_equal(bodies.shape(k), single.displacement())
        account = single.ledger
        sums = account.supplied, account.dissipated, account.lost_in_switching, account.numerical, account.obstacles
        read = (getattr(bodies, name)[k] for name in ("supplied", "dissipated", "lost_in_switching", "numerical"))
        assert (*read, bodies.supplied_by_obstacles[k]) == sums
        assert bodies.dissipated_in_contact[k] == account.contact + account.friction
        assert (bodies.energy[k], bodies.time[k], bodies.contact[k]) == (single.energy, single.time, single.contact)
        assert {name: force[k] for name, force in bodies.reactions.items()} == single.reactions
        if rom.environment.contact_law is not None:
            np.testing.assert_array_equal(
                bodies.contact_force("ball" if kind[1] == "bare" else "floor")[k], single.obstacle_forces()[0]
            )
            np.testing.assert_array_equal(bodies.point_forces[k], single.contact_forces())
        if single.pose is not None:
            np.testing.assert_array_equal(
                np.concatenate([part[k] for part in bodies.base]), np.concatenate(single.pose)
            )
            assert single.base_wrench is None or (bodies.base_wrench[0][k] == single.base_wrench[0]).all()
    if kind[1] in ("contact", "still", "relaxing", "touching"):
        assert bodies.point_forces.any()
    twins = [copy.copy(bodies), pickle.loads(pickle.dumps(bodies))]
    for row in u[6:16]:
        for batch in (bodies, *twins):
            batch.step(row)
    for twin in twins:
        np.testing.assert_array_equal(twin.state()[0], bodies.state()[0])
        np.testing.assert_array_equal(twin.supplied, bodies.supplied)


def test_bases_are_given_to_the_bit(rom_of):
    rom = rom_of(("carried", "touching"))
    bodies, single = fr.Batch(rom, 2, DT), fr.Simulator(rom, DT)
    for k in range(20):
        half = 2e-4 * k
        rotation = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        base = fr.BaseState(np.array([0, 0, 1e-5 * k]), rotation, np.array([0, 0, 0.01]), np.array([0, 0.4, 0]))
        bodies.step(np.zeros(bodies.inputs), base=base)
        single.step(np.zeros(single.inputs), base=base)
    np.testing.assert_array_equal(bodies.state()[0][1], single.state[0])
    base = base._replace(position=np.array([0, 0, 0.05]))  # off the floor
    many = fr.BaseState(*(np.tile(part, (2, 1)) for part in base))
    bodies.place(many)
    single.place(base)
    np.testing.assert_array_equal(bodies.displacement("tip")[1], single.displacement("tip"))


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_single_precision_is_of_what_is_read(rom_of, kind):
    bodies, double = fr.Batch(rom_of(kind), 2, DT, dtype=np.float32), fr.Batch(rom_of(kind), 2, DT)
    for row in inputs(rom_of(kind))[:10]:
        bodies.step(row)
        double.step(row)
    assert bodies.displacement("tip").dtype == bodies.velocity("tip").dtype == np.float32
    np.testing.assert_array_equal(bodies.state()[0], double.state()[0])
    np.testing.assert_array_equal(bodies.displacement("tip"), double.displacement("tip").astype(np.float32))


def test_one_bodys_error_leaves_the_others_as_they_were(rom_of, monkeypatch):
    """Steps that were taken before the error are taken back, also those that began with a switch of contact modes."""

    def refuse(*_, **__):
        raise StepError("no forces")

    for kind in (("held", "bare"), ("free", "touching"), ("held", "rubbing")):
        bodies = fr.Batch(rom_of(kind), 3, DT, ledger=True)
        twin = fr.Batch(rom_of(kind), 3, DT, ledger=True)
        u = inputs(rom_of(kind))
        for row in u[:30]:
            bodies.step(row)
            twin.step(row)
        with monkeypatch.context() as patched:
            patched.setattr(bodies._bodies.bodies[2], "step", refuse)
            with pytest.raises(StepError, match="step 30, body 2: no forces; all bodies were left as they were"):
                bodies.step(u[30])
            assert twin.steps == bodies.steps
        for row in u[30:]:
            bodies.step(row)
            twin.step(row)
        np.testing.assert_allclose(bodies.state(), twin.state(), rtol=0, atol=1e-12 * np.abs(twin.state()).max())
        np.testing.assert_allclose(bodies.supplied, twin.supplied, rtol=1e-9)
        assert (bodies.steps, bodies.time.tolist()) == (twin.steps, twin.time.tolist())
        u[0, 0] = np.inf
        assert bodies.step([u[1], u[1], u[0]], on_error="reset").tolist() == [2]
        assert bodies.time[2] == 0


def test_friction_and_places_of_obstacles_are_of_each_body(rom_of):
    rom = rom_of(("held", "bare"))
    law = rom.environment.contact_law
    oiled = replace(rom, environment=replace(rom.environment, contact_law=replace(law, friction=0.1)))
    bodies, singles = fr.Batch(rom, 3, DT), [fr.Simulator(rom, DT), fr.Simulator(oiled, DT), fr.Simulator(rom, DT)]
    bodies.friction = [0.4, 0.1, 0.4]
    bodies.place_obstacle("ball", [0.0, 0.0, 2e-4], [2])
    singles[2].set_signal("ball", [0.0, 0.0, 2e-4])
    for row in inputs(rom):
        bodies.step(row)
        for single in singles:
            single.step(row)
    for k, single in enumerate(singles):
        np.testing.assert_array_equal(bodies.state()[0][k], single.state[0])
    forces = bodies.contact_force("ball")
    assert len({tuple(force) for force in forces}) == 3
    assert (
        copy.copy(bodies).friction.tolist() == pickle.loads(pickle.dumps(bodies)).friction.tolist() == [0.4, 0.1, 0.4]
    )
    assert not bodies.inexact.any()
    assert bodies.through_skin.shape == (3,)


def test_bodies_inside_obstacles_stand_still(rom_of):
    for kind in (("held", "bare"), ("held", "relaxing"), ("free", "touching")):
        bodies = fr.Batch(rom_of(kind), 3, DT)
        name = "ball" if kind[1] == "bare" else "floor"
        bodies.place_obstacle(name, [0.0, 0.0, 1e-2], [1])
        before = bodies.state()[0]
        with pytest.raises(StepError, match=r"body 1: .*; all bodies were left as they were"):
            bodies.reset()
        np.testing.assert_array_equal(bodies.state()[0], before)
        bodies.reset(on_error="hold")
        assert bodies.frozen.tolist() == [False, True, False]
        assert bodies.step(np.zeros(bodies.inputs)).tolist() == [1]
        assert bodies.time.tolist() == [DT, 0.0, DT]
        bodies.place_obstacle(name, [0.0, 0.0, 0.0], [1])
        bodies.reset([1])
        assert not len(bodies.step(np.zeros(bodies.inputs)))


def test_a_strained_body_that_a_base_carries_switches_in_a_batch_too(rom_of):
    """Its bodies are stepped together until then, and one after another from there on."""
    rom = rom_of(("carried", "plain"))
    bodies, singles = fr.Batch(rom, 2, DT, ledger=True), [fr.Simulator(rom, DT) for _ in range(2)]
    u, second = inputs(rom), list(rom.contact_models)[1]
    for step, row in enumerate(u):
        if step == 20:
            assert bodies.stepping == "together"
            bodies.switch(second, [1])
            singles[1].switch(second)
            assert bodies.stepping.startswith("one after another")
        bodies.step(row)
        for single in singles:
            single.step(row)
    for k, single in enumerate(singles):
        np.testing.assert_allclose(bodies.shape(k), single.displacement(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(bodies.base_wrench[0][k], single.base_wrench[0], rtol=1e-9)
        assert bodies.energy[k] == pytest.approx(single.energy, rel=1e-10)
        assert bodies.supplied[k] == pytest.approx(single.ledger.supplied, rel=1e-10)
        assert bodies.time[k] == pytest.approx(single.time, rel=1e-12)
