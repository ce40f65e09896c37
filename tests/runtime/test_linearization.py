"""State spaces of bodies that are not linear: the derivative of the simulator's step about a state."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, box_arrays, scene_text, write_arrays
from products import DAMPING, FLOOR, INERTIA, kinds
from step_differences import differ_steps

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, StepError, StructureError
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime import linearization
from fenics_rom.scene.file import parse_scene

DT = 1e-3
EXACT = 1e-12  # relative
LINEAR_NEARBY = 1e-5  # differences of steps, of the first order, on both sides: their round-off and curvature
AT_REST = 5e-3  # differences of steps from states of pairs that hardly slip, which a lean makes slip otherwise
TURNED = 1e-3  # outputs of a free body are of the attitude before the step
KINDS = kinds()


def some_way_on(rom, steps=60):
    """A body under way, and what it is under."""
    body = fr.Simulator(rom, DT)
    u = np.zeros(body.inputs)
    u[-1] = 2e-4 if rom.environment.controls else 0.05
    if "rope" in rom.actuators:
        u[:3] = [1e-3, 2e-3, -3e-3]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(steps):
            body.step(u)
    return body, u


def stepped(body, start, u, contact):
    """What outputs show after a step under u."""
    body.restore(start)
    body.switch(contact)
    body.step(u)
    return np.concatenate([body.displacement(name).ravel() for name in body.rom.outputs])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ("held", "still")], ids="-".join)
def test_a_step_under_other_inputs_is_as_the_state_space_says(rom_of, kind):
    rom = rom_of(kind)
    body, u = some_way_on(rom)
    start, contact = body.save(), body.contact
    plant = rom.state_space(contact, dt=DT, at=start, u=u)
    A, B, C, _ = plant
    assert (len(plant.states), len(plant.outputs)) == (len(A), len(C))
    after, near = plant.about.after, TURNED if kind[0] == "free" else LINEAR_NEARBY
    shown = stepped(body, start, u, contact)
    assert np.abs(plant.about.output + C @ (after - plant.about.state) - shown).max() <= 1e-6 * np.abs(shown).max()
    for k, name in enumerate(list(plant.inputs)[: body.inputs]):
        push = np.linalg.norm(body.model.inputs[:, k])
        reach = 1e-6 if "rope" in name and rom.environment.controls else 1e-6 / (DT * push)
        moved = np.zeros(body.inputs)
        moved[k] = reach
        differs = (stepped(body, start, u + moved, contact) - stepped(body, start, u - moved, contact)) / (2 * reach)
        assert np.abs(C @ B[:, k] - differs).max() <= near * np.abs(differs).max() + 1e-16 / reach


@pytest.mark.parametrize(
    "kind",
    [("held", "large"), ("held", "stroke"), ("held", "rubbing"), ("carried", "plain"), ("free", "plain")],
    ids="-".join,
)
def test_a_step_from_another_state_is_as_the_state_space_says(rom_of, kind):
    rom = rom_of(kind)
    body, u = some_way_on(rom)
    plant, (q, r) = rom.state_space(body.contact, dt=DT, at=body, u=u), body.state
    A, _, C, _ = plant
    start, m = body.save(), len(q)
    ω, random = np.sqrt(body.model.eigenvalues), np.random.default_rng(0)
    for _ in range(3):
        x = np.zeros(len(A))
        x[: 2 * m] = 1e-6 * random.standard_normal(2 * m)
        shown = []
        for side in (1, -1):
            body.restore(start)
            body.state = q + side * x[:m] / ω, r + side * x[m : 2 * m]
            body.step(u)
            shown.append(body.displacement("tip").ravel())
        differs = (shown[0] - shown[1]) / 2
        assert (
            np.abs(C @ A @ x - differs).max()
            <= (TURNED if kind[0] == "free" else LINEAR_NEARBY) * np.abs(differs).max()
        )


def by_differences(patched):
    """Has derivatives be those of steps from states nearby, whatever kernels tell."""
    patched.setattr(linearization, "differentiate_step", differ_steps)


@pytest.mark.parametrize(
    "kind",
    [
        ("held", "contact"),
        ("held", "springs"),
        ("held", "bare"),
        ("held", "stroke"),
        ("held", "large"),
        ("carried", "plain"),
        ("carried", "touching"),
        ("free", "plain"),
        ("free", "touching"),
    ],
    ids="-".join,
)
def test_adjoints_and_differences_of_steps_agree(rom_of, kind, monkeypatch):
    """With pairs that rest on the floor, and those that a spring pushes."""
    rom = rom_of(kind)
    body, u = some_way_on(rom)
    exact = rom.state_space(body.contact, dt=DT, at=body, u=u)
    by_differences(monkeypatch)
    found = rom.state_space(body.contact, dt=DT, at=body, u=u)
    near = AT_REST if kind in (("held", "contact"), ("held", "bare")) or "touching" in kind else 1e-6
    for one, other in zip(exact, found, strict=True):
        assert np.abs(one - other).max(initial=0.0) <= near * np.abs(one).max(initial=0.0)
    if kind == ("held", "contact"):
        assert "g[" in "".join(exact.states)
        assert np.abs(np.linalg.eigvals(exact.A)).max() <= 1 + 1e-9


@pytest.mark.parametrize("order", [6, 92])
def test_where_nothing_acts_in_a_run_the_state_space_is_that_of_the_linear_body(tmp_path, order):
    """Of a ROM with obstacles that a simulator leaves out, which takes steps of either kernel; and it may drift."""
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 2, 2)))
    text = scene_text(
        mesh, supports=None, effects=INERTIA + DAMPING + FLOOR, **{"outputs.tip": "points = [[0.3, 0, 0]]"}
    )
    rom = fr.reduce(fr.assemble(parse_scene(text)), order=order)
    alone = replace(rom.environment, contact_law=None)
    body, u = fr.Simulator(rom, DT, scene=alone), np.array([1e-3, 2e-3, -3e-3])
    for _ in range(5):
        body.step(u)
    plant, linear = rom.state_space(body.contact, at=body, u=u), replace(rom, environment=alone)
    for found, expected in zip(plant, linear.state_space(body.contact, dt=DT), strict=True):
        assert found.shape == expected.shape
        assert np.abs(found - expected).max(initial=0.0) <= EXACT * np.abs(expected).max(initial=0.0)


def test_equilibria_on_a_floor_have_derivatives_and_kinks(rom_of, monkeypatch):
    """Of a beam that falls on it in one step; and where it rests, as some points there hardly press."""
    rom = rom_of(("held", "still"))
    body = fr.Simulator(rom, DT)
    exact = rom.state_space("right", at=body)
    assert "g[" in "".join(exact.states)
    with monkeypatch.context() as patched:
        by_differences(patched)
        found = rom.state_space("right", at=body)
    for one, other in zip(exact, found, strict=True):
        assert np.abs(one - other).max(initial=0.0) <= 1e-6 * np.abs(one).max(initial=0.0)
    body, u = some_way_on(rom)
    with pytest.warns(FenicsRomWarning, match="the state is at a kink, where a contact point may go either way"):
        rom.state_space(body.contact, at=body, u=u)


def test_contact_that_lasts_goes_on_as_it_says(rom_of):
    """Pushes for ten steps of a beam on a floor, with and without the model of the first."""
    rom = rom_of(("held", "contact"))
    body, u = some_way_on(rom, 600)
    start, plant = body.save(), rom.state_space(body.contact, dt=DT, at=body, u=u)
    pushes = 1e-4 * np.random.default_rng(0).standard_normal((10, body.inputs))
    x, runs = np.zeros(len(plant.A)), []
    for push in pushes:
        x = plant.A @ x + plant.B @ np.array([*push, 0.0])
    for share in (1.0, 0.0):
        body.restore(start)
        for push in pushes:
            body.step(u + share * push)
        runs.append(body.displacement("tip").ravel())
    assert np.abs(plant.C @ x - (runs[0] - runs[1])).max() <= 0.02 * np.abs(runs[0] - runs[1]).max()


def test_without_a_state_it_is_rest_at_the_start_and_that_is_told(rom_of):
    for kind, words in (
        (("held", "contact"), "contact is open"),
        (("held", "large"), "stiffness is that of the shape at rest; contact is open"),
        (("held", "stroke"), "cables are taut"),
        (("carried", "plain"), "the base is where it begins"),
        (("free", "plain"), "the frame does not turn"),
    ):
        rom = rom_of(kind)
        contact = next(iter(rom.contact_models))
        with pytest.warns(FenicsRomWarning, match=f"about the body at rest at the start, where .*{words}"):
            plant = rom.state_space(contact, dt=DT)
        if kind in (("held", "contact"), ("carried", "plain")):  # where it is that of small motions without all that
            linear = replace(rom, environment=replace(rom.environment, contact_law=None, frame="fixed"))
            for found, expected in zip(plant, linear.state_space(contact, dt=DT), strict=True):
                assert np.abs(found - expected).max(initial=0.0) <= 1e-9 * np.abs(expected).max(initial=0.0)
        with pytest.raises(StructureError, match="which no map carries"):
            rom.switch_map(contact, contact)
        with pytest.raises(StepError, match="dt is missing"):
            rom.state_space(contact)
        assert rom.state_space(contact, at=fr.Simulator(rom, 2e-3)).dt == 2e-3


def test_states_are_simulators_what_they_save_and_runs(box_file):
    effects = "inertia = {}\ndamping = { alpha = 0.5, beta = 1e-3 }\ncontact.switching = 'scene'\n"
    floor = 'contact.obstacles.floor = { shape = "half-space", point = [0, 0, -1e-3], normal = [0, 0, 1] }\n'
    run = {"run": 'dt = 1e-3\nduration = 0.02\n[[run.load]]\ncontact = "top"\nforce = [0.0, 0.0, -0.5]'}
    scene = acted_on(box_file, effects + floor, **run)
    rom = fr.reduce(fr.assemble(scene), order=6)
    body = fr.Simulator(rom, DT)
    body.switch("top")
    for _ in range(20):
        body.step([0.0, 0.0, -0.5])
    u = [0.0, 0.0, -0.5]
    plants = [rom.state_space("top", at=at, u=u) for at in (body, body.save(), fr.simulate(rom))]
    plants.append(rom.state_space("top", at=fr.simulate(rom)))  # under what acts at its end
    for plant in plants[1:]:
        for found, expected in zip((*plant, *plant.about), (*plants[0], *plants[0].about), strict=True):
            assert np.abs(found - expected).max(initial=0.0) <= 1e-8 * np.abs(expected).max(initial=0.0)
    for message, choice in (
        ("use a Simulator, what its", {"at": "rest"}),
        ("u: use 3 finite numbers", {"at": body, "u": [1.0]}),
        ("of another ROM", {"at": fr.Simulator(fr.truncate(rom, 4), DT)}),
        ("of another ROM", {"at": fr.Simulator(fr.truncate(rom, 4), DT).save()}),
    ):
        with pytest.raises(StepError, match=message):
            rom.state_space("top", **choice)


def relaxing(rom):
    """The same of a material that relaxes; the first branch is slower than steps, the second one faster."""
    series = PronySeries((0.5, 0.2), (0.05, 2e-4))
    return replace(rom, environment=replace(rom.environment, viscoelasticity=series))


def test_a_material_that_relaxes_is_linear(plate_rom):
    rom = relaxing(plate_rom)
    plants = {name: rom.state_space(name, ["tip"], DT) for name in rom.contact_models}
    body, random, x = fr.Simulator(rom, DT), np.random.default_rng(0), np.zeros(80)
    for step in range(200):
        if step in (70, 140):
            there = "middle" if step == 70 else "tip_left"
            x = rom.switch_map(body.contact, there) @ x
            body.switch(there)
        u = random.standard_normal(3)
        body.step(u)
        x = plants[body.contact].A @ x + plants[body.contact].B @ u
        shown = body.displacement("tip").ravel()
        assert np.abs(plants[body.contact].C @ x - shown).max() <= EXACT * np.abs(shown).max() + 1e-18
    slow = replace(plate_rom, environment=replace(plate_rom.environment, viscoelasticity=PronySeries((0.5,), (0.05,))))
    continuous, discrete = slow.state_space("middle"), slow.state_space("middle", dt=DT)
    half, unit = DT / 2 * continuous.A, np.eye(len(continuous.A))  # of branches slower than steps
    expected = np.linalg.solve(unit - half, np.hstack([unit + half, DT * continuous.B]))
    assert np.abs(np.hstack([discrete.A, discrete.B]) - expected).max() <= EXACT * np.abs(expected).max()
    modulus, s = slow.environment.viscoelasticity.modulus(20.0), 20j
    model, (A, B, C, D) = slow.contact_models["middle"], continuous
    damping = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
    q = np.linalg.solve(s**2 * np.eye(model.order) + s * damping + modulus * np.diag(model.eigenvalues), model.inputs)
    expected = slow.outputs["tip"] @ model.coordinates @ q
    assert np.abs(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D - expected).max() <= EXACT * np.abs(expected).max()


def test_without_inertia_shapes_follow_forces(plate_rom):
    rom = replace(plate_rom, environment=replace(plate_rom.environment, has_inertia=False))
    continuous, discrete, body = rom.state_space("middle"), rom.state_space("middle", dt=DT), fr.Simulator(rom, DT)
    body.switch("middle")
    body.step([0.1, -0.2, 0.3])
    shown = body.displacement("tip").ravel()
    for found in (continuous.D @ [0.1, -0.2, 0.3], discrete.C @ discrete.B @ [0.1, -0.2, 0.3]):
        assert np.abs(found - shown).max() <= EXACT * np.abs(shown).max()
    assert len(continuous.states) == 0
    assert not discrete.A.any()
    assert rom.switch_map("middle", "tip_left").shape == (20, 20)
