"""Models of the soft bodies of a world: as it reduces them, and finer ones that tell their error.

Finer are models in all modes, which are the full order of linear bodies; of bodies that deform largely such of twice
the order.
"""

from fenics_rom.errors import SceneError
from fenics_rom.io.progress import Report
from fenics_rom.lazy_import import load
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_format import WorldScene


def models_of(scene: WorldScene, report: Report) -> tuple[dict[str, Rom], dict[str, Rom]]:
    """Reduced models, and finer ones, by the name of the body.

    Raises:
        SceneError: a body of a ROM file, whose full order is not at hand.
        MeshError, SolverError: as `assemble` and `reduce`.
    """
    reduced, finer = dict[str, Rom](), dict[str, Rom]()
    soft = {name: body for name, body in scene.file.bodies.items() if body.shape is None}
    for k, (name, body) in enumerate(soft.items()):
        report("models", k, len(soft))
        where = f"{scene.source}: bodies.{name}"
        if body.scene is None:
            raise SceneError(f"{where}: is of a ROM, whose error cannot be told without its scene; allowed is a scene")
        described = load("scene.file", "read_scene")(scene.folder / body.scene)
        system = load("fem.assemble", "assemble")(described)
        reduce = load("reduction.reduce", "reduce")
        reduced[name] = reduce(system)
        if described.effects.large_deformation is None:
            finer[name] = reduce(system, order=system.elastic_size, method="modal")
        else:
            most = max(mode.order for mode in reduced[name].contact_models.values())
            finer[name] = reduce(system, order=min(2 * most, system.elastic_size))
    report("models", len(soft), len(soft))
    return reduced, finer
