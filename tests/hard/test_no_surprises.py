"""Files run no code, nothing goes over a network, nothing is written elsewhere, and nothing is left to chance."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import kills
import numpy as np
import pytest
import releases
from rom_files import transfer

import fenics_rom as fr

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
PACKAGE = Path(fr.__file__).parent
DATA = Path(__file__).parents[1] / "data"
RUN_CODE = {"eval", "exec", "compile", "__import__", "system", "popen", "import_module", "run_path", "run_module"}
MODULES = {
    *("pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle", "yaml", "runpy", "code", "subprocess", "pty"),
    *("multiprocessing", "socket", "ssl", "urllib", "http", "ftplib", "smtplib", "telnetlib", "xmlrpc", "requests"),
    *("asyncio", "webbrowser"),
}
STARTED = {  # scripts and commands of this package, in processes of their own, and a compiler for what it wrote
    PACKAGE / "scene" / "foreign_file.py": "[sys.executable, '-P', foreign_process.__file__, file, *words]",
    PACKAGE / "deployment" / "fmu.py": "[*compiler, *FLAGS, *files, '-o', 'library']",
}
PICKLES = {  # in code that numba compiled for this package, and keeps where its own pickles are
    PACKAGE / "compiled_calls.py": ["pickle.dumps((name, kinds))", "pickle.loads(string_at(text, length))"]
}
IMPORTS = {  # modules that the package names itself, when they are asked for
    PACKAGE / "compiled_calls.py",
    PACKAGE / "lazy_import.py",
    PACKAGE / "rom" / "linearizer.py",
    PACKAGE / "system" / "backends.py",
    PACKAGE / "zoo_bodies.py",
    PACKAGE / "visualization" / "optional_dependencies.py",
}
VIEWER = PACKAGE / "visualization" / "viewer"
SERVES = {VIEWER / "view.py", VIEWER / "server.py"}  # the live view, on this machine alone
SERVING = {"http", "socket", "webbrowser"}
UNPICKLES = {"load", "fromfile", "loadtxt", "genfromtxt"}  # of NumPy
MEASURED = ("settings/seconds", "offline/", "profile/")  # wall clocks and memory: all that differs between two runs
WATCHED = """
import os, sys
def hook(event, arguments):
    if event.startswith(("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostby", "urllib")):
        told("network", arguments)
    elif event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "pickle.find_class", "pty.spawn"):
        told(event, arguments[0])
    elif event == "open" and isinstance(arguments[0], str | bytes):
        mode, flags = arguments[1] or "", arguments[2]
        if set("wax+") & set(mode) or flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            told("write", os.path.abspath(os.fsdecode(arguments[0])))
    elif event in ("os.mkdir", "os.rename", "os.remove", "os.link", "os.symlink", "os.truncate", "os.chmod"):
        folder = f"/proc/self/fd/{arguments[-1]}" if event in ("os.mkdir", "os.remove") and arguments[-1] >= 0 else "."
        place = os.path.join(os.path.realpath(folder), os.fsdecode(arguments[1 if event == "os.rename" else 0]))
        told("write", os.path.abspath(place))
def told(what, about):
    os.write(3, f"{what}\\t{about}\\n".encode())
sys.addaudithook(hook)
from fenics_rom.cli.main import main
main()
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    kills.prepare(folder)
    return folder


@pytest.fixture
def inside(inputs, tmp_path):
    """A folder with the inputs, and a home and a place for temporary files beside it."""
    for name in ("home/.cache", "tmp"):
        (tmp_path / name).mkdir(parents=True)
    cache = Path.home() / ".cache" / "fenics"  # of compiled forms
    cache.mkdir(parents=True, exist_ok=True)
    (tmp_path / "home" / ".cache" / "fenics").symlink_to(cache)
    return Path(shutil.copytree(inputs, tmp_path / "work"))


def environment_of(folder, **more):
    return kills.ENVIRONMENT | {
        "HOME": str(folder.parent / "home"),
        "TMPDIR": str(folder.parent / "tmp"),
        "OMP_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        **more,
    }


