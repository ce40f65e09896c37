"""Gradients through switches of bodies in moving frames to contact modes of other shapes, with modes of the state."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import test_differentiation_parts as bent
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import AGREES, squares
from soft_rom import soft_rom
from test_differentiation_frames import BALL, LAWS, LOADS, STILL, TIED, H, along, lowered, reduced, swung
from test_moving_parts import KINDS, in_frame

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.runtime.differentiation import taken_steps
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
FRAMES = {"free": (None, None), "carried": ('clamped = ["left"]', swung)}
RELAXES = {"effects.viscoelasticity": "ratios = [0.5]\ntimes = [0.02]"}
PARTS = {"plain": {}, "tied": TIED, "relaxing": RELAXES, "tied, relaxing": TIED | RELAXES}


def of_scene(parts):
    """Contact modes that obstacles do not ask for."""
    return parts | {"effects.contact": 'switching = "scene"\n' + parts.get("effects.contact", "")}


def check_switches(at, u, start, directions, ε=1e-4, every=3):
    """The gradient where contact modes come by turns, along directions of inputs, start and pose; the body then."""
    first, names = at(*start).contact, list(at(*start).rom.contact_models)
    names = names[names.index(first) :] + names[: names.index(first)]
    contact = [names[k // every % len(names)] for k in range(len(u))]

    def run(ε, directions):
        inputs, *begin = (part + ε * δ for part, δ in zip((u, *start), directions, strict=True))
        body, read, energies = at(*begin), [], []
        for row, name in zip(inputs, contact, strict=True):
            body.switch(name)
            body.step(row)
            read.append(body.displacement("tip"))
            energies.append(body.energy)
        return squares({"tip": np.array(read)}, np.array(energies))[0], body

    def difference_along(one, ε):
        return (run(ε, one)[0] - run(-ε, one)[0]) / (2 * ε)

    gradient, (value, body) = fr.differentiate(at(*start), u, squares, contact=contact), run(0.0, directions)
    assert gradient.kinks == ()
    assert gradient.value == pytest.approx(value, rel=1e-12)
    slopes = (gradient.inputs, *gradient.state, *gradient.pose.values())[: len(directions)]
    owed = [(slope * δ).sum() for slope, δ in zip(slopes, directions, strict=True)]
    for place, slope in enumerate(owed):
        one = [δ * (number == place) for number, δ in enumerate(directions)]
        allowed = {"rel": AGREES, "abs": AGREES * max(map(abs, owed))}
        difference = difference_along(one, ε)
        if slope != pytest.approx(difference, **allowed):  # ties make a run so curved that it is off by 2e-5
            difference = (4 * difference_along(one, ε / 2) - difference) / 3
        assert slope == pytest.approx(difference, **allowed)
    return body, gradient


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("parts", PARTS)
def test_gradient_goes_through_switches_to_other_shapes(tmp_path, parts, frame):
    """Each makes modes of shape, rate and strains of branches, of which γ and D are no contact mode's."""
    supports, base = FRAMES[frame]
    rom = reduced(tmp_path, supports, **PARTS[parts])
    body, gradient = check_switches(*along(rom, base, steps=12))
    assert body.model.order > rom.contact_models[body.contact].order - rom.rigid
    assert not gradient.eigenvalues
    assert not gradient.damping


@pytest.mark.parametrize("frame", FRAMES)
def test_gradient_goes_through_switches_to_the_same_shapes(tmp_path, frame):
    supports, base = FRAMES[frame]
    rom = reduced(tmp_path, supports, method="modal", **RELAXES)
    body, gradient = check_switches(*along(rom, base, steps=12))
    assert body.model.order == rom.contact_models[body.contact].order - rom.rigid
    assert gradient.eigenvalues.keys() == rom.contact_models.keys()


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("law", LAWS)
def test_gradient_goes_through_switches_of_what_touches(tmp_path, law, frame):
    """Sticking, sliding and bouncing; what contact points yield beyond the basis goes on."""
    supports, (effects, obstacle) = FRAMES[frame][0], LAWS[law]
    rom = reduced(tmp_path, supports, **of_scene({"effects.contact.obstacles.floor": obstacle} | effects))
    body, _ = check_switches(*along(rom, supports and lowered, size=0.02, steps=14))
    assert body.contact_forces().any() or law == "bounces"


@pytest.mark.parametrize("parts", STILL)
def test_gradient_goes_through_switches_of_equilibria(tmp_path, parts):
    effects = STILL[parts] if parts == "tied" else of_scene(STILL[parts])
    rom = reduced(tmp_path, 'clamped = ["left"]', effects=None, **effects)
    check_switches(*along(rom, lowered, size=0.02, steps=14))


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("parts", ["guides", "stroke at guides", "volume", "gas"])
def test_gradient_goes_through_switches_with_forces_that_are_found(tmp_path, parts, frame):
    if frame == "free" and parts in ("volume", "gas"):
        pytest.skip("a chamber needs a body that encloses it")
    rom, signals = bent.small(tmp_path, parts, frame), {"base_path": lowered} if frame == "carried" else {}
    check_switches(*bent.along(lambda: fr.Simulator(rom, H, signals=signals), frame, bent.AMPLITUDE[parts], 1.0))


