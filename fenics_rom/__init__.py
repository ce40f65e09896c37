"""Soft bodies with changing contacts, in real time.

Reads a scene, assembles it with FEniCSx, reduces it for each contact mode, and steps the reduced models with passive
midpoint integration. Importing this package loads NumPy and nothing of FEniCSx; a name is loaded when it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fenics_rom.system.backends import register_backend

__version__ = "0.1.0"

_HOME = {
    "Batch": "runtime.batch",
    "Identification": "identification.result",
    "Trajectory": "trajectory.trajectory",
    "Rom": "rom.rom",
    "Scene": "scene.scene",
    "Simulator": "runtime.simulator",
    "System": "system.system",
    "assemble": "fem.assemble",
    "assemble_forms": "fem.forms",
    "compare": "trajectory.comparison",
    "export": "visualization.exports.export",
    "identify": "identification.identify",
    "plot": "visualization.plots.plot",
    "read_trajectory": "trajectory.file",
    "read_rom": "rom.file",
    "read_scene": "scene.file",
    "read_system": "fem.matrix_market",
    "reduce": "reduction.reduce",
    "run_realtime": "runtime.realtime",
    "simulate": "runtime.simulate",
    "solve": "fem.simulate",
    "study": "studies.study",
    "truncated": "rom.rom",
    "write_identification": "identification.write",
    "write_trajectory": "trajectory.file",
    "write_rom": "rom.file",
}
_FENICSX = ("dolfinx", "sudo apt-get install --no-install-recommends python3-dolfinx python3-gmsh libopenblas0")
_SCIPY = ("scipy", "pip install fenics-rom[reduction]")
_PACKAGES = {
    "studies": _FENICSX,
    "fem": _FENICSX,
    "fem.matrix_market": _SCIPY,
    "reduction": _SCIPY,
    "identification": _FENICSX,
    "system": _SCIPY,
}

register_backend("petsc4py", "fenics_rom.fem.user_matrices")  # which stands above `system`

if TYPE_CHECKING:
    from fenics_rom.fem.assemble import assemble
    from fenics_rom.fem.forms import assemble_forms
    from fenics_rom.fem.matrix_market import read_system
    from fenics_rom.fem.simulate import solve
    from fenics_rom.identification.identify import identify
    from fenics_rom.identification.result import Identification
    from fenics_rom.identification.write import write_identification
    from fenics_rom.reduction.reduce import reduce
    from fenics_rom.rom.file import read_rom, write_rom
    from fenics_rom.rom.rom import Rom, truncated
    from fenics_rom.runtime.batch import Batch
    from fenics_rom.runtime.realtime import run_realtime
    from fenics_rom.runtime.simulate import simulate
    from fenics_rom.runtime.simulator import Simulator
    from fenics_rom.scene.file import read_scene
    from fenics_rom.scene.scene import Scene
    from fenics_rom.studies.study import study
    from fenics_rom.system.system import System
    from fenics_rom.trajectory.comparison import compare
    from fenics_rom.trajectory.file import read_trajectory, write_trajectory
    from fenics_rom.trajectory.trajectory import Trajectory
    from fenics_rom.visualization.exports.export import export
    from fenics_rom.visualization.plots.plot import plot

__all__ = [
    "Batch",
    "Identification",
    "Rom",
    "Scene",
    "Simulator",
    "System",
    "Trajectory",
    "assemble",
    "assemble_forms",
    "compare",
    "export",
    "identify",
    "plot",
    "read_rom",
    "read_scene",
    "read_system",
    "read_trajectory",
    "reduce",
    "run_realtime",
    "simulate",
    "solve",
    "study",
    "truncated",
    "write_identification",
    "write_rom",
    "write_trajectory",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOME[name]
    try:
        if home.startswith(("studies.", "fem.", "identification.")):
            import_module("h5py")  # first: PyPI's h5py, after dolfinx, would take dolfinx's HDF5 for its own
        module = import_module(f"{__name__}.{home}")
    except ModuleNotFoundError as error:
        needed, cure = _PACKAGES.get(home, _PACKAGES.get(home.split(".")[0], ("", "")))
        if not needed or (error.name or "").startswith(__name__):
            raise
        from fenics_rom.errors import MissingPackageError

        raise MissingPackageError(f"fenics_rom.{name} needs {error.name}, which this Python lacks: {cure}") from error
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