def done(command, folder, *before, **more):
    """Runs a command to its good end."""
    line = [*before, sys.executable, "-m", "fenics_rom", *command.words]
    ended = subprocess.run(line, cwd=folder, env=environment_of(folder, **more), capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert not re.sub(r"(?m)^\d+ s: .*\n", "", ended.stderr)  # but how far it is, on a busy machine
    return folder / command.output


def names(tree):
    """Modules that are imported, and what is called, in a syntax tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node, node.module
        elif isinstance(node, ast.Call):
            yield node, f"{ast.unparse(node.func)}()"


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda file: str(file.relative_to(PACKAGE)))
def test_no_file_can_run_code(file):
    """Scenes are TOML, tables CSV, the rest arrays: the package has nothing that could run what it reads."""
    for node, name in names(ast.parse(file.read_text())):
        called = name.removesuffix("()")
        last = called.split(".")[-1]
        if file in STARTED and name.split(".")[0] == "subprocess":
            if called == "subprocess.run":
                assert ast.unparse(node.args[0]) == STARTED[file]
                assert "shell" not in {keyword.arg for keyword in node.keywords}
            continue
        if file in SERVES and name.split(".")[0] in SERVING:
            continue
        if file in PICKLES and name.split(".")[0] == "pickle":
            assert name == "pickle" or ast.unparse(node) in PICKLES[file]
            continue
        assert name.split(".")[0] not in MODULES, (node.lineno, name)
        if name.endswith("()"):
            imports = last == "import_module" and file in IMPORTS
            harmless = called.startswith(("re.", "dispatcher.", "spec."))  # that of MuJoCo compiles a model
            assert imports or last not in RUN_CODE or harmless, (node.lineno, name)
            if not any(ast.unparse(keyword) == "allow_pickle=False" for keyword in node.keywords):
                assert not (last in UNPICKLES and called.startswith(("np.", "numpy."))) or called == "np.fromfile", name


@pytest.mark.parametrize(
    "name",
    [
        *("reduce", "simulate-full", "simulate"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("study", "identify")),
    ],
)
def test_commands_write_their_output_and_nothing_else(inside, name):
    """Beside it: names of temporary files in its own folder, compiled forms, and Matplotlib's list of fonts."""
    command = kills.COMMANDS[name]
    before = set(inside.rglob("*"))
    told, write = os.pipe()
    code = f"import os; os.dup2({write}, 3)\n" + WATCHED
    with subprocess.Popen(
        [sys.executable, "-c", code, *command.words],
        cwd=inside,
        env=environment_of(inside),
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        os.close(write)
        with os.fdopen(told) as stream:
            events = [line.rstrip("\n").split("\t") for line in stream]
        assert run.stderr is not None
        assert run.stderr.read() == ""
    assert run.returncode == 0
    assert [event for event in events if event[0] == "network"] == []
    home, place = inside.parent / "home", inside / command.output
    caches = [home / ".cache" / "fenics", home / ".cache" / "matplotlib", home / ".config" / "matplotlib"]
    for what, about in events:
        if what == "pickle.find_class":  # what rank 0 tells the others
            assert about.split(".")[0] in ("fenics_rom", "numpy", "builtins", "pathlib", "_codecs"), about
            continue
        if what != "write":
            assert what in ("subprocess.Popen", "os.posix_spawn"), (
                what,
                about,
            )  # compilers of forms, and Matplotlib's search for fonts
            continue
        path = Path(about)
        beside = path.parent == place.parent and path.name.startswith(f".{place.name}.")
        partial = Path(f"{place}.partial")
        allowed = [place, partial, *caches, Path("/dev"), Path("/proc")]
        allowed += [] if name == "simulate" else [inside.parent / "tmp"]
        made = any(cache.is_relative_to(path) for cache in caches)  # a folder on the way to a cache
        assert made or beside or any(path.is_relative_to(one) for one in allowed), about
    left = set(inside.rglob("*")) - before
    assert all(file == place or file.is_relative_to(place) for file in left)
    found = {file.relative_to(home) for file in home.rglob("*") if file.is_file()}
    told_of = {".cache/matplotlib", ".config/matplotlib", ".cache/fenics"}
    assert {str(Path(*file.parts[:2])) for file in found} <= told_of


ALONE = ("unshare", "-n", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")  # MPI wants a loopback


def may_be_alone():
    return bool(shutil.which("unshare")) and subprocess.run([*ALONE, "true"], capture_output=True).returncode == 0


@pytest.mark.skipif(not may_be_alone(), reason="takes root, and iproute2")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["reduce", "simulate-full", "simulate"])
def test_commands_need_no_network(inside, name):
    done(kills.COMMANDS[name], inside, *ALONE)


def content(file):
    """All arrays and texts of a file."""
    found = {}
    with h5py.File(file) as h5:
        found.update({f"@{key}": b"" if isinstance(text, h5py.Empty) else text for key, text in h5.attrs.items()})
        h5.visititems(lambda name, one: found.update({name: one[()]}) if isinstance(one, h5py.Dataset) else None)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reduce", "simulate-full", "simulate"])
def test_the_same_command_writes_the_same_bits(inside, name):
    first = content(done(kills.COMMANDS[name], inside))
    second = content(done(kills.COMMANDS[name], inside))
    assert first.keys() == second.keys()
    differ = [key for key in first if np.asarray(first[key]).tobytes() != np.asarray(second[key]).tobytes()]
    assert [key for key in differ if not key.startswith(MEASURED)] == []


def same_models(one, other, tolerance):
    """σ, and frequency responses, of two ROMs."""
    assert list(one.contact_models) == list(other.contact_models)
    for name, mode in other.contact_models.items():
        σ = mode.hankel_singular_values[: mode.order]
        gap = np.abs(one.contact_models[name].hankel_singular_values[: mode.order] - σ).max()
        assert gap <= tolerance * σ[0]
        H = transfer(other, name)
        assert np.abs(transfer(one, name) - H).max() <= tolerance * np.abs(H).max()


@pytest.mark.slow
def test_threads_change_round_off_alone(inside):
    rom = kills.COMMANDS["reduce"]
    one, two = (fr.read_rom(done(rom, inside, OMP_NUM_THREADS=n, OPENBLAS_NUM_THREADS=n)) for n in ("1", "2"))
    same_models(two, one, 1e-8)
    (inside / rom.output).unlink()  # a run is not written over a ROM
    full = kills.COMMANDS["simulate-full"]
    one, two = (fr.read_trajectory(done(full, inside, OMP_NUM_THREADS=n, OPENBLAS_NUM_THREADS=n)) for n in ("1", "2"))
    assert np.abs(one.snapshots - two.snapshots).max() <= 1e-8 * np.abs(one.snapshots).max()


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """The system of the files of both releases, assembled on this one."""
    return releases.system(tmp_path_factory.mktemp("release"))


@pytest.mark.parametrize("release", ["debian12", "debian13"])
def test_files_of_either_release_give_the_same_numbers_on_this_one(here, release):
    rom, run = fr.read_rom(DATA / f"rom-{release}.h5"), fr.read_trajectory(DATA / f"run-{release}.h5")
    same_models(fr.reduce(here), rom, 1e-8)
    full, reduced = fr.simulate(here), [fr.simulate(one) for one in (rom, fr.reduce(here))]
    for one, other in ((full, run), reduced):
        assert one.contacts == other.contacts
        np.testing.assert_array_equal(one.contact, other.contact)
        for mine, theirs in (
            (one.snapshots, other.snapshots),
            (one.outputs["tip"], other.outputs["tip"]),
            (one.energy, other.energy),
            (one.supplied, other.supplied),
        ):
            assert np.abs(mine - theirs).max() <= 1e-8 * np.abs(theirs).max()
    assert fr.compare(reduced[0], run)["shape"].relative < 0.1
