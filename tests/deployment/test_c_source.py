"""Code in C: compiled without a warning, and the simulator's own steps, switches and account."""

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from linear_roms import LINEAR_BODIES, LOAD_VALUES, linear_rom, ride
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import FileError, StepError
from fenics_rom.mechanics.viscoelasticity import PronySeries

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2"]
AGREES_TO = {"double": 1e-12, "float": 1e-5}  # relative, over 1,000 steps


@pytest.fixture(scope="module", params=LINEAR_BODIES)
def rom(request):
    return linear_rom(request.param, request)


class Body:
    """A body in C; names as in its header."""

    def __init__(self, source, kind):
        library = source.with_name(f"{kind}.so")
        single = ["-DPLANT_SINGLE"] if kind == "float" else []
        subprocess.run(["cc", *FLAGS, *single, "-shared", "-fPIC", source, "-o", library], check=True)
        self._code, self._real = ctypes.CDLL(library), {"double": ctypes.c_double, "float": ctypes.c_float}[kind]
        self._code.plant_energy.restype = ctypes.c_double
        header = source.with_suffix(".h").read_text()
        order, lines = int(header.split("_ORDER ")[1].split()[0]), header.splitlines()
        names = [line.split(",")[0].strip() for line in lines if line.startswith("    PLANT_")]
        self.contacts = [name.removeprefix("PLANT_CONTACT_").lower() for name in names if "PLANT_CONTACT_" in name]
        self._inputs, self._outputs = (sum(name.startswith(f"PLANT_{kind}_") for name in names) for kind in "UY")

        class State(ctypes.Structure):
            _fields_ = (
                ("contact", ctypes.c_int),
                ("e", self._real * order),
                ("r", self._real * order),
                ("supplied", ctypes.c_double),
                ("dissipated", ctypes.c_double),
                ("lost_in_switching", ctypes.c_double),
            )

        self.state = State()
        self._code.plant_init(ctypes.byref(self.state))

    def switch(self, contact):
        return self._code.plant_switch(ctypes.byref(self.state), contact)

    def step(self, u):
        """u is of the active contact mode, and of what all share."""
        assert len(u) <= self._inputs
        return self._code.plant_step(ctypes.byref(self.state), (self._real * self._inputs)(*u))

    def step_by(self, u, h):
        real = (self._real * self._inputs)(*u)
        return self._code.plant_step_by(ctypes.byref(self.state), real, ctypes.c_double(h))

    @property
    def energy(self):
        return self._code.plant_energy(ctypes.byref(self.state))

    @property
    def outputs(self):
        y = (self._real * self._outputs)()
        self._code.plant_outputs(ctypes.byref(self.state), y)
        return np.array(y)


def all_inputs(rom, contact, u):
    """Inputs of all contact modes, of which the others are not to act, and of what all share."""
    counts = rom.contacts
    parts = [u[: counts[name]] if name == contact else np.full(count, 99.0) for name, count in counts.items()]
    return np.concatenate([*parts, u[counts[contact] :]])


@pytest.mark.parametrize("kind", AGREES_TO)
def test_c_takes_the_steps_of_the_simulator(rom, kind, tmp_path):
    body = Body(fr.export(rom, tmp_path / "plant.c", dt=1e-3), kind)
    names, pairs = list(rom.contact_models), []
    assert len(body.contacts) == len(names)
    for simulator, u, read in ride(rom, 1e-3, 1000):
        assert body.switch(names.index(simulator.contact)) == 0
        assert body.step(all_inputs(rom, simulator.contact, u)) == 0
        work = [getattr(body.state, name) for name in ("supplied", "dissipated", "lost_in_switching")]
        ledger = simulator.ledger
        expected = [*read, simulator.energy, ledger.supplied, ledger.dissipated, ledger.lost_in_switching]
        pairs.append((expected, [*body.outputs, body.energy, *work]))
    expected, found = np.array(pairs).swapaxes(0, 1)
    assert np.abs(found - expected).max() > 0 or kind == "double"
    scale = np.abs(expected).max(axis=0)
    scale[-4:] = scale[-4:].max()  # energies and works make one account
    assert np.abs(found - expected).max(axis=0) / scale == pytest.approx(0, abs=AGREES_TO[kind])


