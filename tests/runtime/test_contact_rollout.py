"""A rollout among obstacles is stepping: the same motion, forces and account, also where contact changes in a block."""

import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import acted_on
from landing_box import BODY, DT, ORDER, PARTS, ROUGH, WEIGHT, history, landing_mesh, landing_roms, stepped

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.runtime import contact_blocks
from fenics_rom.runtime.contact_blocks import ContactBlocks

SAME = 1e-9  # of the largest displacement: searches are exact to 1e-12 of the velocities that they stop

pytestmark = [
    pytest.mark.filterwarnings("ignore:the surface is", "ignore:.*contact points leave"),
    pytest.mark.usefixtures("numpy_alone"),  # for compiled steps see test_compiled_steps.py
]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return landing_mesh(tmp_path_factory.mktemp("rollout"))


@pytest.fixture(scope="module")
def roms(mesh):
    return landing_roms(mesh)


def blocks_of(body, monkeypatch):
    """Lists, for each block that a rollout of this body tries from now on, how many steps stayed, and of how many."""
    taken, block = [], ContactBlocks.take

    def counted(self, u):
        asked, is_tried = min(self._length, 1 << len(u).bit_length() >> 1), self._same >= self._wait
        found = block(self, u)
        if is_tried and asked >= contact_blocks.FIRST_BLOCK:
            taken.append((0 if found is None else len(found[1].inputs), asked))
        return found

    monkeypatch.setattr(ContactBlocks, "take", counted)
    return taken


def assert_same(one, other, scale):
    """Two bodies and their accounts, which close; scale of displacements, m."""
    assert (one.contact, one.steps, one.time) == (other.contact, other.steps, other.time)
    np.testing.assert_allclose(one.displacement(), other.displacement(), atol=SAME * scale, rtol=0)
    np.testing.assert_allclose(one.contact_forces(), other.contact_forces(), atol=1e-7 * WEIGHT, rtol=0)
    for body in (one, other):
        account = body.ledger
        size = max(body.energy, abs(account.supplied), account.dissipated)
        left = body.energy - account.supplied + account.dissipated + account.lost_in_switching
        assert abs(left) <= 1e-12 * size
        assert min(account.contact, account.friction) >= -1e-12 * size
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-8 * np.abs(sums).max(), rtol=0)


@pytest.mark.parametrize("case", ["floor", "thrown back", "smooth", "ball"])
def test_rollout_is_stepping_through_all_that_contact_does(roms, case, monkeypatch):
    """It comes to touch, to stick, to slide, to stop and to leave, in the middle of blocks, at the very same steps."""
    for seed, every in ((1, 1), (2, 7)):
        forces = history(seed)
        body, read, statuses = stepped(roms[case], forces, every)
        rolled = fr.Simulator(roms[case], DT)
        with monkeypatch.context() as patch:
            taken = blocks_of(rolled, patch)
            corner = rolled.rollout(forces, every=every)["corner"]
        blocks = np.array(taken)
        scale = np.abs(read).max()
        assert corner.shape == read.shape
        np.testing.assert_allclose(corner, read, atol=SAME * scale, rtol=0)
        assert_same(body, rolled, scale)
        least = {"ball": 0.2, "thrown back": 0.02}.get(case, 0.4)  # what is thrown back takes long to be at rest
        assert blocks[:, 0].sum() > least * len(forces)
        assert ((blocks[:, 0] > 0) & (blocks[:, 0] < blocks[:, 1])).any()  # something happened within
        assert len(set(statuses)) > 3


def test_forces_are_those_of_single_steps_around_each_event(roms):
    """Rollouts that end at any step near a change of contact: the forces there are those of the same step."""
    forces, rom = history(3), roms["floor"]
    _, _, statuses = stepped(rom, forces)
    changes = np.flatnonzero([a != b for a, b in pairwise(statuses)])[::5] + 2
    body, at = fr.Simulator(rom, DT), 0
    for end in changes[changes > 150][:12]:
        rolled = fr.Simulator(rom, DT)
        rolled.rollout(forces[:end])
        for u in forces[at:end]:
            body.step(u)
        at = end
        np.testing.assert_allclose(rolled.contact_forces(), body.contact_forces(), atol=1e-7 * WEIGHT, rtol=0)


@pytest.mark.parametrize("case", ["springs", "two"])
def test_what_is_not_taken_in_blocks_is_stepped(roms, case):
    forces = history(1)[:200]
    body, read, _ = stepped(roms[case], forces)
    rolled = fr.Simulator(roms[case], DT)
    np.testing.assert_array_equal(rolled.rollout(forces)["corner"], read)
    np.testing.assert_array_equal(rolled.energy_coordinates, body.energy_coordinates)


def test_random_pushes_cost_few_attempts(roms, monkeypatch):
    """Where contact is another in every step, waits grow, and maps do not pile up."""
    rolled, forces = fr.Simulator(roms["floor"], DT), history(4, roughness=0.5)
    taken = blocks_of(rolled, monkeypatch)
    made, kept_map = [], contact_blocks.KeptContactMap
    monkeypatch.setattr(contact_blocks, "KeptContactMap", lambda *given: made.append(1) or kept_map(*given))
    rolled.rollout(forces)
    body, read, _ = stepped(roms["floor"], forces)
    assert_same(body, rolled, np.abs(read).max())
    assert len(taken) - np.count_nonzero([count for count, _ in taken]) < 8
    assert len(made) < 12
    assert len(rolled._rollout._stepped._blocks._maps) <= contact_blocks.MOST_KEPT_MAPS


