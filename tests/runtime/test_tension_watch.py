"""Tendons that are given tensions below 0 while a body runs are told, whatever takes the steps."""

import numpy as np
import pytest
from bodies import acted_on

import fenics_rom as fr

ROPE = """
inertia = {}
damping = { alpha = 2.0, beta = 1e-3 }
tendon.rope = { points = [[0.05, 0.2, 0.25], [0.95, 0.2, 0.25]] }
"""
FLOOR = 'contact.obstacles.floor = { shape = "half-space", point = [0, 0, -1], normal = [0, 0, 1] }'
TOLD = "effects.tendon.rope: its tension was down to -0.5 N: a cable does not push"
WAYS = {
    "plain": {"effects": ROPE},
    "staged": {"effects": ROPE, "order": 60},
    "gravity": {"effects": ROPE + "gravity = { acceleration = [0, 0, -9.81] }"},
    "contact": {"effects": ROPE + FLOOR},
    "springs": {"effects": f'{ROPE}{FLOOR}\ncontact.method = "penalty"\ncontact.stiffness = 50.0'},
}


@pytest.fixture(scope="module")
def roms(box_file):
    def made(effects, order=8):
        return fr.reduce(fr.assemble(acted_on(box_file, effects)), order=order)

    return {name: made(**parts) for name, parts in WAYS.items()}


def steps(body, tensions, contact=3):
    for tension in tensions:
        body.step(np.array([0.0] * contact + [tension]))


@pytest.mark.parametrize("way", ["gravity", "contact", "springs"])
def test_inputs_of_actuators_alone_are_told_too(roms, way):
    """Without the columns of the contact mode."""
    body = fr.Simulator(roms[way], 1e-3)
    body.step([-0.5])
    assert [text for text in body.warnings if text.startswith(TOLD)]


@pytest.mark.parametrize("way", WAYS)
def test_each_way_to_step_tells_it(roms, way):
    body = fr.Simulator(roms[way], 1e-3)
    steps(body, [0.3] * 3)
    assert not body.warnings
    steps(body, [-0.2, -0.5, -0.1, 0.0])
    assert [text for text in body.warnings if text.startswith(TOLD)]
    body.switch("top" if body.contact != "top" else "right")
    steps(body, [0.1])
    assert [text for text in body.warnings if text.startswith(TOLD)]
    body.reset()
    assert not body.warnings
    inputs = np.zeros((70, body.inputs))
    inputs[40, -1] = -0.5
    body.rollout(inputs)
    assert [text for text in body.warnings if text.startswith(TOLD)]
    if way == "springs":  # which no world takes
        return
    world = fr.World({"arm": fr.SoftBody(roms[way])}, 1e-3)
    world.step({"arm": {"rope": -0.5}})
    assert [text for text in world.warnings if TOLD in text]


@pytest.mark.parametrize("way", ["contact", "springs"])
def test_inputs_of_actuators_alone_tell_it_too(roms, way):
    body = fr.Simulator(roms[way], 1e-3)
    body.step(np.array([-0.5]))
    assert [text for text in body.warnings if text.startswith(TOLD)]


def test_pushes_at_a_contact_may_have_any_sign(roms):
    body = fr.Simulator(roms["plain"], 1e-3)
    for _ in range(3):
        body.step(np.array([-1.0, -1.0, -1.0, 0.0]))
    assert not body.warnings


@pytest.mark.parametrize("way", ["plain", "contact", "springs"])
def test_each_body_of_a_batch_tells_it(roms, way):
    bodies = fr.Batch(roms[way], 3, 1e-3)
    u = np.zeros((3, bodies.inputs))
    for tensions in ([0.1, -0.5, 0.0], [0.2, -0.1, -0.3]):
        u[:, -1] = tensions
        bodies.step(u)
    np.testing.assert_array_equal(bodies.least_tensions["rope"], [0.0, -0.5, -0.3])
    bodies.reset([1])
    np.testing.assert_array_equal(bodies.least_tensions["rope"], [0.0, 0.0, -0.3])
