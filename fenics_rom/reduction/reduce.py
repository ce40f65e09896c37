"""System to ROM: a method finds directions for each contact mode; what is kept of them goes into one shared basis."""

import warnings
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.arguments import check_flag, path_in
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError, check_type, exactly
from fenics_rom.io.progress import Report, silent
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.active_environment import known_at_start
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.environment import SWITCHINGS
from fenics_rom.mechanics.face_contact import FaceContact
from fenics_rom.mechanics.load_history import check_width
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.mechanics.surface_checks import check_apart
from fenics_rom.reduction.balancing import choose_order, orthonormal_span
from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.common_basis import CommonBasis
from fenics_rom.reduction.eigenvectors import EigenvectorSelection
from fenics_rom.reduction.error_model import check_errors_known, with_error_model
from fenics_rom.reduction.hyperreduction.reduce import BASES, hyperreduce
from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.methods.modal import modal, modal_static
from fenics_rom.reduction.methods.pod import pod
from fenics_rom.reduction.methods.static import static
from fenics_rom.reduction.moving_frame import with_moving_frame
from fenics_rom.reduction.problem import Method, RankedBasis, ReductionProblem, scale_inputs
from fenics_rom.reduction.projection import RetainedBasis, assemble_rom
from fenics_rom.reduction.residual_compliance import contact_shapes, may_keep_compliance, with_residual_compliance
from fenics_rom.reduction.rigid_mode_deflation import elastic_part, require_loads, with_rigid_modes
from fenics_rom.rom.rom import Rom, check_rom
from fenics_rom.scene.scene import (
    CUBATURE,
    LYAPUNOV,
    METHODS,
    SHARE,
    SOLVERS,
    TOLERANCE,
    WEIGHTINGS,
    Reduction,
    check_order,
)
from fenics_rom.scene.values import Text
from fenics_rom.system.body import Unknowns
from fenics_rom.system.system import System

SELECTION = "eigenvector-selection"  # of what the balanced directions name, see EigenvectorSelection
BY_NAME: dict[str, Method] = {  # any function of a problem is a method, too
    "balanced": balanced,
    SELECTION: balanced,
    "modal": modal,
    "modal+static": modal_static,
    "pod": pod,
    "static": static,
}
DENSE_LIMIT = 1000  # unknowns up to which all eigenvectors are cheaper than a Krylov space
DEFAULT_TOLERANCE = 1e-6  # share of the sum of σ that is left out where neither order nor tolerance is given
DEFAULT_MOST = 100  # displacements kept then: of a body whose whole skin may touch, 1e-6 asks for all there are
EIGENVECTORS_KEPT = (
    "contact: of a body that may be touched at {points} points in one contact mode the {order} lowest eigenvectors are "
    "kept, as neither order, tolerance nor method was given; contact forces at rest are exact at any order, and the "
    "validation tells what else it costs"
)
BLOCKS = 40  # of solves for the forces of a contact mode, with those of the validation
SOLVES_OF_POINT = 12  # two for each direction of a residual compliance, which are exact: twice the iterations
LARGE_DEFORMATION_TOLERANCE = 3e-5  # the same for large deformation


