"""What holds for several keys of a scene, or for several effects, together."""

from collections.abc import Collection, Mapping
from dataclasses import is_dataclass
from itertools import pairwise
from typing import Any

from fenics_rom.errors import SceneError, check_known, exactly, unknown
from fenics_rom.mechanics.environment import FACES, AppliedLoad
from fenics_rom.mechanics.initial_state import SMALL_ROTATION, ZERO
from fenics_rom.mechanics.isochoric import isochoric_terms
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.scene.chambers import check_filling
from fenics_rom.scene.contact import Contact, ObstacleMotion
from fenics_rom.scene.effect_table import ACTUATORS, EFFECTS, LOADS
from fenics_rom.scene.effects import Effects, RigidBase, Viscoelasticity
from fenics_rom.scene.environment import guides_of, obstacle_of
from fenics_rom.scene.fibres import HOLZAPFEL, QUADRATIC, Directions
from fenics_rom.scene.file_format import LoadEntry, SceneFile
from fenics_rom.scene.outputs import check_output
from fenics_rom.scene.places import Patch
from fenics_rom.scene.reading_checks import check_reading
from fenics_rom.scene.scene import Reduction, check_order

ROUND_OFF = 1e-9  # of moments of inertia


def check_consistency(file: SceneFile) -> None:
    """Checks all but the run, whose loads are made one by one; SceneError where something does not fit the rest."""
    check_choices(file, "")
    if not file.contacts:
        raise SceneError("contacts: at least one contact mode is needed, as [contacts.NAME]")
    _check_together(file)
    _check_effects(file.effects, file.contacts, file.actuators)
    _check_frame(file)
    _check_tolerance(file)
    for k, held in enumerate(file.supports.held):
        if held.normal is not None and not any(held.normal):
            raise SceneError(f"supports.held[{k}].normal: use any direction but zero")
        if held.sliding and (held.normal is not None or held.point is not None):
            key = "point" if held.normal is None else "normal"
            raise SceneError(f"supports.held[{k}].sliding: is along a surface's own normals; leave {key} out")
    if (file.material is None) == (file.materials is None):
        raise SceneError("give either [material] or [materials.NAME]")
    if file.materials == {}:
        raise SceneError("materials: at least one [materials.NAME] is needed")
    if file.mesh.integration == "selective":
        _check_selective(file)
    _check_fibres(file)
    _check_temperatures(file)
    check_order(file.reduction.order, file.contacts, "reduction.order")
    if file.reduction.share != Reduction.share and file.reduction.method != "eigenvector-selection":
        raise SceneError("reduction.share: goes with method = 'eigenvector-selection'")
    if file.reduction.cubature != Reduction.cubature and file.effects.large_deformation is None:
        raise SceneError("reduction.cubature: goes with effects.large_deformation")
    for name, output in file.outputs.items():
        check_output(output, f"outputs.{name}", has_contact=file.effects.contact is not None)
        if output.quantity == TOUCH and name in file.readings:
            raise SceneError(f"outputs.{name}: the name is taken by readings.{name}")
        if output.markers is not None and file.effects.large_deformation is not None:
            raise SceneError(
                f"outputs.{name}.markers: are for small turns; use readings of quantity 'marker', one for each"
            )
    for name, reading in file.readings.items():
        check_reading(reading, file, f"readings.{name}")


def _check_together(file: SceneFile) -> None:
    """Checks contact modes that are made of others."""
    for name, patch in file.contacts.items():
        parts, where = patch.together or (), f"contacts.{name}"
        for part in parts:
            check_known("contact mode", part, file.contacts, SceneError, f"{where}.together: ")
            if file.contacts[part].together is not None:
                raise SceneError(f"{where}.together: {part!r} is made of others; use those that have a place")
        if len(set(parts)) < len(parts):
            raise SceneError(f"{where}.together: use every contact mode once")
        if parts and patch.force != Patch.force:
            raise SceneError(f"{where}.force: is that of each of {', '.join(parts)}; leave it out")
    for name, patch in file.actuators.items():
        if patch.together is not None:
            raise SceneError(f"actuators.{name}.together: goes with contacts; actuators can always be pushed together")


def _check_selective(file: SceneFile) -> None:
    """Checks that there is something to integrate selectively."""
    materials = {"material": file.material} if file.materials is None else file.materials
    for name, material in materials.items():
        if material is not None and material.poisson <= 0:
            raise SceneError(
                f"mesh.integration = 'selective': poisson = {exactly(material.poisson)} of {name}: use > 0"
            )


