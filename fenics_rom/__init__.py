"""Soft bodies with changing contacts, in real time.

Reads a scene, assembles it with FEniCSx, reduces it for each contact mode, and steps the reduced models with passive
midpoint integration. Importing this package loads nothing of NumPy or FEniCSx; a name is loaded when it is used.
"""

from typing import TYPE_CHECKING, Any

from fenics_rom import errors as errors
from fenics_rom.system.backends import register_backend
from fenics_rom.version import VERSION

if TYPE_CHECKING:  # for type checkers and editors; what runs is MODULE_OF
    from fenics_rom.fem.assemble import assemble as assemble
    from fenics_rom.fem.forms import assemble_forms as assemble_forms
    from fenics_rom.fem.matrix_market import read_system as read_system
    from fenics_rom.identification.identify import identify as identify
    from fenics_rom.identification.result import Identification as Identification
    from fenics_rom.identification.write import write_identification as write_identification
    from fenics_rom.mechanics.environment import Environment as Environment
    from fenics_rom.reduction.reduce import reduce as reduce
    from fenics_rom.rom.file import read_rom as read_rom
    from fenics_rom.rom.file import write_rom as write_rom
    from fenics_rom.rom.rom import Rom as Rom
    from fenics_rom.rom.rom import truncate as truncate
    from fenics_rom.run import simulate as simulate
    from fenics_rom.runtime.batch import Batch as Batch
    from fenics_rom.runtime.realtime import run_realtime as run_realtime
    from fenics_rom.runtime.simulator import Simulator as Simulator
    from fenics_rom.scene.file import read_scene as read_scene
    from fenics_rom.scene.scene import Scene as Scene
    from fenics_rom.studies.study import study as study
    from fenics_rom.system.system import System as System
    from fenics_rom.trajectory.comparison import compare as compare
    from fenics_rom.trajectory.file import read_trajectory as read_trajectory
    from fenics_rom.trajectory.file import write_trajectory as write_trajectory
    from fenics_rom.trajectory.trajectory import Trajectory as Trajectory
    from fenics_rom.visualization.exports.export import export as export
    from fenics_rom.visualization.plots.plot import plot as plot

__version__ = VERSION

MODULE_OF = {
    "Batch": "runtime.batch",
    "Environment": "mechanics.environment",
    "Identification": "identification.result",
    "Rom": "rom.rom",
    "Scene": "scene.scene",
    "Simulator": "runtime.simulator",
    "System": "system.system",
    "Trajectory": "trajectory.trajectory",
    "assemble": "fem.assemble",
    "assemble_forms": "fem.forms",
    "compare": "trajectory.comparison",
    "export": "visualization.exports.export",
    "identify": "identification.identify",
    "plot": "visualization.plots.plot",
    "read_rom": "rom.file",
    "read_scene": "scene.file",
    "read_system": "fem.matrix_market",
    "read_trajectory": "trajectory.file",
    "reduce": "reduction.reduce",
    "run_realtime": "runtime.realtime",
    "simulate": "run",
    "study": "studies.study",
    "truncate": "rom.rom",
    "write_identification": "identification.write",
    "write_rom": "rom.file",
    "write_trajectory": "trajectory.file",
}
register_backend("petsc4py", "fenics_rom.fem.user_matrices")  # which stands above `system`

__all__ = ["errors", *MODULE_OF]


def __getattr__(name: str) -> Any:
    if name not in MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fenics_rom.lazy_import import load

    return load(MODULE_OF[name], name)


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
