"""What a run with large deformation says when it goes beyond what its model was trained on: by what, and how far."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.environment import AppliedLoad
from fenics_rom.mechanics.signals import Signal
from fenics_rom.mechanics.voigt import VOIGT_SHEAR
from fenics_rom.rom.deformation import TrainingRange
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.runtime.steppers.training_watch import LOCAL_STRAIN, TRUSTED_LOAD, TRUSTED_STRAIN, TrainingWatch
from fenics_rom.trajectory.file import read_trajectory, write_trajectory

STEPPERS = ("newton", "linearly-implicit")
ANY = 1e6  # of what is not looked at


def trained(rom, **ranges):
    """The same, trained to some ranges, and with anything as far as it likes."""
    given = {"inputs": {"air": ANY, "cable": ANY}, "pushes": {"tip": ANY, "middle": ANY}, "smoothing_time": 0.0}
    strains = np.full(len(rom.deformation.weights), ANY)
    return replace(
        rom, deformation=replace(rom.deformation, trained=TrainingRange(**given | {"strains": strains} | ranges))
    )


@pytest.fixture(scope="module")
def rom():
    return soft_rom()


@pytest.fixture(scope="module")
def touching():
    return soft_rom(contact=True)


def said(rom, u, *, steps=20, dt=5e-3, stepper=None):
    """What a run of a constant input says in the end; it is said at once, too."""
    body = fr.Simulator(rom, dt, stepper=stepper)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FenicsRomWarning)
        for _ in range(steps):
            body.step(u)
    at_once = [str(warning.message) for warning in caught if "beyond what" in str(warning.message)]
    beyond = [message for message in body.warnings if "beyond what" in message]
    assert bool(at_once) == bool(beyond)
    return "".join(beyond), body


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("share", [0.5 * (1 + TRUSTED_LOAD), 6.0])
def test_a_tendon_pulled_harder_than_in_training_is_told_with_both_forces(rom, stepper, share):
    inputs = {"air": 0.0, "cable": 0.2}
    text, _ = said(trained(rom, inputs=inputs), [0.0, 0.0, 0.0, 0.0, 0.2 * share], stepper=stepper)
    assert text == "" if share < TRUSTED_LOAD else "input 'cable' reached 1.2 N, 6 times the 0.2 N of training" in text


def test_an_input_that_training_did_not_have_is_told(rom):
    text, _ = said(trained(rom, inputs={"air": 0.0, "cable": ANY}), [0.0, 0.0, 0.0, 0.5, 0.0])
    assert "input 'air' reached 0.5 Pa, and was not there in training" in text
    assert said(trained(rom, inputs={"air": 0.0, "cable": ANY}), np.zeros(5))[0] == ""


def test_a_push_on_a_contact_mode_is_told(rom):
    text, _ = said(trained(rom, pushes={"tip": 0.05, "middle": ANY}), [0.0, 0.06, 0.08, 0.0, 0.0])
    assert "the push on 'tip' reached 0.1 N, 2 times the 0.05 N of training" in text


def test_a_push_is_told_of_a_body_without_actuators_and_loads(rom):
    models = {name: replace(mode, inputs=mode.inputs[:, :3]) for name, mode in rom.contact_models.items()}
    deformation = replace(rom.deformation, tendons={}, pressures={})
    bare = replace(rom, contact_models=models, actuators={}, loads={}, deformation=deformation)
    text, _ = said(trained(bare, inputs={}, pushes={"tip": 0.05, "middle": ANY}), [0.0, 0.06, 0.08])
    assert "the push on 'tip' reached 0.1 N, 2 times the 0.05 N of training" in text


@pytest.mark.parametrize("stepper", STEPPERS)
def test_the_strain_is_that_of_the_kept_point_that_went_furthest(rom, stepper):
    """Measured anew from the states of the run; a point that training hardly strained counts by the largest one."""
    u, h = [0.0, 0.0, 0.2, 0.0, 0.0], 5e-3
    body, peak = fr.Simulator(rom, h, stepper=stepper), np.zeros(len(rom.deformation.weights))
    for _ in range(20):
        body.step(u)
        E = rom.deformation.strains(body.state[0])
        peak = np.maximum(peak, np.sqrt((E * E / VOIGT_SHEAR).sum(axis=0)))
    seen = np.where(np.arange(len(peak)) % 2, 0.0, peak / 2)
    expected = (peak / np.maximum(seen, LOCAL_STRAIN * seen.max())).max()
    text, _ = said(trained(rom, strains=seen), u, stepper=stepper)
    found = re.search(r"the strain of a kept point reached (\S+) times", text)
    assert float(found[1]) == pytest.approx(expected, rel=0.01)  # three digits
    assert said(trained(rom, strains=peak / (TRUSTED_STRAIN - 0.01)), u, stepper=stepper)[0] == ""
    assert (
        "the strain of a kept point"
        in said(trained(rom, strains=peak / (TRUSTED_STRAIN + 0.01)), u, stepper=stepper)[0]
    )


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("seed", range(3))
def test_no_shape_beyond_training_is_passed_over(rom, seed):
    """Whichever way a body goes, in strides of any length: what is noted is what all strains of all shapes give."""
    rng, body = np.random.default_rng(seed), rom.deformation
    seen = rng.uniform(0.02, 0.2, len(body.weights))
    limits = np.maximum(seen, LOCAL_STRAIN * seen.max())
    watch = TrainingWatch(trained(rom, strains=seen), None)
    watch.enter("tip", 5)
    notes, largest, q = dict.fromkeys(watch.notes, 0.0), 0.0, np.zeros(body.order)
    towards = rng.standard_normal(body.order) * body.training_radius / np.arange(1, body.order + 1) ** 2
    for step in range(400):
        aim = 1.5 * np.sin(0.05 * step) ** 2 * towards
        q = aim + 10 ** rng.uniform(-4, -1) * body.training_radius * rng.standard_normal(body.order) / body.order
        E = body.strains(q)
        share = (np.sqrt((E * E / VOIGT_SHEAR).sum(axis=0)) / limits).max()
        largest = max(largest, share if share > TRUSTED_STRAIN else 0.0)
        watch.look(notes, np.zeros(5), q, None, 1e-3)
        assert notes["strain"] == pytest.approx(largest, rel=1e-12)
    assert largest > 0


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_a_point_that_is_pulled_straight_is_looked_at_where_it_gets_beyond_training(rom, monkeypatch):
    """Its stretch grows by all that |ΔH| may add, so that the bound on what is not looked at is as far as it may be."""
    body, limit = rom.deformation, 0.1
    gradients = np.zeros((3, 3, 1, body.order))
    gradients[0, 0] = 1 / body.order  # H is the mean of q
    one = replace(body, gradients=gradients, weights=body.weights[:1])
    watched = trained(replace(rom, deformation=one), strains=np.array([limit]))
    farthest = np.sqrt(1 + 2 * TRUSTED_STRAIN * limit) - 1  # F - 1 of that strain
    looked, squares_of = [], MaterialPoints.strain_squares
    monkeypatch.setattr(MaterialPoints, "strain_squares", lambda self, q: looked.append(q) or squares_of(self, q))
    for start in (0.0, 0.3, 0.9):
        watch = TrainingWatch(watched, None)
        watch.enter("tip", 5)
        notes = dict.fromkeys(watch.notes, 0.0)
        for share, looks, value in ((start, 1, 0.0), (1 - 1e-9, 1, 0.0), (1 + 1e-9, 2, TRUSTED_STRAIN)):
            watch.look(notes, np.zeros(5), np.full(body.order, share * farthest), None, 1e-3)
            assert len(looked) == looks
            assert notes["strain"] == pytest.approx(value, rel=1e-6)
        looked.clear()


def test_an_obstacle_that_pushes_harder_is_told_by_name(touching):
    """Pulled down onto the floor: the largest of its forces, averaged over the time that training averaged over."""
    τ, h = 0.02, 5e-3
    body, mean, largest = fr.Simulator(touching, h), np.zeros(3), 0.0
    for _ in range(40):
        body.step([0.0, 3.0])
        mean += h / (h + τ) * (body.contact_forces("floor") - mean)
        largest = max(largest, np.linalg.norm(mean))
    assert largest > 0
    limits = {"tip": largest / 3, "middle": largest / 4}
    text, _ = said(trained(touching, pushes=limits, smoothing_time=τ), [0.0, 3.0], steps=40)
    assert re.search(rf"the force of obstacle 'floor' reached {largest:.3g} N, 3 times the", text)
    limits = {"tip": 0.0, "middle": largest / (TRUSTED_STRAIN - 0.01)}
    assert said(trained(touching, pushes=limits, smoothing_time=τ), [0.0, 3.0], steps=40)[0] == ""


def test_a_new_run_begins_with_nothing_said(rom):
    _, body = said(trained(rom, inputs={"air": 0.0, "cable": 0.1}), [0.0, 0.0, 0.0, 0.0, 1.0])
    body.reset()
    assert body.warnings == ()


def test_old_roms_are_looked_at_as_before(rom):
    assert rom.deformation.trained is None
    assert said(rom, [0.0, 0.0, 0.0, 0.0, 6.0], steps=2)[0] == ""


def test_looking_changes_no_bit_of_a_run(rom):
    for stepper in STEPPERS:
        (_, watched), (_, plain) = (said(r, [0.0, 0, 0.2, 0, 0], stepper=stepper) for r in (trained(rom), rom))
        np.testing.assert_array_equal(watched.state, plain.state)


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_the_warning_is_kept_in_the_run_and_its_file(rom, tmp_path):
    load = AppliedLoad(None, "cable", 0.0, 0.1, Signal(np.array([1.2])))
    scene = replace(rom.environment, run=replace(rom.environment.run, loads=(load,)))
    run = fr.simulate(trained(rom, inputs={"air": 0.0, "cable": 0.2}), scene=scene)
    assert run.beyond_training
    write_trajectory(tmp_path / "run.h5", run)
    again = read_trajectory(tmp_path / "run.h5")
    assert again.beyond_training
    assert again.warnings == run.warnings
    assert any("6 times the 0.2 N of training" in warning for warning in again.warnings)
    assert not fr.simulate(rom, scene=scene).beyond_training