def _check_fibres(file: SceneFile) -> None:
    """Checks directions of fibres, and that their law goes with the effects."""
    materials = {"material": file.material} if file.materials is None else file.materials
    given: dict[str, Directions] = {f"effects.membranes.{name}": each for name, each in file.effects.membranes.items()}
    for name, material in materials.items():
        fibres = None if material is None else material.fibres
        if fibres is None:
            continue
        where = "material.fibres" if file.materials is None else f"materials.{name}.fibres"
        given[where] = fibres
        for key in ("stiffening", "dispersion") if fibres.law != HOLZAPFEL else ():
            if getattr(fibres, key):
                raise SceneError(f"{where}.{key}: goes with law = {HOLZAPFEL!r}")
        if fibres.law == HOLZAPFEL and file.effects.large_deformation is None:
            raise SceneError(
                f"{where}.law = {HOLZAPFEL!r}: its fibres only pull, which is not linear; use {QUADRATIC!r}, or "
                "effects.large_deformation"
            )
    for where, directed in given.items():
        vectors = {f"{where}.directions[{k}]": each for k, each in enumerate(directed.directions or ())}
        if directed.helix is not None:
            vectors[f"{where}.helix.axis"] = directed.helix.axis
        for key, vector in vectors.items():
            if not any(vector):
                raise SceneError(f"{key}: use any direction but zero")
        for key in ("directions", "data"):
            if len(getattr(directed, key, None) or ()) > 2:
                raise SceneError(f"{where}.{key}: use one or two families")
    for name, cable in file.effects.cables.items():
        for k, (one, other) in enumerate(pairwise(cable.points)):
            if one == other:
                raise SceneError(f"effects.cables.{name}.points[{k + 1}]: is the point before it")


def check_choices(part: Any, where: str) -> None:
    """Checks, in a record and all records in it, that one of some keys is given where it must or can be one."""
    for keys in getattr(part, "ONE_OF", ()):
        given = [key for key in keys if getattr(part, key) is not None]
        if len(given) != 1:
            raise SceneError(f"{where}: give exactly one of {', '.join(keys)} (got {', '.join(given) or 'none'})")
    given = [key for key in getattr(part, "AT_MOST_ONE", ()) if getattr(part, key) is not None]
    if len(given) > 1:
        raise SceneError(f"{where}: give {' or '.join(given)}, not both")
    if isinstance(part, tuple):
        for k, inner in enumerate(part):
            check_choices(inner, f"{where}[{k}]")
    elif is_dataclass(part) or isinstance(part, Mapping):
        for key, inner in (part if isinstance(part, Mapping) else vars(part)).items():
            check_choices(inner, f"{where}.{key}" if where else key)


def _check_effects(effects: Effects, contacts: Collection[str], actuators: Mapping[str, Any]) -> None:
    for name in effects.names:
        for needed in EFFECTS[name].law.needs:
            if needed not in effects.names:
                raise SceneError(f"effects.{name}: means nothing without {needed}; name effects.{needed} as well")
    taken = dict.fromkeys(actuators, "actuators") | {"gravity": "effects"}
    for kind in (*LOADS, *ACTUATORS):
        for name in getattr(effects, kind) if EFFECTS[kind].several else ():
            if name in taken:
                raise SceneError(f"effects.{kind}.{name}: the name is taken by {taken[name]}.{name}")
            taken[name] = f"effects.{kind}"
    for name, guide in guides_of(effects).items():
        if name in taken:
            raise SceneError(
                f"effects.tendon.{guide.tendon}: friction at its guide {name!r}: the name is {taken[name]}'s"
            )
    for name, chamber in effects.pressure.items():
        check_filling(chamber.control, chamber.gas, chamber.valve, f"effects.pressure.{name}")
    for name, fixed in effects.point_masses.items():
        if fixed.direction is not None and not any(fixed.direction):
            raise SceneError(f"effects.point_masses.{name}.direction: use any direction but zero")
    for name, part in effects.rigid_parts.items():
        largest = max(part.inertia)
        if 2 * largest > (1 + ROUND_OFF) * sum(part.inertia):
            raise SceneError(
                f"effects.rigid_parts.{name}.inertia = {list(part.inertia)}: no body has such moments; use the "
                f"largest, {exactly(largest)}, at most the sum of the other two, {exactly(sum(part.inertia) - largest)}"
            )
    for name, motion in effects.base_motion.items():
        if not any(motion.direction):
            raise SceneError(f"effects.base_motion.{name}.direction: use any direction but zero")
    for name, support in effects.driven_support.items():
        if not any(support.direction):
            raise SceneError(f"effects.driven_support.{name}.direction: use any direction but zero")
    if effects.viscoelasticity is not None:
        _check_branches(effects.viscoelasticity)
    if effects.large_deformation is not None:
        try:
            isochoric_terms(effects.large_deformation.law)
        except ValueError as error:
            raise SceneError(f"effects.large_deformation.constants: {error}") from None
    if effects.contact is not None:
        _check_contact(effects.contact, contacts, has_inertia=effects.inertia is not None)