@pytest.mark.parametrize("kind", AGREES_TO)
def test_steps_of_any_length_are_those_of_the_simulator(rom, kind, tmp_path):
    """From a thousandth of the step to ten of them; with an account that closes."""
    body, random = Body(fr.export(rom, tmp_path / "plant.c", dt=1e-3), kind), np.random.default_rng(2)
    simulator, names = fr.Simulator(rom, 1e-3, signals=LOAD_VALUES if rom.loads else None), list(rom.contact_models)
    pairs = []
    for step in range(100):
        simulator.switch(names[step // 9 % len(names)])
        simulator.dt, u = 1e-3 * 10 ** random.uniform(-3, 1), 0.1 * random.standard_normal(simulator.inputs)
        simulator.step(u)
        given = all_inputs(rom, simulator.contact, np.array([*u, *(LOAD_VALUES[name] for name in rom.loads)]))
        assert body.switch(names.index(simulator.contact)) == body.step_by(given, simulator.dt) == 0
        read = np.concatenate([simulator.displacement(name).ravel() for name in rom.outputs])
        ledger, work = simulator.ledger, ("supplied", "dissipated", "lost_in_switching")
        expected = [*read, simulator.energy, *(getattr(ledger, name) for name in work)]
        pairs.append((expected, [*body.outputs, body.energy, *(getattr(body.state, name) for name in work)]))
    expected, found = np.array(pairs).swapaxes(0, 1)
    scale = np.abs(expected).max(axis=0)
    scale[-4:] = scale[-4:].max()
    assert np.abs(found - expected).max(axis=0) / scale == pytest.approx(0, abs=AGREES_TO[kind])
    before = bytes(body.state)
    assert [body.step_by(np.zeros(1), h) for h in (0.0, -1e-3, np.nan, np.inf)] == [-1] * 4
    assert bytes(body.state) == before


def test_what_is_not_finite_or_not_there_leaves_the_body_as_it_was(plate_rom, tmp_path):
    body = Body(fr.export(replace(plate_rom, name="*/ int x; /* ??/ \\"), tmp_path / "plant.c"), "double")
    assert body.step([0.1] * 6) == 0
    before = bytes(body.state)
    for wrong in (np.nan, np.inf, 1e200):
        assert body.step([0.0, wrong]) == -1
    assert body.switch(2) == body.switch(-1) == -1
    assert bytes(body.state) == before
    assert body.contacts == ["tip_left", "middle"]


def linearised(kind, plate_rom):
    """ROMs whose code is that of state spaces, and a state of some way on."""
    if kind == "relaxing":
        series = PronySeries((0.5,), (0.05,))
        return replace(plate_rom, environment=replace(plate_rom.environment, viscoelasticity=series)), None
    if kind == "still":
        return replace(plate_rom, environment=replace(plate_rom.environment, has_inertia=False)), None
    body = fr.Simulator(soft_rom(contact=True, order=6), 5e-3)
    for _ in range(20):
        body.step([0.0, 0.0, -0.02, 10.0, 0.05])
    return body.rom, body.save()


class StateSpaceBody:
    """A body in C that is a state space; names as in its header."""

    def __init__(self, source):
        library = source.with_name("linear.so")
        subprocess.run(["cc", *FLAGS, "-shared", "-fPIC", source, "-o", library], check=True)
        states = int(source.with_suffix(".h").read_text().split("_STATES ")[1].split()[0])
        self.code = ctypes.CDLL(library)

        class State(ctypes.Structure):
            _fields_ = (("contact", ctypes.c_int), ("x", ctypes.c_double * states))

        self.state = State()
        self.code.plant_init(ctypes.byref(self.state))

    def step(self, u):
        return self.code.plant_step(ctypes.byref(self.state), (ctypes.c_double * len(u))(*u))

    def outputs(self, count):
        y = (ctypes.c_double * count)()
        self.code.plant_outputs(ctypes.byref(self.state), y)
        return np.array(y)


@pytest.mark.parametrize("kind", ["relaxing", "still", "large"])
def test_code_of_state_spaces_takes_their_steps(kind, plate_rom, tmp_path):
    """Through switches, where there are any; it begins where the body was linearised."""
    rom, at = linearised(kind, plate_rom)
    h = 5e-3 if kind == "large" else 1e-3
    body = StateSpaceBody(fr.export(rom, tmp_path / "plant.c", dt=h, at=at))
    contacts = list(rom.contact_models) if at is None else [at.contact]
    plants = [rom.state_space(contact, dt=h, at=at) for contact in contacts]
    columns = len(plants[0].inputs) if at is not None else sum(rom.contacts.values())
    random, mode, plant = np.random.default_rng(0), 0, plants[0]
    point = plant.about or (*(np.zeros(n) for n in (len(plant.A), columns, len(plant.A), len(plant.C))),)
    x = np.array(point[0])
    for step in range(30):
        if at is None and step in (10, 20):
            x, mode = rom.switch_map(contacts[mode], contacts[1 - mode]) @ x, 1 - mode
            assert body.code.plant_switch(ctypes.byref(body.state), mode) == 0
        u = 1e-3 * random.standard_normal(columns)
        own = u if at is not None else np.split(u, len(contacts))[mode]
        plant, acting = plants[mode], np.array(point[1]) if at is not None else 0.0
        assert body.step(u) == 0
        x = point[2] + plant.A @ (x - point[0]) + plant.B @ (own - acting)
        shown = point[3] + plant.C @ (x - point[0])
        assert np.abs(body.outputs(len(shown)) - shown).max() <= 1e-12 * np.abs(shown).max()
    assert body.step(np.full(columns, np.nan)) == -1
    np.testing.assert_array_equal(body.outputs(len(shown)), body.outputs(len(shown)))
    assert body.code.plant_switch(ctypes.byref(body.state), len(contacts)) == -1


def test_what_c_cannot_do_is_refused(plate_rom, tmp_path):
    for name in ("2nd.c", "my-plant.c", "ä.c"):
        with pytest.raises(FileError, match="becomes a name in C: use letters, digits and _"):
            fr.export(plate_rom, tmp_path / name)
    with pytest.raises(StepError, match="dt = -1"):
        fr.export(plate_rom, tmp_path / "plant.c", dt=-1.0)
    without = replace(plate_rom, environment=replace(plate_rom.environment, run=None))
    with pytest.raises(FileError, match="the scene has no run, so that a time step is missing: --dt, in s"):
        fr.export(without, tmp_path / "plant.c")
    (tmp_path / "plant.h").mkdir()
    with pytest.raises(FileError, match="cannot be written: it is a folder"):
        fr.export(plate_rom, tmp_path / "plant.c")
    assert [path.name for path in tmp_path.iterdir()] == ["plant.h"]
