"""The public names and their modules: for type checkers and editors, and for `__init__.py`, which loads them."""

from fenics_rom import errors as errors
from fenics_rom.compilation import compiled as compiled
from fenics_rom.errors import CompareError as CompareError
from fenics_rom.errors import DataError as DataError
from fenics_rom.errors import FenicsRomError as FenicsRomError
from fenics_rom.errors import FenicsRomWarning as FenicsRomWarning
from fenics_rom.errors import FileError as FileError
from fenics_rom.errors import MeshError as MeshError
from fenics_rom.errors import MissingPackageError as MissingPackageError
from fenics_rom.errors import RomFileError as RomFileError
from fenics_rom.errors import SceneError as SceneError
from fenics_rom.errors import SolverError as SolverError
from fenics_rom.errors import StepError as StepError
from fenics_rom.errors import StructureError as StructureError
from fenics_rom.errors import TrajectoryFileError as TrajectoryFileError
from fenics_rom.fem.assemble import assemble as assemble
from fenics_rom.fem.forms import assemble_forms as assemble_forms
from fenics_rom.fem.matrix_market import read_system as read_system
from fenics_rom.first_steps import compile_steps as compile_steps
from fenics_rom.identification.identify import identify as identify
from fenics_rom.identification.marker_data import read_markers as read_markers
from fenics_rom.identification.result import Identification as Identification
from fenics_rom.identification.scene_gradient import SceneGradient as SceneGradient
from fenics_rom.identification.scene_gradient import differentiate_scene as differentiate_scene
from fenics_rom.identification.write import write_identification as write_identification
from fenics_rom.mechanics.base_path import BasePath as BasePath
from fenics_rom.mechanics.base_path import BaseState as BaseState
from fenics_rom.mechanics.environment import Environment as Environment
from fenics_rom.reduction.enrichment import Enrichment as Enrichment
from fenics_rom.reduction.reduce import reduce as reduce
from fenics_rom.rom.file import read_rom as read_rom
from fenics_rom.rom.file import write_rom as write_rom
from fenics_rom.rom.rom import Rom as Rom
from fenics_rom.rom.state_space import StateSpace as StateSpace
from fenics_rom.rom.truncate import truncate as truncate
from fenics_rom.run import simulate as simulate
from fenics_rom.runtime.batch import Batch as Batch
from fenics_rom.runtime.differentiation.differentiate import differentiate as differentiate
from fenics_rom.runtime.differentiation.gradient import RolloutGradient as RolloutGradient
from fenics_rom.runtime.realtime import run_realtime as run_realtime
from fenics_rom.runtime.simulator import Simulator as Simulator
from fenics_rom.scene.file import read_scene as read_scene
from fenics_rom.scene.scene import Scene as Scene
from fenics_rom.scene.world_file import read_world as read_world
from fenics_rom.studies.force_validation import validate_forces as validate_forces
from fenics_rom.studies.study import study as study
from fenics_rom.system.system import System as System
from fenics_rom.trajectory.comparison import compare as compare
from fenics_rom.trajectory.file import read_trajectory as read_trajectory
from fenics_rom.trajectory.file import write_trajectory as write_trajectory
from fenics_rom.trajectory.trajectory import Trajectory as Trajectory
from fenics_rom.visualization.exports.export import export as export
from fenics_rom.visualization.plots.plot import plot as plot
from fenics_rom.visualization.viewer.view import view as view
from fenics_rom.world.records import RigidBody as RigidBody
from fenics_rom.world.records import SoftBody as SoftBody
from fenics_rom.world.world import World as World
from fenics_rom.world_run import make_world as make_world

MODULE_OF: dict[str, str]
__all__: list[str]
__version__: str