def test_pieces_without_ledger_and_other_steps(roms):
    """In pieces, without an account or outputs, with steps that change, and from a state that is put in."""
    forces, rom = history(5), roms["floor"]
    sizes = np.where(np.arange(700) // 100 % 2, DT, 2 * DT)
    whole, body = fr.Simulator(rom, DT), fr.Simulator(rom, DT, ledger=False)
    assert whole.rollout(forces, dt=sizes, outputs=[]) == {}
    for u, dt in zip(forces, sizes, strict=True):
        body.dt = dt
        body.step(u)
    np.testing.assert_allclose(whole.displacement(), body.displacement(), atol=SAME * 1e-2, rtol=0)
    start = whole.save()
    first = whole.rollout(forces[:90])["corner"][-1]
    whole.restore(start)
    pieces = copy.copy(whole)
    for k in range(0, 90, 30):
        piece = pieces.rollout(forces[k : k + 30])["corner"]
    np.testing.assert_allclose(piece[-1], first, atol=SAME * 1e-2, rtol=0)
    assert pieces.ledger is not None


def test_loads_and_obstacles_that_move_are_those_of_their_times(roms):
    """A floor that rises takes single steps; once it stands, blocks are from there."""
    rom = roms["floor"]

    def rises(t):
        return [0.0, 0.0, min(t, 0.1) * 0.02]

    runs = []
    for way in ("steps", "rollout"):
        body = fr.Simulator(rom, DT, signals={"floor": rises, "gravity": lambda t: 1 + 0.1 * np.sin(30 * t)})
        forces = np.zeros((200, 3))
        if way == "steps":
            for u in forces:
                body.step(u)
            body.set_signal("floor", rises(1.0))
            for u in forces:
                body.step(u)
        else:
            body.rollout(forces)
            body.set_signal("floor", rises(1.0))
            body.rollout(forces)
        runs.append(body)
    assert_same(*runs, np.abs(runs[0].displacement()).max())


def test_mode_follows_the_obstacles_and_is_not_asked_for(mesh):
    """A body is pushed to a wall on its right: the contact mode changes as in steps."""
    wall = '[effects.contact.obstacles.wall]\nshape = "half-space"\npoint = [0.32, 0, 0]\nnormal = [-1, 0, 0]\n'
    effects = BODY.replace("gravity = { acceleration = [0, 0, -9.81] }\n", "") + "[effects.contact]\n" + wall + ROUGH
    parts = PARTS | {"contacts": '[contacts.left]\nsurface = "left"\n[contacts.right]\nsurface = "right"\n'}
    rom = fr.reduce(fr.assemble(acted_on(mesh, effects, **parts)), order=ORDER)
    forces = np.tile([10.0, 0.0, 0.0], (400, 1))
    body, rolled = fr.Simulator(rom, DT), fr.Simulator(rom, DT)
    modes = []
    for u in forces:
        body.step(u)
        modes.append(body.contact)
    rolled.rollout(forces)
    assert set(modes) == {"left", "right"}
    assert_same(body, rolled, np.abs(body.displacement()).max())
    before = rolled.save()
    with pytest.raises(StepError, match=r"obstacles say .* effects\.contact\.switching = 'scene'"):
        rolled.rollout(forces, contact="left")
    with pytest.raises(StepError, match=r"obstacles say .* effects\.contact\.switching = 'scene'"):
        fr.differentiate(rolled, forces, lambda outputs, energies: (0.0, {}, None), contact="left")
    assert rolled.steps == before.steps
    by_scene = replace(rom, environment=replace(rom.environment, contact_switching="scene"))
    one, other = fr.Simulator(by_scene, DT), fr.Simulator(by_scene, DT)
    one.rollout(forces, contact="right")
    other.switch("right")
    for u in forces:
        other.step(u)
    assert_same(one, other, np.abs(other.displacement()).max())


def test_no_steps_are_a_rollout_too(roms):
    body = fr.Simulator(roms["floor"], DT)
    read = body.rollout(np.empty((0, 3)))
    assert read["corner"].shape == (0, *body.displacement("corner").shape)
    assert body.steps == 0


def test_rollouts_that_fail_leave_everything_as_it_was(roms):
    body = fr.Simulator(roms["floor"], DT)
    body.rollout(history(1)[:300])
    before, forces = body.save(), np.zeros((300, 3))
    forces[200:] = 1e300
    with pytest.raises(StepError, match="step 500"), np.errstate(all="ignore"):
        body.rollout(forces)
    after = body.save()
    np.testing.assert_array_equal(after.stepper.state, before.stepper.state)
    np.testing.assert_array_equal(after.stepper.auxiliary, before.stepper.auxiliary)
    assert (after.steps, after.sums) == (before.steps, before.sums)
