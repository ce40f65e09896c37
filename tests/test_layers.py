"""What may import what: the runtime runs where there is no FEniCSx, and each folder stands on those below it alone."""

import ast
import os
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

import fenics_rom
from fenics_rom.compilation import VARIABLE

PACKAGE = Path(fenics_rom.__file__).parent
DATA = Path(__file__).parent / "data"
RUNTIME = [file.relative_to(PACKAGE).with_suffix("").parts for file in sorted((PACKAGE / "runtime").rglob("*.py"))]
FENICSX = {"dolfinx", "dolfinx_solver", "petsc4py", "slepc4py", "mpi4py", "ufl", "basix", "gmsh", "ffcx", "cffi"}
NOT_IN_THE_RUNTIME = FENICSX | {"scipy", "matplotlib", "rich", "viser", "pyvista", "imageio"}
NOT_ON_WINDOWS = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}

# Folders, and files outside any, from the bottom to the top: what each may import of the package, anywhere in a file,
# and which packages of others. FACE is `import fenics_rom` itself, which loads what is asked for.
FACE = "__init__"
GROUND = {"errors", "arguments", "version", "compilation", "compiled_arrays", "compiled_products", "io", "mechanics"}
DATA_OF_A_RUN = GROUND | {"rom", "trajectory"}
OFFLINE = GROUND | {"scene", "system"}
BELOW_APPLICATIONS = (
    DATA_OF_A_RUN
    | OFFLINE
    | {FACE, "fem", "reduction", "runtime", "world", "robots", "world_run", "run", "lazy_import"}
)
DRAWING = {
    "numpy",
    "matplotlib",
    "mpl_toolkits",
    "cycler",
    "pyvista",
    "imageio",
    "PIL",
    "viser",
    "trimesh",
    "websockets",
}
MAY_IMPORT = {
    "errors": (set(), set()),
    "version": (set(), set()),
    "arguments": ({"errors"}, set()),
    "lazy_import": ({"errors"}, set()),
    "compiled_calls": (set(), {"numba", "llvmlite"}),
    "compilation": ({"errors", "compiled_calls"}, {"numpy", "numba"}),
    "compiled_arrays": ({"compilation"}, {"numpy", "numba"}),
    "compiled_products": ({"compilation"}, {"numpy", "numba", "llvmlite"}),
    "io": ({"errors", "arguments", "version"}, {"numpy", "h5py"}),
    "mechanics": ({"errors", "arguments", "compilation", "compiled_arrays", "compiled_products"}, {"numpy"}),
    "scene": (GROUND | {"trajectory"}, {"numpy", "pydantic", "pydantic_core", "gmsh", "pytetwild", "vtkmodules"}),
    "system": (GROUND | {"scene"}, {"numpy", "scipy"}),
    "rom": (GROUND, {"numpy", "h5py"}),
    "trajectory": (GROUND, {"numpy", "h5py"}),
    "fem": (OFFLINE | {"trajectory"}, FENICSX | {"numpy", "scipy", "h5py"}),
    "reduction": (OFFLINE | {"rom", "runtime"}, {"numpy", "scipy"}),
    "runtime": (DATA_OF_A_RUN, {"numpy", "h5py"}),
    "world": (DATA_OF_A_RUN | {"runtime"}, {"numpy", "h5py"}),
    "robots": (GROUND | {"rom", "world"}, {"numpy", "mujoco"}),
    "world_run": (DATA_OF_A_RUN | OFFLINE | {"world", "robots", "lazy_import"}, {"numpy"}),
    "run": (DATA_OF_A_RUN | OFFLINE | {"runtime", "lazy_import", "world_run"}, set()),
    "first_steps": (DATA_OF_A_RUN | OFFLINE | {"runtime", "lazy_import", "world_run"}, {"numpy"}),
    "zoo_bodies": (GROUND | {"rom"}, set()),
    "deployment": (GROUND | {"rom"}, {"numpy", "scipy"}),
    "visualization": (BELOW_APPLICATIONS | {"deployment"}, DRAWING),
    "studies": (BELOW_APPLICATIONS | {"visualization"}, {"numpy", "matplotlib", "pydantic"}),
    "identification": (BELOW_APPLICATIONS | {"visualization"}, {"numpy", "scipy", "tomlkit"}),
    "certification": (BELOW_APPLICATIONS | {"visualization"}, {"numpy", "matplotlib"}),
    "cli": (
        BELOW_APPLICATIONS | {"visualization", "studies", "identification", "certification", "zoo_bodies"},
        {"numpy", "rich"},
    ),
    "__main__": ({"cli"}, set()),
}