def reduce(
    system: System,
    *,
    order: int | Mapping[str, int] | None = None,
    tolerance: float | None = None,
    method: str | Method | None = None,
    switching: str | None = None,
    weighting: str | None = None,
    lyapunov: str | None = None,
    share: float | None = None,
    cubature: float | None = None,
    solver: str = "auto",
    errors: bool | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    report: Report = silent,
) -> Rom:
    """Reduces a full-order model for each of its contact modes; every rank must call it, every rank gets the ROM.

    What is None is taken from the scene's [reduction]. Contact forces are not looked at, as that takes full-order runs
    of the scene: `validate_forces` does, which `fenics-rom reduce` calls after this.

    Args:
        system: the full-order model.
        order: number of reduced displacements, one for all contact modes or by name; the rigid motions of a body that
            is not wholly held come with them, exactly.
        tolerance: instead of an order: share of the sum of singular values that may be left out; where neither is
            given 1e-6 (3e-5 for large deformation), but an order of at most 100, and the ROM says so. Where no method
            is given either, and obstacles can touch more than 33 points of a contact mode that yield beyond the basis,
            it is "modal+static" of order 100.
        method: "balanced" (by the Gramians), "eigenvector-selection" (the paper's: eigenvectors that hold a share of
            the balanced basis' covariance), "modal" (the lowest eigenvectors), "modal+static" (with the static
            shapes of the inputs; of actuators and loads alone where contact points keep their residual compliance, for
            which it is often the best), "pod" (of full-order runs), "static" (the shapes at rest alone; what a scene
            without inertia gets), or a function of a `ReductionProblem`. With large deformation "trained" (by
            full-order runs; what such a scene gets) or "modal+derivatives" (without runs).
        switching: "energy": the bases themselves, switched by energy-orthogonal projection (any order, no loss of
            accuracy); "oblique": standard balanced truncation as the paper's (5)-(8) stand, from dense Gramians with
            their round-off, switched by their oblique projections, which can create energy: for comparison only.
        weighting: what of the shape counts: "mass" (the L² norm), "nodal" (all nodes alike, the paper's) or
            "outputs" (the named outputs only).
        lyapunov: route to the Gramians: "closed-form" in all eigenvectors, "bartels-stewart" (dense), "krylov", "adi"
            or "auto" (closed form up to 1,000 unknowns, else krylov).
        share: of the covariance's trace that the eigenvectors of "eigenvector-selection" hold.
        cubature: for large deformation, error of the forces of the points that are kept, relative.
        solver: for K: "direct" (a Cholesky factor), "iterative" (conjugate gradients with algebraic multigrid), or
            "auto": direct where the factor fits into the memory and takes no more operations than iterations would;
            else the ROM says why not.
        errors: whether runs are to know their errors: bounds and estimates, as `Simulator.error_bound` has them; None:
            as the scene's run says. It takes solves with the damping matrix, too.
        checkpoint: folder that keeps what is finished, contact mode by contact mode, and solves that took seconds;
            yours to remove when the ROM is written.
        resume: go on from what an earlier call left in `checkpoint`.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: no system, or a choice that does not exist or does not fit it, or errors that cannot be known.
        SolverError: undamped motions, or a solver that did not deliver.
        FileError: a checkpoint of something else, or one that cannot be written.

    Example:
        >>> rom = fr.reduce(system, order=20)
        >>> rom.validation["middle"]["transfer_error"] < 1e-3
        True
    """
    check_type("reduce", system, System, "fr.assemble(scene)")
    chosen = system.scene.reduction if system.scene else Reduction()
    if order is None and tolerance is None:
        order, tolerance = chosen.order, chosen.tolerance
    check_order(order, system.contacts, "order")
    switching = Text(SWITCHINGS).check(_given(switching, chosen.switching), "switching")
    method, messages = _given(method, chosen.method), list(system.warnings)
    is_open = switching == "energy" and all(choice is None for choice in (method, order, tolerance))
    if is_open and (touched := _most_points(system)):
        method, order = "modal+static", min(DEFAULT_MOST, system.elastic_size)
        messages.append(EIGENVECTORS_KEPT.format(points=touched, order=order))
    most = DEFAULT_MOST if order is None and tolerance is None and system.deformation is None else None
    if tolerance is None:
        tolerance = DEFAULT_TOLERANCE if system.deformation is None else LARGE_DEFORMATION_TOLERANCE
    tolerance = TOLERANCE.check(tolerance, "tolerance")
    has_share, has_cubature = share is not None, cubature is not None
    share = SHARE.check(chosen.share if share is None else share, "share")
    cubature = CUBATURE.check(chosen.cubature if cubature is None else cubature, "cubature")
    named, method = _method(_given(method, _default_method(system)), system)
    if has_share and method is BY_NAME.get(named) and named != SELECTION:  # a function of the user's may want it
        raise SceneError(f"share = {exactly(share)}: goes with method = {SELECTION!r}, not with {named!r}")
    if has_cubature and system.deformation is None:
        raise SceneError(f"cubature = {exactly(cubature)}: goes with effects.large_deformation, which the body has not")
    weighting = Text(WEIGHTINGS).check(_given(weighting, chosen.weighting), "weighting")
    lyapunov = Text(LYAPUNOV).check(_given(lyapunov, chosen.lyapunov), "lyapunov")
    solver = Text(SOLVERS).check(solver, "solver")
    run = system.scene.run if system.scene else None
    errors = check_flag("errors", _given(errors, run is not None and run.errors), SceneError)
    if errors:
        check_errors_known(system)
    checkpoint = None if checkpoint is None else path_in("checkpoint", checkpoint)
    resume = check_flag("resume", resume, SceneError)
    if switching == "oblique":
        lyapunov = "as-printed"
    elif lyapunov == "auto":
        lyapunov = "closed-form" if system.size <= DENSE_LIMIT else "krylov"
    if weighting == "outputs" and not system.outputs:
        raise SceneError("reduction.weighting = 'outputs', but the scene names no outputs")
    if switching != "energy" and named != "balanced":
        raise SceneError(f"switching = {switching!r} goes with method = 'balanced', not with {named!r}")

    _require_start(system)
    whole, system = system, elastic_part(system)
    if system is not whole:
        _require_linear_motions(system, lyapunov)
        require_loads(system)
    stages = Stages(lambda value: float(system.algebra.maximum(value)), system.stages, report)
    with stages("factorisation of K"):
        factor = system.algebra.factor((1.0, system.stiffness), solver=solver, columns=_columns(system))
    with closing(factor), stages("other work"):
        system = scale_inputs(system, factor)
        problem = ReductionProblem(
            system=system,
            factor=factor,
            space=CommonBasis(system),
            contacts=tuple(system.contacts),
            order=order,
            tolerance=tolerance,
            most=most,
            switching=switching,
            weighting=weighting,
            lyapunov=lyapunov,
            share=share,
            stages=stages,
            messages=[*messages, *filter(None, [factor.notice])],
        )
        finished = Checkpoint(checkpoint, problem, named, resume)
        problem = finished.with_kept_solves(problem)
        if method is None:
            rom = hyperreduce(problem, whole, named, cubature, finished)
        else:
            retained = _retained_bases(problem, method, finished, named == SELECTION)
            rom = assemble_rom(problem, retained, contact_shapes(problem, retained), method=named)
        rom = with_moving_frame(problem, with_residual_compliance(problem, rom), whole)
        rom = with_rigid_modes(rom, whole)
        if errors:
            rom = with_error_model(problem, rom, whole)
    rom = _with_tied_components(rom, whole.body.unknowns)
    for message in problem.messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return check_rom(rom)


