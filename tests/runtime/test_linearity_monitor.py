"""A run that leaves the linear range says so once, with the number, and in its record."""

import warnings

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.linearity import ROTATION_LIMIT, SurfaceGauges, measure_peaks
from fenics_rom.runtime.linearity_monitor import LinearityMonitor
from fenics_rom.scene.file import parse_scene

PUSHED = """
name = "plate"
[mesh]
file = "{mesh}"
[material]
young = 1.0e6
poisson = 0.49
density = 2300.0
[supports]
clamped = ["root"]
[contacts.tip_left]
surface = "tip_left"
force = "resultant"
[contacts.middle]
surface = "middle"
force = "resultant"
[outputs.tip]
points = [[0.5, 0.2, 0.01], [0.5, 0.0, 0.01]]
[effects]
inertia = {{}}
damping = {{alpha = 0.5, beta = 1e-3}}
[run]
dt = 1e-3
duration = 0.5
[[run.load]]
contact = "tip_left"
start = 0.0
stop = 0.5
force = [0.0, 0.0, {newton}]
"""


def turned(rom, simulator):
    return measure_peaks(SurfaceGauges(rom.nodes, rom.triangles).components(simulator.displacement()))[0]


def test_warns_once_when_the_surface_turns_too_far(plate_rom):
    simulator, truth = fr.Simulator(plate_rom, dt=1e-3), []

    def push():
        for _ in range(1000):
            simulator.step([0.0, 0.0, 1.5])
            truth.append(turned(plate_rom, simulator))

    with pytest.warns(FenicsRomWarning, match=r"turned by 0\.2\d* rad \(1\d\.?\d*°\) at t = 0\.") as caught:
        push()
    assert len(caught) == 1
    first = next(k for k, angle in enumerate(truth, start=1) if angle > ROTATION_LIMIT)
    assert simulator.surface_peak.time == pytest.approx(first * 1e-3, abs=0.0101)  # a look at every tenth high state
    assert simulator.surface_peak.rotation == pytest.approx(max(truth), rel=0.05)


def test_says_nothing_within_the_limits(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(1000):
            simulator.step([0.0, 0.0, 0.5])
    assert not simulator.surface_peak.beyond


def test_rollout_watches_too(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    with pytest.warns(FenicsRomWarning, match="turned by 0.2"):
        simulator.rollout(np.tile([0.0, 0.0, 1.5], (1000, 1)))
    assert simulator.surface_peak.rotation > ROTATION_LIMIT


def test_a_reset_or_restored_body_is_watched_anew(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    start = simulator.save()
    for back in (simulator.reset, lambda: simulator.restore(start)):
        with pytest.warns(FenicsRomWarning, match="turned by"):
            simulator.rollout(np.tile([0.0, 0.0, 3.0], (500, 1)))
        back()
        assert not simulator.surface_peak.beyond


@pytest.mark.parametrize(("newton", "said"), [(0.4, 0), (3.0, 1)])
def test_the_record_says_it_of_reduced_and_full_runs(plate_rom, newton, said):
    from bodies import PLATE

    scene = parse_scene(PUSHED.format(mesh=PLATE.parent / "../../meshes/plate.msh", newton=newton))
    runs = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        runs.append(fr.simulate(plate_rom, scene=scene))
        runs.append(fr.simulate(scene))
    lines = [[line for line in run.warnings if "surface was turned by up to" in line] for run in runs]
    assert [len(found) for found in lines] == [said, said]
    assert len([w for w in caught if "surface is turned" in str(w.message)]) == 2 * said


def test_what_was_safe_in_one_contact_mode_says_nothing_in_another(plate_rom):
    """The same numbers are another shape there."""
    watch, e = LinearityMonitor(plate_rom), np.eye(20)[0]
    watch.enter("middle", plate_rom.contact_models["middle"])
    watch.look(1e-6 * e, time=0.0)
    watch.enter("tip_left", plate_rom.contact_models["tip_left"])
    for _ in range(20):
        watch.look(1e-6 * e, time=1.0)
    assert watch.peak.time == 1.0
