"""Models of the soft bodies of a world: as it reduces them, and in all their modes, which are their full order."""

from fenics_rom.errors import SceneError
from fenics_rom.io.progress import Report
from fenics_rom.lazy_import import load
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_format import WorldScene


def models_of(scene: WorldScene, report: Report) -> tuple[dict[str, Rom], dict[str, Rom]]:
    """Reduced models, and full ones, by the name of the body.

    Raises:
        SceneError: a body of a ROM file, whose full order is not at hand, or one that deforms largely.
        MeshError, SolverError: as `assemble` and `reduce`.
    """
    reduced, full = dict[str, Rom](), dict[str, Rom]()
    soft = {name: body for name, body in scene.file.bodies.items() if body.shape is None}
    for k, (name, body) in enumerate(soft.items()):
        report("models", k, len(soft))
        where = f"{scene.source}: bodies.{name}"
        if body.scene is None:
            raise SceneError(f"{where}: is of a ROM, whose error cannot be told without its scene; allowed is a scene")
        described = load("scene.file", "read_scene")(scene.folder / body.scene)
        if described.effects.large_deformation is not None:
            raise SceneError(
                f"{where}: deforms largely, and no model of all modes tells its error; allowed are small strains"
            )
        system = load("fem.assemble", "assemble")(described)
        reduce = load("reduction.reduce", "reduce")
        reduced[name] = reduce(system)
        full[name] = reduce(system, order=system.elastic_size, method="modal")
    report("models", len(soft), len(soft))
    return reduced, full