def _check_temperatures(file: SceneFile) -> None:
    """Checks that temperatures strain something, and that what they act with takes them."""
    materials = {"material": file.material} if file.materials is None else file.materials
    expanding = [name for name, material in materials.items() if material is not None and material.expansion]
    for name, material in materials.items():
        if material is not None and material.expansion is not None and not (file.effects.temperature and expanding):
            where = "material" if file.materials is None else f"materials.{name}"
            raise SceneError(f"{where}.expansion: has no effect; use another than 0, with effects.temperature")
    for name, temperature in file.effects.temperature.items():
        where = f"effects.temperature.{name}"
        if not expanding:
            raise SceneError(f"{where}: means nothing where no material expands; give material.expansion, 1/K, as well")
        if temperature.amplitude is not None and temperature.table is not None:
            raise SceneError(f"{where}: give amplitude or table, not both")
        if file.effects.large_deformation is not None:
            raise SceneError(
                f"{where}: with effects.large_deformation strains that are not elastic have no place in the tables of "
                "reduced bodies; leave one of both out"
            )
        if file.effects.viscoelasticity is not None:
            raise SceneError(
                f"{where}: with effects.viscoelasticity branches would resist expansion itself; leave one of both out"
            )
        if file.mesh.integration == "selective":
            raise SceneError(f"{where}: with mesh.integration = 'selective' it is not computed; use 'full'")


def _check_branches(viscous: Viscoelasticity) -> None:
    if len(viscous.ratios) != len(viscous.times):
        raise SceneError(
            f"effects.viscoelasticity: ratios are {len(viscous.ratios)}, times {len(viscous.times)}: use one of "
            "each for every branch"
        )


def _check_tolerance(file: SceneFile) -> None:
    """Checks that errors of outputs are told where they are to be small, and looked at where a model follows them."""
    run = file.run
    if run is None:
        return
    displaced = any(output.quantity != TOUCH for output in file.outputs.values())
    if run.error_tolerance is not None and not (run.errors and displaced):
        lacks = "run.errors = true" if displaced else "[outputs] of displacements"
        raise SceneError(f"run.error_tolerance: is of errors of outputs that a run tells; use it with {lacks}")
    if run.enrich and run.error_tolerance is None:
        raise SceneError("run.enrich: adds directions beyond run.error_tolerance; use it with that")


def _check_frame(file: SceneFile) -> None:
    """Checks what goes with a moving frame, and what goes with it alone."""
    effects, run = file.effects, file.run
    carried = bool(file.supports.clamped or file.supports.held)
    if file.frame == "fixed":
        if effects.base_path is not None:
            raise SceneError("effects.base_path: carries a body whose frame moves; use it with frame = 'moving'")
        if effects.large_deformation is not None and effects.large_deformation.training is not None:
            raise SceneError(
                "effects.large_deformation.training: is of a frame that moves; use it with frame = 'moving'"
            )
        if run is not None and run.detail != "full":
            raise SceneError(f"run.detail = {run.detail!r}: use 'full', or any with frame = 'moving'")
        turn = (run.initial.rotation if run and run.initial else None) or ZERO
        for k, angle in enumerate(turn):
            if abs(angle) > SMALL_ROTATION:
                raise SceneError(
                    f"run.initial.rotation[{k}] = {exactly(angle)}: use at most {SMALL_ROTATION:g} rad, or any "
                    "with frame = 'moving'"
                )
        return
    if effects.inertia is None and not carried:
        raise SceneError(
            "frame = 'moving': a body without inertia that nothing holds has no equilibrium; name effects.inertia, or "
            "supports for a base to carry it by"
        )
    if effects.base_motion and not carried:
        raise SceneError("effects.base_motion: shakes what is clamped, and nothing is; name supports, or leave it out")
    for name in effects.driven_support if not carried else ():
        raise SceneError(
            f"effects.driven_support.{name}: moves nodes relative to what is clamped, and nothing is; name supports, "
            "or take frame = 'fixed'"
        )
    for name, spring in effects.springs.items():
        if spring.sliding:
            raise SceneError(f"effects.springs.{name}.sliding: use it with frame = 'fixed'")
    for name, fixed in effects.point_masses.items():
        if fixed.direction is not None:
            raise SceneError(
                f"effects.point_masses.{name}.direction: a weight on a thread pulls along it alone only while the body "
                "hardly turns or moves aside, else it swings; use it with frame = 'fixed', or without direction"
            )
    training = None if effects.large_deformation is None else effects.large_deformation.training
    for key in ("accelerations", "angular_accelerations") if training is not None and not carried else ():
        if any(getattr(training, key)):
            raise SceneError(
                f"effects.large_deformation.training.{key}: are those of a base, and nothing is clamped; use spins "
                "of a free body, as its loads say the rest"
            )
    if training is not None and effects.inertia is None:
        raise SceneError(
            "effects.large_deformation.training: means nothing without inertia; name effects.inertia as well"
        )
    if effects.base_path is not None and not carried:
        raise SceneError("effects.base_path: carries what is clamped, and nothing is; name supports, or leave it out")


