"""Compiled steps of bodies that deform largely by strokes of cables: NumPy's motion, forces and account."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import linear, soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.environment import NOTHING, Guide, Load
from fenics_rom.mechanics.gas import Gas
from fenics_rom.rom.deformation import ReducedTendon

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

STEPS, DT = 100, 2e-3
LAWS = "st_venant_kirchhoff", "neo_hookean"


def pulled(rom, *names):
    """With the strokes of these cables given."""
    return replace(rom, environment=replace(rom.environment, controls=dict.fromkeys(names, "length")))


def with_two_cables(rom):
    """With one along an upper edge in place of the pressure."""
    nodes, rows = rom.nodes, np.zeros((rom.nodes.size, rom.basis.shape[1]))
    rows[rom.free] = rom.basis
    edge = np.flatnonzero((nodes[:, 1] < 1e-6) & (nodes[:, 2] > 0.02 - 1e-6))
    edge = edge[nodes[edge, 0].argsort()]
    upper = ReducedTendon(nodes[edge], rows.reshape(len(nodes), 3, -1)[edge].reshape(3 * len(edge), -1))
    tendons = {"air": upper, **rom.deformation.tendons}
    return replace(rom, deformation=replace(rom.deformation, pressures={}, tendons=tendons))


def both(rom):
    """A compiled body, and one of NumPy."""
    body = fr.Simulator(rom, DT, stepper="linearly-implicit")
    assert body.integrator.kernel.is_compiled
    with numpy_alone():
        return body, fr.Simulator(rom, DT, stepper="linearly-implicit")


def history(seed, body):
    """A cable pulls by up to 6 mm, and is let go until it is slack; the tip is pushed a little: (STEPS, inputs)."""
    rng, t = np.random.default_rng(seed), DT * np.arange(STEPS)
    forces = np.zeros((STEPS, body.inputs))
    forces[:, :3] = 0.02 * rng.standard_normal(3) * np.sin(40 * t)[:, None]
    forces[:, -1] = 6e-3 * np.sin(rng.uniform(30, 45) * t)
    return forces


def assert_account_closes(body):
    account = body.ledger
    size = max(body.energy, abs(account.supplied), account.dissipated)
    assert abs(body.energy - account.supplied + account.dissipated) <= 1e-12 * size


def assert_alike(one, other):
    """The motion of 100 steps, forces, sums and notes."""
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-10 * np.abs(sums).max(), rtol=0)
    notes = [body.integrator.kernel.notes for body in (one, other)]
    for name, value in notes[0].items():
        assert value == pytest.approx(notes[1][name], rel=1e-8, abs=1e-12), name
    assert_account_closes(one)


@pytest.mark.parametrize(
    ("law", "cables"), [("st_venant_kirchhoff", 1), ("neo_hookean", 1), ("st_venant_kirchhoff", 2)]
)
def test_strokes_among_obstacles_are_those_of_numpy(law, cables, monkeypatch):
    """From the same state every eighth step on: forces of contact and cables, motion and account.

    Loops take nearly all steps of a single cable, and those in which two cables are taut.
    """
    rom = soft_rom(law, order=9, contact=True)
    rom = pulled(rom, "cable") if cables == 1 else pulled(with_two_cables(rom), "air", "cable")
    one, other = both(rom)
    t, inputs, touched, tense, refused = DT * np.arange(2 * STEPS), np.zeros((2 * STEPS, one.inputs)), 0, 0, [0]
    push, strokes = (0.1, 3e-3 * np.sin(35 * t)) if cables == 1 else (0.15, 1e-3 + 7e-4 * np.sin(35 * t))
    inputs[:, :3] = np.stack([0.05 * np.sin(50 * t), 0.05 * np.cos(20 * t), push * np.sin(30 * t) - push], axis=1)
    inputs[:, -cables:] = strokes[:, None]
    loops = one.integrator.kernel.loops
    take = loops.take

    def counted(*given):
        taken = take(*given)
        refused[0] += taken is None
        return taken

    monkeypatch.setattr(loops, "take", counted)
    for k, u in enumerate(inputs):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        pairs = [[body.contact_forces().ravel(), np.array(list(body.reactions.values()))] for body in (one, other)]
        for found, expected in zip(*pairs, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max(initial=1e-3), rtol=0)
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
        touched, tense = touched + pairs[0][0].any(), tense + (pairs[0][1] > 0).all()
    assert STEPS // 5 < touched < 2 * STEPS
    assert STEPS // 10 < tense < 2 * STEPS
    assert refused[0] <= (STEPS // 20 if cables == 1 else 2 * STEPS - tense)
    assert_account_closes(one)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-9 * np.abs(sums).max(), rtol=0)


def test_rollouts_of_strokes_among_obstacles_are_steps():
    rom = pulled(soft_rom(order=8, contact=True), "cable")
    rom = replace(rom, contact_models={"tip": rom.contact_models["tip"]})  # so that obstacles ask for no other
    body, rolled = both(rom)[0], both(rom)[0]
    t, inputs = DT * np.arange(STEPS), np.zeros((STEPS, body.inputs))
    inputs[:, 2], inputs[:, -1] = 0.1 * np.sin(30 * t) - 0.1, 3e-3 * np.sin(35 * t)
    for u in inputs:
        body.step(u)
    rolled.rollout(inputs)
    for one, same in ((body.state, rolled.state), (body.contact_forces(), rolled.contact_forces())):
        np.testing.assert_array_equal(one, same)
    assert body.reactions == rolled.reactions
    assert_account_closes(rolled)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(3))
def test_a_cable_pulls_as_in_numpy_and_is_slack(law, seed):
    rng = np.random.default_rng(seed)
    one, other = both(pulled(soft_rom(law, order=int(rng.integers(5, 15))), "cable"))
    read = []
    for u in history(seed, one):
        for body in (one, other):
            body.step(u)
        read.append([body.reactions["cable"] for body in (one, other)])
    found, expected = np.array(read).T
    np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max(), rtol=0)
    assert 0.1 * STEPS < (found == 0).sum() < 0.9 * STEPS
    assert_alike(one, other)


@pytest.mark.parametrize("contact", [False, True])
def test_two_cables_pull_and_one_of_them_or_both_are_slack(contact, monkeypatch):
    """Loops take all steps; with contact from the same state every eighth step on."""
    rom = with_two_cables(soft_rom(order=8, contact=contact))
    one, other = both(pulled(rom, "air", "cable"))

    def in_numpy(u, obstacles, parts):
        raise AssertionError

    monkeypatch.setattr(one.integrator.kernel, "_in_parts", in_numpy)
    slack, touched = [0, 0, 0], 0
    for k, u in enumerate(history(1, one)):
        u[-2:] = 2e-5 * k, 2e-5 * k + 2e-4 * np.sin(k / 9)
        if contact:
            u[:3], u[-2:] = [0.0, 0.0, -1.0 * (k % 40 > 20)], [1e-5 * k, 3e-4 * np.sin(k / 9)]
            if k % 8 == 0:
                other.restore(one.save())
        for body in (one, other):
            body.step(u)
        slack[list(one.reactions.values()).count(0.0)] += 1
        touched += contact and one.contact_forces().any()
        largest = max(other.reactions.values())
        for name, force in other.reactions.items():
            assert one.reactions[name] == pytest.approx(force, rel=1e-7, abs=max(1e-9, 1e-9 * largest)), name
    assert slack[1] > 0
    assert contact or slack[0] > 0
    assert (touched > STEPS // 10) == contact
    if not contact:
        assert_alike(one, other)
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-9 * np.abs(states[1]).max(), rtol=0)
    assert_account_closes(one)


@pytest.mark.parametrize("law", LAWS)
def test_rollouts_are_steps_and_a_restored_state_goes_on_to_the_bit(law):
    rom = pulled(soft_rom(law, order=8), "cable")
    body, rolled, restored = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(3))
    forces = history(2, body)
    rolled.rollout(forces)
    for u in forces:
        body.step(u)
    for k, u in enumerate(forces):
        restored.step(u)
        if k == 50:
            state = pickle.loads(pickle.dumps(restored.save()))
            restored.step(2 * u)
            restored.restore(state)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(rolled.state))
    assert body.reactions == rolled.reactions
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    assert_account_closes(rolled)
    again = fr.Simulator(rom, DT, stepper="linearly-implicit")
    for k, u in enumerate(forces):
        again.step(u)
        if k == 50:
            again.save()
    np.testing.assert_array_equal(np.concatenate(again.state), np.concatenate(restored.state))


@pytest.mark.parametrize(("names", "contact"), [(["air"], False), (["air", "cable"], False), (["air", "cable"], True)])
def test_volumes_are_those_of_numpy(names, contact):
    """Of a chamber that is to swell and shrink, by itself and beside a cable."""
    rom, touched = soft_rom(order=7, contact=contact), 0
    strokes = {name: "volume" if name == "air" else "length" for name in names}
    one, other = both(replace(rom, environment=replace(rom.environment, controls=strokes)))
    t, inputs, pressures = DT * np.arange(STEPS), np.zeros((STEPS, one.inputs)), []
    inputs[:, -2], inputs[:, -1] = 2e-8 * np.sin(40 * t), 1e-3 * t if "cable" in names else 0.0
    inputs[:, 2] = -2.0 * np.sin(20 * t) if contact else 0.0
    for k, u in enumerate(inputs):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        found, expected = ([*body.reactions.values()] for body in (one, other))
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * max(map(abs, expected)))
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-9 * np.abs(states[1]).max(), rtol=0)
        pressures.append(one.reactions["air"])
        touched += contact and one.contact_forces().any()
    assert min(pressures) < 0 < max(pressures)
    assert (touched > STEPS // 10) == contact
    assert_account_closes(one)


# --- guides that rub, and bodies of small strains --------------------------------------------------------------------


def rubbing(rom):
    """With a cable that winds up and down the box, and rubs where it turns."""
    nodes, rows = rom.nodes, np.zeros((rom.nodes.size, rom.basis.shape[1]))
    rows[rom.free] = rom.basis
    low, high = (np.flatnonzero((nodes[:, 1] < 1e-6) & (np.abs(nodes[:, 2] - z) < 1e-6)) for z in (0.0, 0.02))
    low, high = (edge[nodes[edge, 0].argsort()] for edge in (low, high))
    way = np.where(np.arange(len(low)) % 2, high, low)
    cable = ReducedTendon(nodes[way], rows.reshape(len(nodes), 3, -1)[way].reshape(3 * len(way), -1))
    angles = cable.angles(np.zeros(rom.basis.shape[1]))
    guides = {f"cable-guide-{k}": Guide("cable", 0.3, float(angle)) for k, angle in enumerate(angles, start=1)}
    deformation = replace(rom.deformation, tendons={"cable": cable})
    lines = [cable.up_to(k).force(np.zeros(len(rom.stiffness))) for k in range(1, len(guides) + 1)]
    models = {}
    for name, model in rom.contact_models.items():
        inputs = model.inputs.copy()
        inputs[:, -1] = cable.force(np.zeros(model.order))
        models[name] = replace(model, inputs=np.hstack([inputs, np.array(lines).T]))
    loads = {name: Load(1, NOTHING) for name in guides}
    environment = replace(rom.environment, guides=guides, loads=loads)
    changed = {"contact_models": models, "loads": dict.fromkeys(guides, 1), "deformation": deformation}
    return replace(rom, environment=environment, **changed)


def found_in_steps(part, contact):
    """A body in whose steps forces of this part are found, and inputs."""
    rom, t = soft_rom(order=8, contact=contact), DT * np.arange(STEPS)
    if "guides" in part:
        rom = rubbing(rom)
    controls = {"strokes": {"cable": "length"}, "guides": {}, "strokes at guides": {"cable": "length"}}
    both, gases = {"air": "volume" if part == "volumes" else part, "cable": "length"}, {}
    if part in GIVEN:
        gases = {"air": Gas(1e-5, 1.4) if part == "gas" else Gas(1e-5, orifice=1e-6)}
    rom = replace(rom, environment=replace(rom.environment, controls=controls.get(part, both), gases=gases))
    if contact:
        rom = replace(rom, contact_models={"tip": rom.contact_models["tip"]})  # so that obstacles ask for no other
    width = sum(rom.actuators.values())
    inputs = np.zeros((STEPS, next(iter(rom.contacts.values())) + width))
    inputs[:, 2] = 0.05 * np.sin(30 * t) - (2.0 if part in ("volumes", *GIVEN) else 0.1) * contact
    inputs[:, -1] = 1.0 + np.sin(45 * t) if part == "guides" else 2e-3 * np.sin(35 * t)
    inputs[:, -2] = {"volumes": 2e-8, **GIVEN}.get(part, 0.0) * np.sin(40 * t)
    return rom, inputs


GIVEN = {"gas": 3e-6, "valve": 3e4}  # blown in, m³, and the supply's pressure, Pa
PARTS = ("strokes", "guides", "strokes at guides", "volumes", *GIVEN)


@pytest.mark.parametrize("contact", [False, True])
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("strains", ["small", "large"])
def test_forces_found_in_steps_are_those_of_numpy(strains, part, contact, monkeypatch):
    """From the same state every eighth step on; rollouts and bodies of batches are single steps, to the bit."""
    rom, inputs = found_in_steps(part, contact)
    rom, given = (linear(rom), {}) if strains == "small" else (rom, {"stepper": "linearly-implicit"})
    one, alone, rolled = (fr.Simulator(rom, DT, **given) for _ in range(3))
    many = fr.Batch(rom, 2, DT, ledger=True)
    with numpy_alone():
        other = fr.Simulator(rom, DT, **given)
    assert one.integrator.kernel.is_compiled
    assert many.stepping == "compiled"
    touched, largest, moved, forces = 0, 0.0, 0.0, []
    for k, u in enumerate(inputs):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other, alone):
            body.step(u)
        many.step(np.tile(u, (2, 1)))
        found, expected = (body.integrator.reactions for body in (one, other))
        largest = max(largest, np.abs(expected).max())
        forces.append(np.abs(found - expected).max())
        states = [np.concatenate(body.state) for body in (one, other)]
        moved = max(moved, np.abs(states[1]).max())
        np.testing.assert_allclose(*states, atol=1e-9 * moved, rtol=0)
        touched += contact and one.contact_forces().any()
    assert max(forces) <= 1e-8 * largest
    assert (touched > STEPS // 10) == contact
    assert_account_closes(one)
    steps, singly = [], rolled.step
    monkeypatch.setattr(rolled, "step", lambda u: steps.append(singly(u)))
    ends = rolled.rollout(inputs, every=STEPS)
    assert len(steps) <= contact + (strains == "large")  # before looks at a skin begin, and the last of large strains
    for name, points in ends.items():
        np.testing.assert_allclose(points[-1], alone.displacement(name), atol=1e-12 * moved, rtol=0)
    for body in (rolled.state, [each[1] for each in many.state()]):
        np.testing.assert_array_equal(np.concatenate(body), np.concatenate(alone.state))
    assert rolled.reactions == alone.reactions
    assert {name: each[1] for name, each in many.reactions.items()} == alone.reactions
    np.testing.assert_allclose(many.supplied[0], alone.ledger.supplied, rtol=1e-10)
    assert rolled.ledger.supplied == pytest.approx(alone.ledger.supplied, rel=1e-10)
    np.testing.assert_allclose(many.dissipated[0], alone.ledger.dissipated, rtol=1e-10)
    assert rolled.gas == alone.gas
    assert many.energy.tolist() == pytest.approx([alone.energy] * 2, rel=1e-12)
    if part in GIVEN:
        assert abs(alone.gas["air"]) > 1e-7
        assert_account_closes(rolled)
        gas_is_told_and_begins_anew(many, alone)


def gas_is_told_and_begins_anew(many, single):
    """A step that is refused says why and changes nothing; a body that is reset has the gas it began with."""
    many.reset([0])
    assert many.energy[0] == 0.0
    single.reset()
    assert single.gas == {"air": 0.0}
    lacking = np.zeros((2, many.inputs))
    lacking[0, -2] = -2e-5
    if single.environment.environment.controls["air"] == "gas":
        before = many.energy.tolist()
        for step, where in (many.step, "step 100, body 0: "), (lambda u: single.step(u[0]), ""):
            with pytest.raises(StepError, match=rf"^{where}t = 0 s: chamber 'air': -2e-05 m³ of gas are"):
                step(lacking)
        assert many.energy.tolist() == before
        assert many.step(lacking, on_error="hold").tolist() == [0]
        with pytest.raises(StepError, match=r"t = 0\.002 s: chamber 'air'"):
            single.rollout(np.stack([0 * lacking[0], lacking[0]]))
