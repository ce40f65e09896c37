"""Contact models as state spaces: passive, exact, and the simulator's own steps and switches."""

import numpy as np
import pytest
import scipy.signal
from bodies import acted_on
from linear_roms import EFFECTS, LINEAR_BODIES, LOAD_VALUES, PARTS, linear_rom, ride

import fenics_rom as fr
from fenics_rom.errors import StepError

EXACT = 1e-12  # relative


@pytest.fixture(scope="module", params=LINEAR_BODIES)
def rom(request):
    return linear_rom(request.param, request)


@pytest.mark.parametrize("h", [1e-3, 3e-2])
def test_discrete_state_space_is_the_simulator_through_switches(rom, h):
    plants = {name: rom.state_space(name, dt=h) for name in rom.contact_models}
    active, pairs = next(iter(plants)), []
    x = np.zeros(len(plants[active].A))
    for body, u, read in ride(rom, h, 1000):
        if body.contact != active:
            x, active = rom.switch_map(active, body.contact) @ x, body.contact
        A, B, C, _ = plants[active]
        x = A @ x + B @ u
        pairs.append(([*read, body.energy], [*(C @ x), (x[rom.rigid :] @ x[rom.rigid :]) / 2]))
    simulated, mapped = np.array(pairs).swapaxes(0, 1)
    assert np.abs(mapped - simulated).max(axis=0) / np.abs(simulated).max(axis=0) == pytest.approx(0, abs=EXACT)
    assert simulated[-1].any()


def test_continuous_state_space_dissipates_by_damping_alone(rom):
    for name, model in rom.contact_models.items():
        plant, m, rigid = rom.state_space(name), model.order, rom.rigid
        D = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
        stored = np.r_[rigid : 2 * m]
        balance = (plant.A + plant.A.T)[np.ix_(stored, stored)]
        assert np.array_equal(balance[m - rigid :, m - rigid :], -2 * D)
        assert not balance[: m - rigid].any()
        assert not plant.A[rigid:, :rigid].any()  # where the body is does not matter


def test_step_is_the_bilinear_transform_of_continuous_time(rom):
    h = 2e-3
    for name in rom.contact_models:
        continuous, discrete = rom.state_space(name), rom.state_space(name, dt=h)
        half, unit = h / 2 * continuous.A, np.eye(len(continuous.A))
        expected = np.linalg.solve(unit - half, np.hstack([unit + half, h * continuous.B]))
        assert np.abs(np.hstack([discrete.A, discrete.B]) - expected).max() <= EXACT * np.abs(expected).max()


def test_frequency_response_is_that_of_mass_damping_and_stiffness(rom):
    name, s = next(iter(rom.contact_models)), 20j
    model, (A, B, C, D) = rom.contact_models[name], rom.state_space(name)
    damping = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
    q = np.linalg.solve(s**2 * np.eye(model.order) + s * damping + np.diag(model.eigenvalues), model.inputs)
    expected = np.vstack([rows @ model.coordinates for rows in rom.outputs.values()]) @ q
    found = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
    assert np.abs(found - expected).max() <= EXACT * np.abs(expected).max()


def test_scipy_simulates_it(plate_rom):
    plant, body, u = plate_rom.state_space("middle", ["tip"], 1e-3), fr.Simulator(plate_rom, 1e-3), np.eye(3)[2]
    _, read, _ = scipy.signal.dlsim(scipy.signal.dlti(*plant, dt=plant.dt), np.tile(u, (101, 1)))
    body.switch("middle")
    expected = body.rollout(np.tile(u, (100, 1)))["tip"].reshape(100, -1)
    assert np.abs(read[1:] - expected).max() <= EXACT * np.abs(expected).max()
    assert not read[0].any()


