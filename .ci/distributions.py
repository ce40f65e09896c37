"""Builds sdist and wheel, checks them, and installs them into empty environments: python .ci/distributions.py [FOLDER].

The distributions are left in FOLDER, where one is given. Each Python from 3.11 on that is found here has the runtime
installed and tried. Nothing is uploaded.
"""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from ctypes.util import find_library
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"
WHEELS = ["dolfinx-solver-real", "gmsh"]  # of a publisher outside FEniCS, for the newest dolfinx
TOOLS = ["build", "hatchling", "twine", "check-wheel-contents", "cffconvert"]
INSTALL = ["-m", "pip", "install", "-q", "--no-compile", "--disable-pip-version-check"]
OLDEST = (3, 11)
NO_NETWORK = re.compile("Failed to establish|NewConnectionError|Temporary failure in name resolution|Read timed out")
REDUCTION = """
import numpy as np, fenics_rom as fr
K = 2 * np.eye(8) - np.eye(8, k=1) - np.eye(8, k=-1)
system = fr.System(mass=np.eye(8), rayleigh=(0.0, 0.01), stiffness=K, contacts={"end": np.eye(8)[:, -1:]})
body = fr.Simulator(fr.reduce(system, order=4), dt=0.01)
body.step([1.0])
print(f"[offline] reduces own matrices: {body.energy:.3e} J after a step")
"""
ZOO = """
import sys, fenics_rom as fr
for name in fr.zoo():
    body = fr.Simulator(fr.load(name), dt=1e-3)
    body.step([0.0] * body.inputs)
assert not {"scipy", "pydantic", "dolfinx"} & set(sys.modules)
print(f"the zoo has {', '.join(fr.zoo())}")
"""


def run(*words, **options):
    """Runs a command, whose output is shown where it fails."""
    done = subprocess.run([*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options)
    if done.returncode:
        print(done.stdout, end="")
        if NO_NETWORK.search(done.stdout):
            print("the rest is skipped, as a download failed")
            sys.exit()
        sys.exit(f"FAILED: {' '.join(map(str, words))}")
    return done.stdout


def environment(folder, python=None):
    """A new environment in a folder, of this Python or another; its Python."""
    if python is None:
        venv.create(folder, with_pip=True)
    else:
        run(python, "-m", "venv", folder)
    return next(path for path in (folder / "bin" / "python", folder / "Scripts" / "python.exe") if path.exists())


def pythons():
    """One of each Python from the oldest on that is found: on PATH, of pyenv, and this one."""
    found = {}
    names = [f"python3.{minor}" for minor in range(OLDEST[1], 30)]
    paths = [sys.executable, *filter(None, map(shutil.which, names)), *Path.home().glob(".pyenv/versions/*/bin/python")]
    for path in paths:
        ask = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
        done = subprocess.run([path, "-I", "-c", ask], capture_output=True, text=True)
        if done.returncode == 0 and (version := tuple(map(int, done.stdout.split()))) >= OLDEST:
            found.setdefault(version, path)
    return [found[version] for version in sorted(found)]


def main(folder):
    """All in order; the first that fails ends it."""
    os.environ.pop("PYTHONPATH", None)
    with tempfile.TemporaryDirectory() as name:
        place, folder = Path(name), Path(folder or f"{name}/dist")
        tools = environment(place / "tools")
        run(tools, *INSTALL, *TOOLS)
        run(tools, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
        sdist, wheel = *folder.glob("*.tar.gz"), *folder.glob("*.whl")
        run(tools, "-m", "twine", "check", "--strict", sdist, wheel)
        run(tools, "-m", "check_wheel_contents", wheel)
        run(tools.with_name("cffconvert"), "--validate", "-i", ROOT / "CITATION.cff")
        print(f"built and checked: {sdist.name}, {wheel.name}")
        for k, python in enumerate(pythons()):
            inside = environment(place / f"runtime{k}", python)
            run(inside, *INSTALL, "--only-binary", "numpy,h5py", wheel)
            check = ["-I", "-X", "warn_default_encoding", "-W", "error", ROOT / ".ci" / "runtime_check.py"]
            print(run(inside, *check, DATA / "rom-1.0.h5", DATA / "run-1.0.h5", cwd=place), end="", flush=True)
        run(inside, *INSTALL, f"{wheel}[offline]")  # of the newest Python
        print(run(inside, "-I", "-c", REDUCTION, cwd=place), end="")
        run(inside, "-m", "pip", "check")
        run(inside, "-m", "fenics_rom", "info", DATA / "rom-1.0.h5", cwd=place)
        if sys.platform == "linux" and platform.machine() == "x86_64" and find_library("GLU"):  # Gmsh draws with it
            run(inside, *INSTALL, *WHEELS)
            files = ROOT / "demos" / "plate" / "plate.toml", "-o", place / "plate.h5"
            print(run(inside, "-m", "fenics_rom", "reduce", *files, cwd=place).splitlines()[0])
            zoo(place, folder, tools, inside)


def zoo(place, folder, tools, inside):
    """The same of the zoo: the whole where `zoo/build.py` has made it, else of the plate alone."""
    project = place / "zoo"
    shutil.copytree(ROOT / "zoo", project, ignore=shutil.ignore_patterns("__pycache__"))
    if not (project / "fenics_rom_zoo" / "catalogue.json").exists():
        print(run(inside, ROOT / "zoo" / "build.py", "plate", "--package", project / "fenics_rom_zoo"), end="")
    run(tools, "-m", "build", "--no-isolation", "--outdir", folder, project)
    sdist, wheel = *folder.glob("fenics_rom_zoo*.tar.gz"), *folder.glob("fenics_rom_zoo*.whl")
    run(tools, "-m", "twine", "check", "--strict", sdist, wheel)
    run(tools, "-m", "check_wheel_contents", "--ignore", "W002", wheel)  # a body's folder stands alone
    run(inside, *INSTALL, "--no-deps", wheel)
    run(inside, "-m", "pip", "check")
    print(run(inside, "-I", "-c", ZOO, cwd=place), end="")


if __name__ == "__main__":
    main(*sys.argv[1:2] or [None])