def _columns(system: System) -> int:
    """About how many columns a reduction solves for with K."""
    forces = sum(map(system.count_forces, system.contacts))
    points = sum(map(len, system.contact_points.values())) if may_keep_compliance(system) else 0
    return BLOCKS * forces + SOLVES_OF_POINT * points


def _given(choice: Any, scene: Any) -> Any:
    """What is given, or else what the scene says."""
    return scene if choice is None else choice


def _require_start(system: System) -> None:
    """Refuses what no run of the scene could begin with: an obstacle inside the body, or a load of other columns."""
    if system.scene is None:
        return
    environment, columns = system.scene.environment, {**system.contacts, **system.actuators}
    for load in environment.run.loads if environment.run else ():
        name = load.contact or str(load.actuator)
        if name in columns:
            check_width(load, columns[name].shape[1], f"{environment.source}: run.load: {name!r}")
    if environment.contact_law is None or not system.contact_points:
        return
    body, touching = system.body, environment.self_contact
    system.points_of_contact().own_surface(touching, body.triangles)
    check_apart(body.nodes, body.triangles, body.contact_surfaces, touching)
    if not environment.obstacles:
        return
    touched, law = system.points_of_contact(), environment.contact_law
    points, faces = touched.coordinates, touched.faces(body.triangles) if environment.touches_faces else None
    shapes, offsets = known_at_start(environment.obstacles)
    if not shapes:
        return
    try:
        given = points, list(shapes.values()), law
        solver = ContactSolver(*given) if faces is None else FaceContact(*given, faces)
        solver.check_start(np.zeros_like(points), offsets, list(shapes))
        skin = system.skin()
        SkinWatch(skin).check_start(skin.coordinates, displaced(shapes, offsets))
    except StepError as error:
        raise SceneError(f"{environment.source}: {error}") from error


def _require_linear_motions(system: System, lyapunov: str) -> None:
    """Refuses of a body with rigid motions what these do not allow."""
    if system.deformation is not None and system.moving_frame is None:
        raise SceneError(
            "effects.large_deformation: a body that is not wholly held turns as far as it likes, which no fixed "
            "basis follows; take frame = 'moving', or hold it by supports or springs"
        )
    if lyapunov in ("as-printed", "bartels-stewart"):
        raise SceneError(
            "bodies that are not wholly held have no dense Gramians of the first-order form; use "
            "lyapunov = 'closed-form', 'krylov' and 'adi', and switching = 'energy'"
        )