def test_python_control_and_casadi_take_it_as_it_is(plate_rom):
    control, casadi = pytest.importorskip("control"), pytest.importorskip("casadi")
    plant, body, u = plate_rom.state_space("middle", ["tip"], 1e-3), fr.Simulator(plate_rom, 1e-3), np.eye(3)[2]
    body.switch("middle")
    expected = body.rollout(np.tile(u, (100, 1)))["tip"].reshape(100, -1)
    found = control.forced_response(control.ss(*plant, plant.dt), 1e-3 * np.arange(101), np.tile(u, (101, 1)).T)
    assert np.abs(found.outputs.T[1:] - expected).max() <= EXACT * np.abs(expected).max()
    (A, B, C, _), x, read = map(casadi.DM, plant), casadi.DM.zeros(len(plant.A)), []
    for _ in expected:
        x = A @ x + B @ u
        read.append(np.array(C @ x).ravel())
    assert np.abs(read - expected).max() <= EXACT * np.abs(expected).max()


def test_names_and_units(box_file):
    scene = acted_on(box_file, EFFECTS, **{**PARTS, "outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    plant = fr.reduce(fr.assemble(scene), order=2).state_space("right", ["end", "tip"])
    columns = [("right[0]", "N"), ("right[1]", "N"), ("right[2]", "N"), ("air", "Pa"), ("rope", "N")]
    assert list(plant.inputs.items()) == [*columns, ("gravity", "1"), ("quake", "m/s2")]
    assert list(plant.outputs) == [f"{name}[0,{axis}]" for name in ("end", "tip") for axis in range(3)]
    assert list(plant.states.items()) == [(name, "J^0.5") for name in ("e[0]", "e[1]", "r[0]", "r[1]")]
    assert repr(plant).startswith("StateSpace in continuous time: 4 states\n  inputs: right[0], ")


def test_what_is_not_there_is_refused(plate_rom):
    with pytest.raises(StepError, match=r"no contact mode 'tip'; there is middle, tip_left"):
        plate_rom.state_space("tip")
    with pytest.raises(StepError, match=r"no contact mode 'top'; there is middle, tip_left"):
        plate_rom.switch_map("middle", "top")
    with pytest.raises(StepError, match="no output 'tips'; there is tip; did you mean 'tip'"):
        plate_rom.state_space("middle", ["tips"])
    with pytest.raises(StepError, match="dt = 0: use a finite number > 0, in s"):
        plate_rom.state_space("middle", dt=0)


READINGS = {
    "readings.rope_length": 'quantity = "length"\nof = "rope"',
    "readings.stretched": 'quantity = "strain"\nof = "top"',
    "readings.flag": 'quantity = "marker"\npoint = [0.5, 0.2, 0.35]',
    "readings.corner": 'quantity = "stress"\npoints = [[0.5, 0.2, 0.15], [0.7, 0.4, 0.3]]',
    "readings.components": 'quantity = "surface_stress"\nof = "top"',
    "readings.stressed": 'quantity = "von_mises_stress"',
}


def test_readings_that_are_linear_are_outputs(box_file):
    rom = fr.reduce(fr.assemble(acted_on(box_file, EFFECTS, **PARTS, **READINGS)), order=8)
    names = ["rope_length", "tip", "stretched", "components", "corner", "flag"]
    body = fr.Simulator(rom, 1e-3, signals=LOAD_VALUES)
    plant = rom.state_space(body.contact, names, dt=1e-3)
    random, x = np.random.default_rng(0), np.zeros(len(plant.A))
    at_rest = body.reading("rope_length")
    for _ in range(20):
        u = random.standard_normal(body.inputs)
        body.step(u)
        x = plant.A @ x + plant.B @ np.array([*u, *(LOAD_VALUES[name] for name in rom.loads)])
    others = [body.reading("stretched"), body.reading("components"), body.reading("corner")[:, :6]]
    read = [body.displacement("tip"), *others, body.reading("flag")]
    seen = np.split(plant.C @ x, np.cumsum([1, *(part.size for part in read)])[:-1])
    assert seen[0][0] == pytest.approx(
        body.reading("rope_length") - at_rest, abs=1e-15 * at_rest + EXACT * abs(seen[0][0])
    )
    for part, values in zip(read, seen[1:], strict=True):
        assert np.abs(values - part.ravel()).max() <= EXACT * np.abs(part).max()
    units = list(plant.outputs.items())
    assert units[0] == ("rope_length", "m")
    assert units[7] == ("stretched[0,0]", "1")
    assert units[-1] == ("flag[2]", "m")
    with pytest.raises(StepError, match="reading 'stressed': von Mises stress is not linear"):
        rom.state_space(body.contact, ["stressed"])