@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("kind", KINDS)
def test_gradient_goes_through_switches_of_a_body_that_bends_far(kind, stepper):
    """Whose contact modes have the same shapes."""
    rom = in_frame(KINDS[kind](soft_rom("neo_hookean", order=8, contact=True)))
    points = {name: np.tile(rom.nodes[-1], (len(rows) // 3, 1)) for name, rows in rom.outputs.items()}
    scene = replace(rom.environment, contact_switching="scene")
    rom = replace(rom, environment=scene, moving_frame=replace(rom.moving_frame, output_points=points))

    def make():
        return fr.Simulator(rom, H, stepper=stepper, signals={"base_path": lowered})

    check_switches(*bent.along(make, "carried", 2e-3 if kind == "stroke" else 0.5, 1.0))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("frame", FRAMES)
def test_gradient_goes_through_switches_of_random_bodies(tmp_path, frame, seed):
    """Boxes, three contact modes of several orders, and damping that is no sum of α and β γ."""
    random, (supports, base) = np.random.default_rng(seed), FRAMES[frame]
    sizes = random.uniform((0.2, 0.02, 0.02), (0.3, 0.04, 0.03))
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays(tuple(sizes), (4, 1, 1)))
    contacts = "".join(f'[contacts.{name}]\nsurface = "{name}"\n' for name in ("right", "top", "bottom"))
    tip = {"outputs.tip": f"points = [[{sizes[0]}, 0.0, 0.0]]"}
    loads = {name: text for name, text in LOADS.items() if "tendon" not in name} | tip
    text = scene_text(mesh, supports=supports, damping="alpha = 0.5, beta = 2e-4", contacts=contacts, **loads)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rom = fr.reduce(fr.assemble(parse_scene(f'frame = "moving"\n{text}')), order=int(random.integers(5, 9)))

    def dense(model):
        A = random.standard_normal((model.order, model.order))
        return replace(model, damping=np.diag(model.damping) + A @ A.T)

    rom = replace(rom, contact_models={name: dense(model) for name, model in rom.contact_models.items()})
    check_switches(*along(rom, base, steps=10), every=2)


@pytest.mark.parametrize("memory", [taken_steps.MEMORY, 0.0])
def test_gradient_of_a_run_that_begins_after_a_switch(tmp_path, monkeypatch, memory):
    """Its start is in the modes that it has then; steps are recorded, or taken again from where blocks begin."""
    monkeypatch.setattr(taken_steps, "MEMORY", memory)
    rom, random = reduced(tmp_path, 'clamped = ["left"]'), np.random.default_rng(0)

    def at(q, r):
        body = fr.Simulator(rom, H, signals={"base_path": swung})
        order = body.model.order
        body.state = 1e-3 * np.linspace(1, 2, order), 1e-2 * np.linspace(1, -1, order)
        body.switch("top")
        body.state = body.state[0] + q, body.state[1] + r
        return body

    at_rest = at(0.0, 0.0)
    m, u = at_rest.model.order, random.standard_normal((8, at_rest.inputs))
    assert m > rom.contact_models["top"].order
    directions = [random.standard_normal(u.shape), 1e-3 * random.standard_normal(m), 1e-1 * random.standard_normal(m)]
    check_switches(at, u, (np.zeros(m), np.zeros(m)), directions, every=4)


def test_base_of_a_body_that_switches(tmp_path):
    """Its twists, on a floor."""
    rom = reduced(tmp_path, 'clamped = ["left"]', **of_scene({"effects.contact.obstacles.ball": BALL}))
    _, u, start, _ = along(rom, lowered, size=0.02, steps=12)
    contact, random = ["right"] * 6 + ["top"] * 6, np.random.default_rng(0)
    δ = random.standard_normal(3)

    def run(ε):
        def base(time):  # drawn along while it goes on as it did
            state = lowered(time)
            return state._replace(position=state.position + ε * time * δ, velocity=state.velocity + ε * δ)

        body, read, energies = fr.Simulator(rom, H, signals={"base_path": base}), [], []
        body.state = start
        whole = fr.differentiate(body, u, squares, contact=contact) if not ε else None
        for row, name in zip(u, contact, strict=True):
            body.switch(name)
            body.step(row)
            read.append(body.displacement("tip"))
            energies.append(body.energy)
        assert body.contact_forces().any()
        return squares({"tip": np.array(read)}, np.array(energies))[0], whole

    gradient, times = run(0.0)[1], H * np.arange(1, 13)
    owed = gradient.base["position"] @ δ @ times + (gradient.base["velocity"] @ δ).sum() + gradient.pose["velocity"] @ δ
    assert owed == pytest.approx((run(1e-6)[0] - run(-1e-6)[0]) / 2e-6, rel=AGREES)


def test_a_switch_that_finds_nothing_is_a_kink(tmp_path):
    """What it would find nearby would have modes of its own."""
    rom = reduced(tmp_path, 'clamped = ["left"]')
    body = fr.Simulator(rom, H)
    with pytest.warns(FenicsRomWarning, match=r"1 of 4 steps \(0\) are at a kink"):
        gradient = fr.differentiate(body, np.zeros((4, body.inputs)), squares, contact="top")
    assert gradient.kinks == (0,)
