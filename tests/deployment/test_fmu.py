"""FMUs: what the standard asks of the description, and the simulator's own steps from the compiled code."""

import ctypes
import subprocess
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
from linear_roms import LOAD_VALUES, linear_rom, ride
from test_c_source import FLAGS, all_inputs, linearised

import fenics_rom as fr
from fenics_rom.errors import FileError, MissingPackageError

AGREES_TO = 1e-12  # relative, over 1,000 steps
H, STEPS = 1e-3, 1000
OK, ERROR = 0, 3


@pytest.fixture(scope="module")
def rom(request):
    """With dense damping, actuators, gravity and two contact modes."""
    return linear_rom("acted on", request)


@pytest.fixture(scope="module")
def folder(rom, tmp_path_factory):
    """What is in the FMU."""
    place = tmp_path_factory.mktemp("fmu")
    with zipfile.ZipFile(fr.export(rom, place / "plant.fmu", dt=H)) as archive:
        archive.extractall(place)
    return place


@pytest.fixture(scope="module")
def description(folder):
    return ET.parse(folder / "modelDescription.xml").getroot()


class Unit:
    """An instance, asked as a master does; what it logged is in `said`."""

    def __init__(self, folder, description, guid=None):
        log = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
        c = ctypes.CDLL(None)
        self.said = []
        self._log = log(lambda environment, name, status, category, message: self.said.append(message.decode()))
        addresses = (ctypes.cast(function, ctypes.c_void_p) for function in (self._log, c.calloc, c.free))
        self._callbacks = (ctypes.c_void_p * 5)(*addresses, None, None)
        self._code = ctypes.CDLL(folder / "binaries" / "linux64" / "plant.so")
        self._code.fmi2Instantiate.restype = ctypes.c_void_p
        guid = (guid or description.get("guid")).encode()
        component = self._code.fmi2Instantiate(b"body", 1, guid, b"", self._callbacks, 0, 0)
        self.component = component and ctypes.c_void_p(component)
        variables = enumerate(description.iter("ScalarVariable"))
        self.reals = {v.get("name"): int(v.get("valueReference")) for _, v in variables if v.find("Real") is not None}

    def __call__(self, name, *arguments):
        return getattr(self._code, f"fmi2{name}")(self.component, *arguments)

    def set_reals(self, values):
        size = len(values)
        return self(
            "SetReal", (ctypes.c_uint * size)(*range(size)), ctypes.c_size_t(size), (ctypes.c_double * size)(*values)
        )

    def get_reals(self):
        values, size = (ctypes.c_double * len(self.reals))(), len(self.reals)
        assert self("GetReal", (ctypes.c_uint * size)(*self.reals.values()), ctypes.c_size_t(size), values) == OK
        return np.array(values)

    def set_contact(self, number):
        return self("SetInteger", (ctypes.c_uint * 1)(0), ctypes.c_size_t(1), (ctypes.c_int * 1)(number))

    def get_contact(self):
        number = (ctypes.c_int * 1)()
        assert self("GetInteger", (ctypes.c_uint * 1)(0), ctypes.c_size_t(1), number) == OK
        return number[0]

    def step(self, h=H):
        return self("DoStep", ctypes.c_double(0.0), ctypes.c_double(h), 1)


def wanted(rom):
    """Inputs, contact modes, and what the FMU is to read after each step of a ride."""
    given, modes, read = [], [], []
    for body, u, displacements in ride(rom, H, STEPS):
        ledger = body.ledger
        given.append(all_inputs(rom, body.contact, u))
        modes.append(1 + list(rom.contact_models).index(body.contact))
        works = body.energy, ledger.supplied, ledger.dissipated, ledger.lost_in_switching
        read.append([*displacements, *works])
    return np.array(given), np.array(modes), np.array(read)


def assert_same(found, expected):
    scale = np.abs(expected).max(axis=0)
    scale[-4:] = scale[-4:].max()  # energies and works make one account
    assert np.abs(found - expected).max(axis=0) / scale == pytest.approx(0, abs=AGREES_TO)


def test_compiled_code_takes_the_steps_of_the_simulator(rom, folder, description):
    unit, (given, modes, expected) = Unit(folder, description), wanted(rom)
    read = []
    for u, mode in zip(given, modes, strict=True):
        assert unit.set_reals(u) == unit.set_contact(mode) == unit.step() == OK
        assert unit.get_contact() == mode
        read.append(unit.get_reals()[len(u) :])
    assert_same(np.array(read), expected)
    assert not unit.said