def check_paths(file: SceneFile) -> None:
    """Checks paths of the base and of obstacles, after tables were read; SceneError where nothing can move so."""
    obstacles = {} if file.effects.contact is None else file.effects.contact.obstacles
    moving: dict[str, RigidBase | ObstacleMotion | None] = {"effects.base_path": file.effects.base_path}
    moving |= {f"effects.contact.obstacles.{name}.motion": each.motion for name, each in obstacles.items()}
    for where, motion in moving.items():
        path = None if motion is None else motion.table
        if path is not None and (mistake := path.mistake(None if file.run is None else file.run.duration)):
            raise SceneError(f"{where}.table: {mistake}")


def check_meshes(file: SceneFile) -> None:
    """Checks obstacles that are meshes, after their files were read; SceneError where one is no solid."""
    obstacles = {} if file.effects.contact is None else file.effects.contact.obstacles
    for name, described in obstacles.items():
        if described.file is not None:
            obstacle_of(described, f"effects.contact.obstacles.{name}")


def _check_contact(contact: Contact, contacts: Collection[str], *, has_inertia: bool) -> None:
    if not (contact.obstacles or contact.self_contact):
        raise SceneError(
            "effects.contact.obstacles: at least one is needed, as [effects.contact.obstacles.NAME]; or self_contact, "
            "of a body that touches itself"
        )
    for name in contact.self_contact:
        check_known("contact mode", name, contacts, SceneError, "effects.contact.self_contact: ")
    for name, described in contact.obstacles.items():
        obstacle_of(described, f"effects.contact.obstacles.{name}")
    penalty = contact.method == "penalty"
    if penalty and contact.stiffness is None:
        raise SceneError("effects.contact.stiffness is missing: the spring of method = 'penalty' at every point, N/m")
    for key in ("stiffness", "damping"):
        if getattr(contact, key) is not None and not penalty:
            raise SceneError(f"effects.contact.{key}: goes with method = 'penalty'; a rigid obstacle has none")
    if contact.points == FACES and not contact.obstacles:
        raise SceneError("effects.contact.points = 'faces': there is no obstacle to meet them")
    if contact.restitution and (penalty or not has_inertia):
        raise SceneError("effects.contact.restitution: goes with inertia and method = 'complementarity'")


def check_load(
    load: LoadEntry, where: str, duration: float, contacts: Collection[str], actuators: Collection[str]
) -> None:
    """Checks a load of a run; SceneError where it acts on nothing, or never."""
    if load.contact is not None and load.contact not in contacts:
        raise SceneError(f"{where}.contact: {unknown('contact mode', load.contact, contacts)}")
    if load.actuator is not None and load.actuator not in actuators:
        raise SceneError(f"{where}.actuator: {unknown('actuator', load.actuator, actuators)}")
    if load.start >= duration:
        raise SceneError(
            f"{where}.start = {exactly(load.start)}: use less than the run's duration, {exactly(duration)} s"
        )
    stop = duration if load.stop is None else load.stop
    if stop <= load.start:
        raise SceneError(f"{where}.stop = {exactly(stop)}: use more than start, {exactly(load.start)} s")


def check_pushes(loads: Collection[AppliedLoad], effects: Effects, together: Mapping[str, tuple[str, ...]]) -> None:
    """Checks that a run's loads leave one contact mode active at a time, where obstacles do not say which it is.

    `together`: contact modes that are made of others.
    """
    pushes = sorted((load for load in loads if load.contact), key=lambda load: load.start)
    for last in pushes:
        active = {str(load.contact): load for load in pushes if load.start <= last.start < load.stop}
        if len(active) > 1 and not any({name, *parts} >= set(active) for name, parts in together.items()):
            names = ", ".join(f'"{name}"' for name in sorted(active))
            raise SceneError(
                f"run.load: at {last.start:g} s {' and '.join(map(repr, active))} are pushed at the same time, but one "
                f"contact mode acts at a time; make one of them: [contacts.NAME] with together = [{names}]"
            )
    if pushes and effects.contact is not None and effects.contact.switching == "automatic":
        raise SceneError(
            "effects.contact.switching = 'automatic': the contact mode follows the obstacles, so run.load can push "
            "with actuators only; use 'scene' beside contacts in run.load"
        )
