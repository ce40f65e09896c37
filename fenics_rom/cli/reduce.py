"""`fenics-rom reduce`: a scene, or matrices, to a ROM."""

import argparse
from pathlib import Path

import fenics_rom as fr
from fenics_rom.cli.display import print_rom, progress
from fenics_rom.cli.output import add_output
from fenics_rom.errors import FileError, SceneError, exactly
from fenics_rom.io.atomic_write import sole_writer
from fenics_rom.io.mpi_ranks import is_root_process
from fenics_rom.io.names import NAME, NAME_IN_WORDS
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.mechanics.environment import FRAMES, SWITCHINGS
from fenics_rom.scene.scene import LYAPUNOV, METHODS, SOLVERS, WEIGHTINGS

SUMMARY = "reduce a scene, or matrices, to a ROM; runs under mpirun"
KEPT_STAGES = ("contact modes", "training runs", "solves that took long")  # of which ROM.h5.partial has the finished
CHOICES = ("order", "tolerance", "method", "switching", "weighting", "lyapunov", "share", "solver", "errors", "resume")


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("scene", metavar="SCENE", nargs="?", help="scene file (TOML)")
    _add_matrix_options(command)
    add_output(command, "ROM.h5")
    group = command.add_mutually_exclusive_group()
    group.add_argument("--order", type=int, metavar="M", help="displacements per contact mode")
    group.add_argument("--tolerance", type=float, metavar="T", help="share of the sum of σ that may be left out")
    command.add_argument("--method", choices=METHODS, help="where the bases come from")
    command.add_argument("--switching", choices=SWITCHINGS, help="how states are carried between contact modes")
    command.add_argument("--weighting", choices=WEIGHTINGS, help="what of the shape counts")
    command.add_argument("--lyapunov", choices=LYAPUNOV, help="route to the Gramians")
    command.add_argument("--share", type=float, help="of the covariance's trace, for --method eigenvector-selection")
    command.add_argument("--solver", choices=SOLVERS, default="auto", help="for the stiffness matrix")
    command.add_argument(
        "--errors",
        action="store_true",
        default=None,
        help="make a ROM whose runs tell their errors: bound and estimate",
    )
    command.add_argument("--resume", action="store_true", help="go on from what a killed run left in ROM.h5.partial")


def run(choice: argparse.Namespace) -> None:
    """Reduces; what is finished is in ROM.h5.partial meanwhile."""
    from fenics_rom.reduction.checkpoint import remove_checkpoint

    files = _matrix_files(choice)
    check_outputs(choice.output, inputs=files or [choice.scene], force=True)
    partial = Path(f"{choice.output}.partial")
    try:
        in_the_way = partial.exists() and not partial.is_dir()
    except OSError as error:
        raise FileError(f"{partial}: is needed for what is finished: {error.strerror}; give a shorter name") from error
    if in_the_way:
        raise FileError(f"{partial}: is needed for what is finished, but it is not a folder")
    if choice.tolerance is not None and not 0 < choice.tolerance < 1:
        raise SceneError(f"--tolerance {exactly(choice.tolerance)}: use more than 0 and less than 1")
    if choice.share is not None and not 0 < choice.share <= 1:
        raise SceneError(f"--share {exactly(choice.share)}: use more than 0 and at most 1")
    if choice.order is not None and choice.order < 1:
        raise SceneError(f"--order {choice.order}: use whole numbers from 1")
    scene = None if files else fr.read_scene(choice.scene)
    check_outputs(choice.output, content="rom", inputs=scene.files if scene else (), force=choice.force)
    begun: dict[str, tuple[int, int]] = {}  # what was done already when a stage began, and of how much
    with sole_writer(choice.output, partial), progress() as show:

        def report(stage: str, done: int, of: int) -> None:
            begun.setdefault(stage, (done, of))
            show(stage, done, of)

        report("assembly", 0, 1)
        system = _read_matrices(choice) if scene is None else fr.assemble(scene)
        report("assembly", 1, 1)
        chosen = {name: getattr(choice, name) for name in CHOICES}
        rom = fr.reduce(system, **chosen, checkpoint=partial, report=report)
        rom = fr.validate_forces(system, rom, report=report)
        fr.write_rom(choice.output, rom, force=choice.force)
        remove_checkpoint(partial)
    if is_root_process():
        print_rom(rom, choice.output)
        if choice.resume:
            kept = [f"{done} of {of} {stage}" for stage, (done, of) in begun.items() if stage in KEPT_STAGES]
            print(f"  resumed: {' and '.join(kept) or 'nothing'} {'were' if kept else 'was'} taken over")


