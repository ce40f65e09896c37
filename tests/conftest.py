"""The options --all and --short; models that many tests read and none changes, assembled once."""

import gc
import runpy
import sys
import warnings
from collections import Counter

import pytest
import stand_ins
from bodies import PLATE, scene_text, write_box
from hypothesis import HealthCheck, settings

import fenics_rom as fr
from fenics_rom import compilation
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.scene.file import parse_scene

settings.register_profile("any machine", suppress_health_check=[HealthCheck.too_slow])  # one that is busy, too
settings.load_profile("any machine")
pytest.MonkeyPatch.setattr = stand_ins.watch(pytest.MonkeyPatch.setattr)
LAWS = ("mechanics", "runtime", "world")  # folders of tests whose cases differ in numbers and bodies, not in libraries


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run the slow tests, too")
    parser.addoption("--short", action="store_true", help="run the last case of each test alone")
    parser.addoption(
        "--elsewhere", action="store_true", help=f"the same, and of each file in {', '.join(LAWS)} the last test alone"
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Collects the tests without a search for garbage among them, which would take half of the time, now and later."""
    gc.disable()
    collected = yield
    gc.collect()
    gc.freeze()
    gc.enable()
    return collected


def pytest_collection_modifyitems(config, items):
    slow, count = {item for item in items if item.get_closest_marker("slow")}, Counter(item.path for item in items)
    if not config.getoption("--all"):
        for item in slow:
            item.add_marker(pytest.mark.skip(reason="slow: run with --all"))
    elsewhere = config.getoption("--elsewhere")
    if elsewhere or config.getoption("--short"):

        def of(item):
            """What one is run of."""
            return item.path if elsewhere and item.path.parent.name in LAWS else item.nodeid.partition("[")[0]

        last = {of(item): item for item in items if item not in slow}
        left_out = {item for item in items if item is not last.get(of(item))}
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=list(left_out))
    # Files that take long or compile, and then those of many tests: at the end no core is to wait long for another one.
    long = {item.path for item in slow} | {path for path in count if path.name.startswith("test_compil")}
    items.sort(key=lambda item: (item.path not in long, -count[item.path]))


@pytest.fixture(scope="session")
def zoo_folder(tmp_path_factory):
    """The package of a zoo that has the plate alone, made as `zoo/build.py` makes it."""
    make = runpy.run_path(str(PLATE.parents[2] / "zoo" / "build.py"))["make"]
    folder = tmp_path_factory.mktemp("zoo") / "fenics_rom_zoo"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)  # the plate locks
        assert make(["plate"], folder) == []
    return folder


@pytest.fixture
def small_zoo(zoo_folder, monkeypatch):
    """That package, where Python finds it."""
    monkeypatch.syspath_prepend(zoo_folder.parent)
    monkeypatch.delitem(sys.modules, "fenics_rom_zoo", raising=False)
    yield zoo_folder
    sys.modules.pop("fenics_rom_zoo", None)


@pytest.fixture(scope="session", autouse=True)
def _gmsh_in_this_process():
    # Not above: fenics_rom.fem starts MPI, which the processes that this one starts to run tests would inherit.
    from gmsh_here import arrays_found_here

    from fenics_rom.scene import foreign_file

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(foreign_file, "read_arrays", arrays_found_here)
        yield


@pytest.fixture
def numpy_alone():
    """Nothing runs compiled, whatever is installed: of what is done for NumPy's sake."""
    with compilation.numpy_alone():
        yield


@pytest.fixture(scope="session")
def plate_system():
    """The paper's plate, n = 180."""
    return fr.assemble(fr.read_scene(PLATE))


@pytest.fixture(scope="session")
def plate_rom(plate_system):
    """The plate at order 20."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(plate_system, order=20)


@pytest.fixture(scope="session")
def box_file(tmp_path_factory):
    """A thick box: its γ span four decades only, so that round-off hides nothing."""
    return write_box(tmp_path_factory.mktemp("box") / "box.msh", (1.0, 0.4, 0.3), (4, 2, 2))


@pytest.fixture(scope="session")
def box_system(box_file):
    """The box, n = 108, with an actuator."""
    text = scene_text(box_file, **{"actuators.pull": 'surface = "back"\nforce = "normal"'})
    return fr.assemble(parse_scene(text))


@pytest.fixture(scope="module")
def viser_server():
    """What pages of the live view draw on."""
    from fenics_rom.visualization.viewer.server import Server  # here, as few tests draw

    server = Server(0)
    yield server.viser
    server.stop()