def test_communication_steps_are_those_of_a_clock_that_rounds(folder, description):
    unit, clock = Unit(folder, description), H * np.arange(20)
    steps = np.diff(clock)
    assert min(steps) < H < max(steps)
    assert [unit.step(h) for h in steps] == [OK] * len(steps)
    other = Unit(folder, description)
    assert other.step(clock[-1]) == OK
    np.testing.assert_array_equal(other.get_reals(), unit.get_reals())


def test_communication_steps_of_any_length_are_whole_steps_and_a_shorter_one(rom, folder, description):
    """As a simulator takes them, whose step is set before each; with an account that closes to round-off."""
    assert description.find("CoSimulation").get("canHandleVariableCommunicationStepSize") == "true"
    random, names = np.random.default_rng(1), list(rom.contact_models)
    unit, body = Unit(folder, description), fr.Simulator(rom, H, signals=LOAD_VALUES)
    found, expected = [], []
    for step in range(200):
        contact = names[step // 7 % len(names)]
        body.switch(contact)
        u = 0.1 * random.standard_normal(body.inputs)
        duration = H * 10 ** random.uniform(-3, 0.7)
        assert (
            unit.set_reals(all_inputs(rom, contact, np.array([*u, *(LOAD_VALUES[name] for name in rom.loads)]))) == OK
        )
        assert unit.set_contact(1 + names.index(contact)) == unit.step(duration) == OK
        whole = int(duration / H)
        for h in [H] * whole + [duration - whole * H]:
            body.dt = h
            body.step(u)
        works = body.energy, body.ledger.supplied, body.ledger.dissipated, body.ledger.lost_in_switching
        expected.append([*np.concatenate([body.displacement(name).ravel() for name in rom.outputs]), *works])
        found.append(unit.get_reals()[-len(expected[-1]) :])
    assert_same(np.array(found), np.array(expected))
    stored, supplied, dissipated, lost = np.array(found)[:, -4:].T
    assert np.abs(stored - (supplied - dissipated - lost)).max() <= AGREES_TO * np.abs(supplied).max()


def test_a_unit_that_is_linearised_begins_there_and_takes_whole_steps(plate_rom, tmp_path):
    rom, at = linearised("large", plate_rom)
    plant = rom.state_space(at.contact, dt=5e-3, at=at)
    with zipfile.ZipFile(fr.export(rom, tmp_path / "plant.fmu", dt=5e-3, at=at)) as archive:
        archive.extractall(tmp_path)
    description = ET.parse(tmp_path / "modelDescription.xml").getroot()
    assert "canHandleVariableCommunicationStepSize" not in description.find("CoSimulation").attrib
    unit = Unit(tmp_path, description)
    assert list(unit.reals) == [*plant.inputs, *plant.outputs]
    about, u = plant.about, plant.about.input + np.array([0.0, 0.0, 1e-3, 1.0, 1e-3])
    np.testing.assert_array_equal(unit.get_reals(), [*about.input, *about.output])
    assert unit.set_reals(u) == unit.step(1e-2) == OK
    x = about.after + plant.B @ (u - about.input)
    x = about.after + plant.A @ (x - about.state) + plant.B @ (u - about.input)
    expected = about.output + plant.C @ (x - about.state)
    assert np.abs(unit.get_reals()[len(u) :] - expected).max() <= AGREES_TO * np.abs(expected).max()
    assert unit.step(2e-3) == ERROR
    assert unit.said == ["a communication step must be a whole number of steps of 0.005 s"]


def test_states_are_saved_and_a_communication_step_is_many_steps(rom, folder, description):
    unit, other, saved = Unit(folder, description), Unit(folder, description), ctypes.c_void_p()
    for each in (unit, other):
        assert each.set_reals([0.1] * 3) == each.step() == OK
    assert unit("GetFMUstate", ctypes.byref(saved)) == OK
    size = ctypes.c_size_t()
    assert unit("SerializedFMUstateSize", saved, ctypes.byref(size)) == OK
    text, revived = (ctypes.c_byte * size.value)(), ctypes.c_void_p()
    assert unit("SerializeFMUstate", saved, text, size) == OK
    assert other("DeSerializeFMUstate", text, size, ctypes.byref(revived)) == OK
    assert unit.step(5 * H) == OK
    later = unit.get_reals()
    for each, state in ((unit, saved), (other, revived)):
        assert each("SetFMUstate", state) == OK
        assert [each.step() for _ in range(5)] == [OK] * 5
        np.testing.assert_array_equal(each.get_reals(), later)
        assert each("FreeFMUstate", ctypes.byref(state)) == each("Reset") == OK
        start = each.get_reals()
        assert start[each.reals["gravity"]] == 1.0
        assert not np.delete(start, each.reals["gravity"]).any()
        each("FreeInstance")


def test_unit_refuses_what_it_cannot_do(folder, description):
    assert Unit(folder, description, "{another}").component is None
    unit = Unit(folder, description)
    assert unit.set_reals([0.1] * 3) == OK
    before = unit.get_reals()
    assert unit.step(-H) == unit.step(np.nan) == unit.step(1.0e9) == ERROR
    assert unit.said == ["a communication step must be from 0 to 1e9 steps of 0.001 s"] * 3
    assert unit.set_contact(0) == unit.set_contact(3) == unit.set_reals([0.1] * 50) == ERROR
    np.testing.assert_array_equal(unit.get_reals()[10:], before[10:])
    assert unit.set_reals([np.nan]) == OK
    assert unit.step() == ERROR
    assert unit.said[-1] == "an input is not a finite number, or leads to none"


def test_description_keeps_the_rules_of_the_standard(rom, folder, description):
    """As FMI 2.0.4 says in words beyond its schema, sections 2.2.1 to 2.2.8."""
    order = [
        "CoSimulation",
        "UnitDefinitions",
        "TypeDefinitions",
        "DefaultExperiment",
        "ModelVariables",
        "ModelStructure",
    ]
    assert [part.tag for part in description] == order
    variables = list(description.iter("ScalarVariable"))
    assert len({v.get("name") for v in variables}) == len(variables)
    assert len({(v[0].tag == "Real", v.get("valueReference")) for v in variables}) == len(variables)
    units = {unit.get("name") for unit in description.iter("Unit")}
    for v in variables:
        assert v[0].tag == "Enumeration" or v[0].get("unit") in units
        assert (v[0].get("start") is not None) == (v.get("causality") == "input")
    reads = [str(k) for k, v in enumerate(variables, start=1) if v.get("causality") == "output"]
    for unknowns in description.find("ModelStructure"):
        assert [unknown.get("index") for unknown in unknowns] == reads
    items = {item.get("name"): item.get("value") for item in description.iter("Item")}
    assert items == {name: str(k) for k, name in enumerate(rom.contact_models, start=1)}
    name = description.find("CoSimulation").get("modelIdentifier")
    assert (folder / "binaries" / "linux64" / f"{name}.so").is_file()
    sources = [folder / "sources" / file.get("name") for file in description.iter("File")]
    subprocess.run(["cc", *FLAGS, "-fPIC", "-shared", *sources, "-o", folder / "again.so"], check=True)


def test_fmpy_simulates_it(rom, folder):
    """Under the inputs of a ride, by its slave; and under gravity alone, by all of it."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave
    from fmpy.validation import validate_fmu

    file = str(folder / "plant.fmu")
    assert validate_fmu(file) == []
    body, (given, modes, expected) = fmpy.read_model_description(file), wanted(rom)
    names = {"unzipDirectory": str(folder), "modelIdentifier": body.coSimulation.modelIdentifier}
    slave = FMU2Slave(guid=body.guid, instanceName="body", **names)
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    reads, read = [v.valueReference for v in body.modelVariables if v.causality == "output"], []
    for step, (u, mode) in enumerate(zip(given, modes, strict=True)):
        slave.setReal(range(len(u)), u)
        slave.setInteger([0], [mode])
        slave.doStep(step * H, H)
        read.append(slave.getReal(reads))
    slave.terminate()
    slave.freeInstance()
    assert_same(np.array(read), expected)
    result = fmpy.simulate_fmu(file, stop_time=0.1, output_interval=H)
    falling = fr.Simulator(rom, H, signals={"quake": 0.0})
    for row in range(101):
        found = [result[f"tip[{point},{axis}]"][row] for point in (0, 1) for axis in range(3)]
        assert found == pytest.approx(falling.displacement("tip").ravel(), rel=1e-9, abs=1e-15)
        falling.step(np.zeros(falling.inputs))


def test_no_compiler_and_names_are_told(plate_rom, tmp_path, monkeypatch):
    with pytest.raises(FileError, match="'my-plant' becomes a name in C"):
        fr.export(plate_rom, tmp_path / "my-plant.fmu")
    monkeypatch.setenv("CC", "no-such-compiler -m32")
    with pytest.raises(
        MissingPackageError, match=r"no C compiler 'no-such-compiler': .*apt-get install gcc; .*plant\.c needs none"
    ):
        fr.export(plate_rom, tmp_path / "plant.fmu")
    monkeypatch.setenv("CC", "false")
    with pytest.raises(FileError, match="false does not compile it"):
        fr.export(plate_rom, tmp_path / "plant.fmu")
    assert not any(tmp_path.iterdir())