def _add_matrix_options(command: argparse.ArgumentParser) -> None:
    """Files of M v̇ + D v + K x = B u, y = Cᵀ x in place of a scene."""
    files = command.add_argument_group(
        "instead of SCENE", "matrices of your own, each in a Matrix Market file, or Abaqus'"
    )
    files.add_argument("--mass", metavar="M.mtx", help="symmetric positive definite")
    files.add_argument("--stiffness", metavar="K.mtx", help="symmetric positive definite, but for rigid motions")
    damping = files.add_mutually_exclusive_group()
    damping.add_argument("--damping", metavar="D.mtx", help="symmetric positive semi-definite")
    damping.add_argument("--rayleigh", nargs=2, type=float, metavar=("ALPHA", "BETA"), help="D = ALPHA M + BETA K")
    for option, metavar, what in (
        ("--contact", "NAME=B.mtx", "input columns of a contact mode; once for each"),
        ("--actuator", "NAME=F.mtx", "input columns that all contact modes have; once for each"),
        ("--observe", "NAME=C.mtx", "columns of an output; once for each"),
    ):
        files.add_argument(option, metavar=metavar, type=_named_file, action="append", default=[], help=what)
    table = (
        "columns x, y, z, m: of each node, three rows of the matrices; or Abaqus' X.inp, which the matrices are of, "
    )
    files.add_argument("--nodes", metavar="X.csv", help=f"{table}and then B, F and C may be its sets of nodes")
    files.add_argument("--units", choices=("m-kg-s", "mm-t-s"), help="of Abaqus' files; m-kg-s if not given")
    files.add_argument("--frame", choices=FRAMES, help="moving: the body turns as far as it likes; needs --nodes")


def _named_file(text: str) -> tuple[str, str]:
    name, _, file = text.partition("=")
    if not (NAME.fullmatch(name) and file):
        raise argparse.ArgumentTypeError(f"{text!r}: use NAME=FILE, the name of {NAME_IN_WORDS}")
    return name, file


def _matrix_files(choice: argparse.Namespace) -> list[str]:
    """The Matrix Market files to read, none where a scene is given; ends with status 2 where it is neither or both."""
    single = {"--mass": choice.mass, "--stiffness": choice.stiffness, "--damping": choice.damping}
    single |= {"--nodes": choice.nodes}
    named = {"--contact": choice.contact, "--actuator": choice.actuator, "--observe": choice.observe}
    given = [option for option, value in (single | named).items() if value]
    given += [f"--{option}" for option in ("rayleigh", "frame", "units") if getattr(choice, option)]
    if choice.scene is not None:
        if given:
            choice.wrong_usage(f"SCENE and {', '.join(given)} cannot be used together")
        return []
    if not given:
        choice.wrong_usage("SCENE is needed, or --mass, --stiffness, --damping (or --rayleigh) and --contact")
    missing = [option for option in ("--mass", "--stiffness", "--contact") if option not in given]
    missing += ["--damping or --rayleigh"] if not {"--damping", "--rayleigh"} & set(given) else []
    if missing:
        choice.wrong_usage(f"matrices instead of SCENE: {', '.join(missing)} missing")
    for option, pairs in named.items():
        if len(dict(pairs)) < len(pairs):
            choice.wrong_usage(f"{option}: each name may be used once")
    return [*filter(None, single.values()), *(file for pairs in named.values() for _, file in pairs)]


def _read_matrices(choice: argparse.Namespace) -> "fr.System":
    """The system of the files that were given."""
    return fr.read_system(
        mass=choice.mass,
        damping=choice.damping,
        rayleigh=tuple(choice.rayleigh) if choice.rayleigh else None,
        stiffness=choice.stiffness,
        contacts=dict(choice.contact),
        actuators=dict(choice.actuator),
        outputs=dict(choice.observe),
        nodes=choice.nodes,
        frame=choice.frame or "fixed",
        units=choice.units,
    )
