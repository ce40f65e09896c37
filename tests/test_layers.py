"""What may import what: the runtime runs where there is no FEniCSx, and each folder stands on those below it alone."""

import ast
import subprocess
import sys
from importlib.util import resolve_name
from pathlib import Path

import pytest

import fenics_rom

PACKAGE = Path(fenics_rom.__file__).parent
DATA = Path(__file__).parent / "data"
RUNTIME = sorted(file for file in (PACKAGE / "runtime").glob("*.py") if file.stem != "__init__")
FENICSX = {"dolfinx", "petsc4py", "slepc4py", "mpi4py", "ufl", "basix", "gmsh"}
NOT_IN_THE_RUNTIME = FENICSX | {"scipy", "matplotlib", "rich", "viser", "pyvista", "imageio"}
FOLDERS = {"accuracy", "fem", "reduction", "runtime", "identification"}

REFUSE = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {NOT_IN_THE_RUNTIME}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuse())
"""


def python(code, *arguments):
    return subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True)


def imports(file):
    """Absolute names of what a file imports anywhere, from-imports with the imported name at the end."""
    package = ".".join(["fenics_rom", *file.relative_to(PACKAGE).parent.parts])
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def imported(files):
    """Other packages, and folders of this package, that files import."""
    others, folders = set(), set()
    for file in files:
        for name in imports(file):
            first, second, *_ = [*name.split("."), ""]
            if first != "fenics_rom":
                others.add(first)
            elif second in FOLDERS:
                folders.add(second)
    return others - sys.stdlib_module_names, folders


@pytest.mark.parametrize(
    "modules",
    ["fenics_rom", ", ".join(["fenics_rom.rom.file", *(f"fenics_rom.runtime.{file.stem}" for file in RUNTIME)])],
)
def test_import_loads_nothing_but_numpy_and_h5py(modules):
    run = python(f"import sys, {modules}; print(*{{name.partition('.')[0] for name in sys.modules}})")
    assert run.returncode == 0, run.stderr
    assert "fenics_rom" in run.stdout.split()
    assert not (NOT_IN_THE_RUNTIME | {"pydantic", "pydantic_core", "tomlkit"}) & set(run.stdout.split())


def test_importing_the_package_alone_reads_no_file_format():
    run = python("import sys, fenics_rom; print('h5py' in sys.modules, 'fenics_rom.scene.scene' in sys.modules)")
    assert run.stdout.split() == ["False", "False"]


@pytest.mark.parametrize(
    ("folder", "packages", "folders"),
    [
        ("fem", FENICSX | {"numpy", "scipy"}, {"fem"}),
        ("reduction", {"numpy", "scipy"}, {"reduction", "runtime"}),
        ("runtime", {"numpy"}, {"runtime"}),
        ("identification", {"numpy", "scipy", "matplotlib", "tomlkit"}, {"identification", "fem", "reduction"}),
    ],
)
def test_folder_imports_only(folder, packages, folders):
    found, within = imported((PACKAGE / folder).rglob("*.py"))
    assert "numpy" in found  # the search finds something
    assert found <= packages
    assert within <= folders


def test_only_fem_imports_fenicsx():
    outside = [file for file in PACKAGE.rglob("*.py") if PACKAGE / "fem" not in file.parents]
    assert len(outside) > 20
    assert not imported(outside)[0] & FENICSX


def test_runtime_works_without_any_of_the_rest(tmp_path):
    code = """
import fenics_rom as fr
rom = fr.read_rom(sys.argv[1])
body = fr.Simulator(rom, dt=1e-3)
for contact in ("right", "corner", "right"):
    body.switch(contact)
    body.step([1.0] * body.inputs)
assert body.displacement().shape == rom.nodes.shape and body.displacement("tip").any() and body.energy > 0
run = fr.simulate(fr.truncated(rom, 2))
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
    assert reduce == "fenics_rom.reduce needs scipy, which this Python lacks: pip install fenics-rom[reduction]"


def test_scenes_without_pydantic_say_how_to_get_it():
    refuse = REFUSE.replace("'scipy'", "'pydantic'").replace('"scipy"', '"pydantic"')
    code = "import fenics_rom as fr\ntry: fr.read_scene\nexcept fr.errors.MissingPackageError as error: print(error)"
    cure = "which this Python lacks: pip install fenics-rom[reduction]"
    assert python(refuse + code).stdout == f"fenics_rom.read_scene needs pydantic, {cure}\n"


def test_command_line_without_rich_says_how_to_get_it_before_any_work(tmp_path):
    code = REFUSE + "from fenics_rom.cli.main import main; main()"
    run = python(code, "simulate", DATA / "rom-1.0.h5", "-o", tmp_path / "run.h5")
    assert run.returncode == 1
    assert run.stderr == "fenics-rom: error: the command line needs rich: pip install fenics-rom[cli]\n"
    assert not any(tmp_path.iterdir())
