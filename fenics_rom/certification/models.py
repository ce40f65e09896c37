"""Models of the soft bodies of a world: as it reduces them, and finer ones that tell their error.

Finer are models in all modes, which are the full order of linear bodies. Of bodies that deform largely, and of those
with many unknowns, they are of twice the order: these give an estimate, and it is said.
"""

from typing import NamedTuple

from fenics_rom.errors import SceneError
from fenics_rom.io.progress import Report
from fenics_rom.lazy_import import load
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_format import WorldScene

MOST_MODES = 2000  # whose basis takes 32 MB, and a step in a world about a second


class Models(NamedTuple):
    """Of soft bodies, by name.

    Attributes:
        reduced, finer: models.
        notes: of which bodies the finer model is not the full order, and why.
    """

    reduced: dict[str, Rom]
    finer: dict[str, Rom]
    notes: tuple[str, ...]


def models_of(scene: WorldScene, report: Report) -> Models:
    """Reduced models of the soft bodies of a world, and finer ones.

    Raises:
        SceneError: a body of a ROM file, whose full order is not at hand.
        MeshError, SolverError: as `assemble` and `reduce`.
    """
    reduced, finer, notes = dict[str, Rom](), dict[str, Rom](), []
    soft = {name: body for name, body in scene.file.bodies.items() if body.shape is None}
    for k, (name, body) in enumerate(soft.items()):
        report("models", k, len(soft))
        where = f"{scene.source}: bodies.{name}"
        if body.scene is None:
            raise SceneError(f"{where}: is of a ROM, whose error cannot be told without its scene; use a scene")
        described = load("scene.file", "read_scene")(scene.folder / body.scene)
        system = load("fem.assemble", "assemble")(described)
        reduce = load("reduction.reduce", "reduce")
        reduced[name] = reduce(system)
        size = system.elastic_size
        many = f"of its {size} modes, more than {MOST_MODES} are too many to run"
        why = many if described.effects.large_deformation is None else "it deforms largely"
        if why == many and size <= MOST_MODES:
            finer[name] = reduce(system, order=size, method="modal")
        else:
            most = max(mode.order for mode in reduced[name].contact_models.values())
            finer[name] = reduce(system, order=min(2 * most, size))
            notes.append(f"the error of the reduction of {name!r} is an estimate, by twice its order ({most}): {why}")
    report("models", len(soft), len(soft))
    return Models(reduced, finer, tuple(notes))
