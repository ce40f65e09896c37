"""Steps at full order that Newton's method does not soon solve are cut, and the next begin with what was solved."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.fem.finite_strain.newton import takes_long
from fenics_rom.fem.finite_strain.residuals import MidpointResidual
from fenics_rom.fem.finite_strain.step_parts import LONGEST_WAIT, PATIENT_PARTS, QUICK_CUTS, LoadParts, StepParts
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.complementarity.frictional import FrictionalProblem

SIDE, SPEED = 0.1, 0.14  # m, and m/s of the plate
ROUND_OFF = 1e-10  # of the work, as the account must close, and of impulses


def taken(parts, solves, steps=1):
    """Shares of the parts of steps, where `solves` says of a share, and of patience, whether it is solved."""
    shares, tried = [], 0
    for _ in range(steps):
        done = 0.0
        while done < 1.0:
            parts.begin(done)
            tried += 1
            while not solves(parts.share, parts.is_patient):
                if not parts.cut():
                    return None, tried
                tried += 1
            parts.solved(20)
            shares.append(parts.share)
            done += parts.share
        assert done == 1.0
    return shares, tried


def test_a_size_that_was_solved_is_kept_and_twice_of_it_is_tried_ever_more_rarely():
    parts = StepParts(1 / 64)
    shares, tried = taken(parts, lambda share, patient: share <= 1 / 4, steps=100)
    assert set(shares) == {1 / 4}
    failures = tried - len(shares)
    assert 2 + np.log2(LONGEST_WAIT) <= failures <= 2 + np.log2(LONGEST_WAIT) + len(shares) / LONGEST_WAIT
    shares, _ = taken(parts, lambda share, patient: True, steps=LONGEST_WAIT)
    assert shares[-1] == 1.0


def test_what_no_small_part_solves_is_tried_with_patience_at_its_size():
    parts = StepParts(1 / 64)
    shares, tried = taken(parts, lambda share, patient: patient)
    assert shares == [1.0]
    assert tried == 1 + QUICK_CUTS + 1
    assert taken(parts, lambda share, patient: patient, steps=PATIENT_PARTS) == ([1.0] * PATIENT_PARTS, PATIENT_PARTS)
    assert taken(StepParts(1 / 64), lambda share, patient: False) == (None, 1 + QUICK_CUTS + 7)
    assert taken(LoadParts(1 / 4), lambda share, patient: share < 1 and patient) == ([0.5, 0.5], 3)


@pytest.mark.parametrize(
    ("sizes", "long"),
    [
        ([1.0, 0.9, 0.8, 0.7, 0.6, 0.5], True),  # hardly smaller
        ([1.0, 0.9, 0.8, 0.7, 0.6], False),  # too few to tell
        ([1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5], False),
        ([1.0, 2.0, 11.0], True),  # diverges
        ([1e-12, 1e-12, 1e-12, 1e-12, 1e-12, 1e-12], False),  # round-off
    ],
)
def test_what_takes_long_is_seen_early(sizes, long):
    assert takes_long(sizes, sizes[0], 1.0) == long


@pytest.mark.parametrize("friction", [0.5, 0.0])
def test_no_step_of_a_pressed_cube_takes_more_than_small_steps_would(tmp_path, friction, monkeypatch):
    """Pressed flat at 10 ms: each step takes at most what ten steps of 1 ms do, of forces and of contact systems.

    These take some 20 evaluations of forces each; once a step took ten thousand systems of contact forces. Parted or
    not, a step tells the forces that its momentum changes by.
    """
    table = tmp_path / "plate.csv"
    table.write_text(f"time,x,y,z\n0,0,0,0\n1,0,0,{-SPEED}\n")
    mesh = write_arrays(tmp_path / "cube.msh", *box_arrays((SIDE, SIDE, SIDE), (2, 2, 2)))
    effects = "inertia = {}\ndamping = { beta = 2e-3 }\n" + f"friction = {{ coefficient = {friction} }}\n" * bool(
        friction
    )
    effects += 'large_deformation = { material = "neo_hookean" }\n[effects.contact.obstacles]\n'
    effects += 'floor = { shape = "half-space", point = [0, 0, 0], normal = [0, 0, 1] }\n'
    effects += f'plate = {{ shape = "half-space", point = [0, 0, {SIDE}], normal = [0, 0, -1], table = "{table}" }}\n'
    everywhere = "[contacts.skin]\nnear = { point = [0, 0, 0], radius = 1.0 }"
    material = "young = 1e5\npoisson = 0.4\ndensity = 1000.0"
    system = fr.assemble(acted_on(mesh, effects, contacts=everywhere, material=material, supports=None))
    work = {"forces": 0, "systems": 0}
    evaluate, search = MidpointResidual.evaluate, FrictionalProblem.search_newton

    def evaluated(*given):
        work["forces"] += 1
        return evaluate(*given)

    def searched(*given, **named):
        work["systems"] += 1
        return search(*given, **named)

    monkeypatch.setattr(MidpointResidual, "evaluate", evaluated)
    monkeypatch.setattr(FrictionalProblem, "search_newton", searched)
    around = ActiveEnvironment(system.scene.environment)
    body, most, parted = system.deformation.stepper(10e-3, around), dict(work), 0
    momentum = np.zeros(3)
    for _ in range(48):
        work.update(forces=0, systems=0)
        inputs = around.step_input(np.zeros(system.input_matrix("skin").shape[1]), body.time, body.dt)
        body.step(inputs)
        around.commit(inputs, body.dt)
        most = {what: max(count, work[what]) for what, count in most.items()}
        parted, before, momentum = body.parted, momentum, system.body.node_mass @ body.velocity()
        forces = np.zeros((2, 3)) if body.contact is None else body.contact.by_obstacle
        missed = momentum - before - body.dt * forces.sum(axis=0)
        assert np.abs(missed).max() <= ROUND_OFF * body.dt * np.abs(forces).sum()
    assert body.displacement()[:, 2].min() < -0.6 * SIDE
    assert parted > 5  # it is hard
    assert most["forces"] <= 10 * 20
    assert most["systems"] <= 10 * 20
    assert abs(body.energy - body.ledger.supplied + body.ledger.dissipated) <= ROUND_OFF * body.ledger.supplied
    body.close()
