"""What a scene's assembly warns of: elements that lock, supports that leave motions, obstacles that pass through."""

from collections.abc import Iterator

import numpy as np

from fenics_rom.errors import StepError, exactly
from fenics_rom.fem.cell_kinds import TETRAHEDRON
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.nodes import STRAIGHT
from fenics_rom.mechanics.active_environment import known_at_start
from fenics_rom.mechanics.hyperelastic import strain_of_excess_damping
from fenics_rom.mechanics.obstacles import smallest_radius
from fenics_rom.mechanics.readings import OF_VOLUME
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

SMALL_STRAIN = 0.05  # what bends a body far strains it by, at least


def warnings_of(scene: Scene, mesh: Mesh, rigid: np.ndarray) -> Iterator[str]:
    """Of the mesh file, elements that lock, and supports: whoever clamps a body may not know that some of it moves."""
    yield from mesh.notes
    if scene.degree == 1 and mesh.bend > STRAIGHT * np.ptp(mesh.points, axis=0).max():
        yield (
            f"curved edges of second-order cells were made straight, as mesh.degree is 1: nodes on them are up to "
            f"{mesh.bend:.3g} m off; mesh.degree = 2 keeps them curved"
        )
    stiffest = max(material.poisson for material in scene.materials.values())
    cells = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra"}[mesh.kind.name]
    selective = 'mesh.integration = "selective"'
    if scene.degree == 1 and scene.integration == "full" and stiffest > 0.45:
        cure = "mesh.degree = 2" if mesh.kind is TETRAHEDRON else selective
        yield (
            f"Poisson's ratio {exactly(stiffest)} on degree 1 {cells}: they lock (too stiff, in bending most of all); "
            f"{cure} is the cure"
        )
    if scene.degree == 2 and scene.integration == "full" and stiffest > 0.49:
        yield (
            f"Poisson's ratio {exactly(stiffest)} on degree 2 {cells}: they are too stiff, and their pressure "
            f"oscillates; {selective} is the cure"
        )
    yield from _overdamped(scene)
    yield from _read_without_branches(scene)
    if (scene.clamped or scene.held) and rigid.shape[1]:
        yield f"supports leave {rigid.shape[1]} rigid motions: the body, or a part of it, is not wholly held"


def _read_without_branches(scene: Scene) -> Iterator[str]:
    """Of stresses that are read of a material that relaxes."""
    effects = scene.effects
    of_stress = ("stress", "von_mises_stress", *OF_VOLUME)
    read = [name for name, reading in scene.readings.items() if reading.quantity in of_stress]
    if effects.viscoelasticity is not None and read:
        added = sum(effects.viscoelasticity.ratios)
        yield (
            f"readings.{', '.join(read)}: stress is read of the relaxed material alone; right after a fast change the "
            f"whole stress of that change is up to {1 + added:.3g} times as large, as branches have not relaxed yet"
        )


def _overdamped(scene: Scene) -> Iterator[str]:
    """Of materials whose branches resist what they take for changes of volume, where their elasticity has none.

    β does not, but branches do: they are passive as their energy is quadratic in Green's strain.
    """
    large = scene.effects.large_deformation
    if scene.effects.viscoelasticity is None or large is None or large.law == "st_venant_kirchhoff":
        return
    for name, material in scene.materials.items():
        strain = strain_of_excess_damping(material.poisson)
        if strain < SMALL_STRAIN:
            yield (
                f"materials.{name}: with Poisson's ratio {exactly(material.poisson)} its branches of viscoelasticity "
                f"resist by a tenth more than effects say where it is strained by {100 * strain:.2g} %, and by the "
                "strain's square, as they act on Green's strain; st_venant_kirchhoff as large_deformation.material is "
                "free of it, and so is damping.beta"
            )


def obstacles_inside(system: System) -> list[str]:
    """What to say of an obstacle that is inside the body at rest where it has no contact points."""
    if not system.contact_points or system.scene is None:
        return []
    environment = system.scene.environment
    if not environment.obstacles or (environment.run is not None and environment.run.initial is not None):
        return []
    shapes, offsets = known_at_start(environment.obstacles)
    skin = system.skin()
    try:
        SkinWatch(skin).check_start(skin.coordinates, displaced(shapes, offsets))
    except StepError as error:
        return [f"{error}; no run can begin so"]
    return []


def obstacles_too_small(system: System) -> list[str]:
    """What to say of obstacles that pass between contact points, or did before there were more of them."""
    if not system.contact_points or system.scene is None or system.scene.environment.touches_faces:
        return []
    body = system.body
    if body.points_between is not None:
        return [
            f"contact: {len(body.points_between.nodes)} points between nodes can be touched, as an obstacle fits in "
            "there; what it presses in is narrower than an element: a finer mesh at the contact surface shows it"
        ]
    radii = {name: smallest_radius(of.shape) for name, of in system.scene.environment.obstacles.items()}
    passing = system.points_of_contact().describe_passing(radii, body.triangles, body.nodes)
    return [passing] if passing else []