def _with_tied_components(rom: Rom, unknowns: Unknowns) -> Rom:
    """The ROM whose basis has rows of the components that follow unknowns, too."""
    if unknowns.weights is None:
        return rom
    moving = unknowns.moving
    return replace(rom, free=moving, basis=unknowns.expand(rom.basis)[moving])


def _default_method(system: System) -> str:
    """Balanced; for runs without inertia, which no transient has a part in, the shapes at rest; or by training."""
    if system.deformation is not None:
        return "trained"
    return "static" if system.scene is not None and system.scene.effects.inertia is None else "balanced"


def _most_points(system: System) -> int:
    """How many points of a contact mode keep their residual compliance, where no basis has a shape for each; else 0.

    With forces everywhere balanced directions come close to eigenvectors, but not so close that they share no mass with
    what contact points yield beyond them, which steps neglect.
    """
    if _default_method(system) != "balanced" or not may_keep_compliance(system):
        return 0
    points = max(map(len, system.contact_points.values()))
    return points if 3 * points > DEFAULT_MOST else 0


def _method(method: str | Method, system: System) -> tuple[str, Method | None]:
    """Name and function; of large deformation the name alone."""
    if isinstance(method, type):  # can be called, but makes no directions
        Text(METHODS).check(method, "method")
    large = not callable(method) and Text(METHODS).check(method, "method") in BASES
    named = getattr(method, "__name__", type(method).__name__) if callable(method) else method
    if large != (system.deformation is not None):
        raise SceneError(
            f"method = {named!r}: {' and '.join(map(repr, BASES))} go with effects.large_deformation, and no others do"
        )
    return named, method if callable(method) else BY_NAME.get(method)


def _retained_bases(
    problem: ReductionProblem, method: Method, checkpoint: Checkpoint, selects: bool
) -> dict[str, RetainedBasis]:
    """What each contact mode keeps of its directions, or `selects` by them, in the order of the system."""
    retained = checkpoint.restored(problem)
    names = problem.contacts
    selection = EigenvectorSelection(problem) if selects else None
    problem.stages.report("contact modes", len(retained), len(names))
    remaining = tuple(name for name in names if name not in retained)
    for name, ranked in method(replace(problem, contacts=remaining)) if remaining else ():
        if name not in names or name in retained:
            raise SceneError(f"the method gave contact mode {name!r}, which was not asked for")
        retained[name] = _truncated(problem, name, ranked)
        if selection is not None:
            V = selection.select(retained[name].directions, ranked.singular_values)
            retained[name] = RetainedBasis(V, V, ranked.singular_values)
        checkpoint.keep(problem, name, retained[name])
        problem.stages.report("contact modes", len(retained), len(names))
    if missing := [name for name in names if name not in retained]:
        raise SceneError(f"the method gave no directions for contact mode {missing[0]!r}")
    return {name: retained[name] for name in names}


def _truncated(problem: ReductionProblem, name: str, ranked: RankedBasis) -> RetainedBasis:
    """The leading directions, and what the user should know about them."""
    σ, T, order = ranked.singular_values, ranked.coordinates, problem.order_of(name)
    if order is None and not len(σ):
        raise SceneError("this method has no singular values for a tolerance to leave out; give an order")
    m = choose_order(σ, order, problem.tolerance)
    if order is None and problem.most is not None and m > problem.most:
        problem.messages.append(
            f"contact mode {name!r}: order {problem.most} is kept, as none was given; to leave out no more than "
            f"{problem.tolerance:g} of the sum of σ it would be {m}; the validation tells what it costs"
        )
        m = problem.most
    span = orthonormal_span(T, m)
    rank = span.shape[1]
    if rank < m:
        problem.messages.append(
            f"contact mode {name!r}: order {m} was asked for, {rank} are numerically there and were kept"
        )
    left = None if problem.switching != "oblique" or ranked.left_inverse is None else ranked.left_inverse[:rank]
    return RetainedBasis(span, T[:, :rank], σ if ranked.hankel else np.empty(0), left)