REFUSE = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {NOT_IN_THE_RUNTIME | NOT_ON_WINDOWS}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuse())
"""
WITHOUT_PYDANTIC = REFUSE.replace("'scipy'", "'scipy', 'pydantic'")


def python(code, *arguments):
    environment = os.environ | {VARIABLE: "0"}  # numba, where it is, brings what it needs
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


def imports(file):
    """Absolute names of what a file imports anywhere, from-imports with the imported name at the end."""
    package = ".".join(["fenics_rom", *file.relative_to(PACKAGE).parent.parts])
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def part_of(name):
    """Folder, or file outside any, that a name of this package is in."""
    part = [*name.split("."), FACE][1]
    return part if part == FACE or (PACKAGE / part).is_dir() or (PACKAGE / f"{part}.py").is_file() else FACE


def files_of(part):
    return sorted((PACKAGE / part).rglob("*.py")) if (PACKAGE / part).is_dir() else [PACKAGE / f"{part}.py"]


@pytest.mark.parametrize(
    "modules",
    ["fenics_rom", ", ".join(["fenics_rom.rom.file", *(".".join(["fenics_rom", *parts]) for parts in RUNTIME)])],
)
def test_import_loads_nothing_but_numpy_and_h5py(modules):
    run = python(f"import sys, {modules}; print(*{{name.partition('.')[0] for name in sys.modules}})")
    assert run.returncode == 0, run.stderr
    assert "fenics_rom" in run.stdout.split()
    assert not (NOT_IN_THE_RUNTIME | {"pydantic", "pydantic_core", "tomlkit"}) & set(run.stdout.split())


def test_importing_the_package_alone_reads_no_file_format():
    run = python("import sys, fenics_rom; print('h5py' in sys.modules, 'fenics_rom.scene.scene' in sys.modules)")
    assert run.stdout.split() == ["False", "False"]


def test_reading_and_stepping_load_nothing_of_what_few_bodies_have(tmp_path):
    """What is loaded is waited for at every start of a program."""
    code = "import sys, fenics_rom, fenics_rom.runtime.simulator; fenics_rom.read_rom(sys.argv[1]); print(*sys.modules)"
    fenics_rom.write_rom(tmp_path / "rom.h5", fenics_rom.read_rom(DATA / "rom-1.0.h5"))  # in this release's format
    run = python(code, tmp_path / "rom.h5")
    assert run.returncode == 0, run.stderr
    mechanics = ("actuator_forces", "base_path", "complementarity", "contact", "frame_motion", "obstacles")
    few_need = {"fenics_rom.rom.format_1", "tomllib", *(f"fenics_rom.mechanics.{name}" for name in mechanics)}
    assert "fenics_rom.runtime.steppers.midpoint" in run.stdout.split()
    assert not few_need & set(run.stdout.split())


def test_every_file_has_its_layer():
    files = [*PACKAGE.glob("*.py"), *PACKAGE.glob("*/__init__.py")]
    parts = {file.relative_to(PACKAGE).with_suffix("").parts[0] for file in files}
    assert parts == {*MAY_IMPORT, FACE}


@pytest.mark.parametrize("part", MAY_IMPORT)
def test_imports_go_one_way(part):
    parts, packages = MAY_IMPORT[part]
    refused = []
    for file in files_of(part):
        for name in imports(file):
            if name.split(".")[0] == "fenics_rom":
                allowed = part_of(name) in parts | {part}
            else:
                allowed = name.split(".")[0] in packages | sys.stdlib_module_names
            if not allowed:
                refused.append(f"{file.relative_to(PACKAGE)} imports {name}")
    assert not refused, "\n".join(refused)


def test_files_do_not_import_one_another_in_circles():
    """Imports in functions and for types count; the face alone, which names everything, is left out."""
    modules = {}
    for file in PACKAGE.rglob("*.py"):
        name = ".".join(["fenics_rom", *file.relative_to(PACKAGE).with_suffix("").parts]).removesuffix(".__init__")
        modules[name] = file
    below = {}
    for module, file in modules.items():
        names = {name if name in modules else name.rpartition(".")[0] for name in imports(file)}
        below[module] = names & set(modules) - {"fenics_rom", module}
    del below["fenics_rom"]
    assert sum(map(len, below.values())) > 400  # the search finds something
    try:
        TopologicalSorter(below).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_runtime_works_without_any_of_the_rest(tmp_path):
    code = """
import fenics_rom as fr
rom = fr.read_rom(sys.argv[1])
body = fr.Simulator(rom, dt=1e-3)
for contact in ("right", "corner", "right"):
    body.switch(contact)
    body.step([1.0] * body.inputs)
assert body.displacement().shape == rom.nodes.shape and body.displacement("tip").any() and body.energy > 0
run = fr.simulate(fr.truncate(rom, 2))
fr.write_trajectory(sys.argv[2], run)
fr.write_rom(sys.argv[3], rom)
print(fr.compare(fr.read_trajectory(sys.argv[2]), run)["shape"].relative)
for name in "assemble", "reduce":
    try:
        getattr(fr, name)
    except fr.errors.MissingPackageError as error:
        print(error)
"""
    run = python(REFUSE + code, DATA / "rom-1.0.h5", tmp_path / "run.h5", tmp_path / "rom.h5")
    assert run.returncode == 0, run.stderr
    relative, assemble, reduce = run.stdout.splitlines()
    assert relative == "0.0"
    assert assemble.startswith("fenics_rom.assemble needs ")
    assert "apt-get install" in assemble
    assert "conda install" in assemble
    assert reduce == 'fenics_rom.reduce needs scipy, which this Python lacks: pip install "fenics-rom[offline]"'


def test_scenes_without_pydantic_say_how_to_get_it():
    code = "import fenics_rom as fr\ntry: fr.read_scene\nexcept fr.errors.MissingPackageError as error: print(error)"
    cure = 'which this Python lacks: pip install "fenics-rom[offline]"'
    assert python(WITHOUT_PYDANTIC + code).stdout == f"fenics_rom.read_scene needs pydantic, {cure}\n"


def test_command_line_without_rich_says_how_to_get_it_before_any_work(tmp_path):
    code = WITHOUT_PYDANTIC + "from fenics_rom.cli.main import main; main()"
    run = python(code, "simulate", DATA / "rom-1.0.h5", "-o", tmp_path / "run.h5")
    assert run.returncode == 1
    assert run.stderr == 'fenics-rom: error: the command line needs rich: pip install "fenics-rom[cli]"\n'
    assert not any(tmp_path.iterdir())


def test_no_file_is_too_long_to_be_read_at_once():
    lengths = {str(file.relative_to(PACKAGE)): len(file.read_text().splitlines()) for file in PACKAGE.rglob("*.py")}
    assert {file: length for file, length in lengths.items() if length > 400} == {}
