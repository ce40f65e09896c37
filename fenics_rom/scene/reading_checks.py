"""What a reading of a scene has to have, and what goes with it."""

from fenics_rom.errors import SceneError, check_known
from fenics_rom.mechanics.reactions import REACTION
from fenics_rom.mechanics.readings import OF_SURFACE, OF_VOLUME
from fenics_rom.scene.file_format import SceneFile
from fenics_rom.scene.places import given_piece
from fenics_rom.scene.scene import ReadingEntry


def check_reading(reading: ReadingEntry, file: SceneFile, where: str) -> None:
    """Checks what goes with a quantity; SceneError where something is missing, or has no effect."""
    kind, known = {
        "length": ("tendon", file.effects.tendon),
        "volume": ("pressure", file.effects.pressure),
        "contact_pressure": ("contact mode", file.contacts),
    }.get(reading.quantity, ("", {}))
    if reading.quantity == "marker":
        _check_marker(reading, file.frame, where)
    elif reading.quantity == REACTION:
        _check_reaction(file, where)
    elif reading.point is not None:
        raise SceneError(f"{where}.point: goes with a marker and a reaction; {reading.quantity} has none")
    if reading.quantity == "stress":
        if reading.points is None:
            raise SceneError(f"{where}.points is missing: the material points whose stress is read")
        if key := "of" if reading.of is not None else given_piece(reading):
            raise SceneError(f"{where}.{key}: goes with {', '.join(OF_SURFACE)}; stress is read at points")
    elif reading.points is not None:
        raise SceneError(f"{where}.points: goes with stress; {reading.quantity} has none")
    if reading.quantity in OF_VOLUME and file.mesh.integration == "selective":
        raise SceneError(
            f"{where}.quantity = {reading.quantity!r}: with mesh.integration = 'selective' changes of volume have no "
            "value at the surface; use 'stress' at points"
        )
    if not kind:
        return
    if (piece := given_piece(reading)) is not None:
        raise SceneError(f"{where}.{piece}: goes with strain and stress; a {reading.quantity} is that of a {kind}")
    if reading.of is None:
        named = ", ".join(sorted(known)) or "none"
        raise SceneError(f"{where}.of is missing: the {kind} whose {reading.quantity} is read; there is {named}")
    check_known(kind, reading.of, known, SceneError, f"{where}.of: ")
    if reading.quantity == "contact_pressure" and file.effects.contact is None:
        raise SceneError(f"{where}: means nothing without contact; name effects.contact as well")


def _check_reaction(file: SceneFile, where: str) -> None:
    if not (file.supports.clamped or file.supports.held or file.effects.driven_support):
        raise SceneError(f"{where}: nothing is held; use it with supports, or effects.driven_support")
    if file.frame == "moving":
        raise SceneError(f"{where}: with frame = 'moving' a base bears the body; use its base_wrench, which runs have")


def _check_marker(reading: ReadingEntry, frame: str, where: str) -> None:
    if reading.point is None:
        raise SceneError(f"{where}.point is missing: where the middle of the marker is at rest")
    for key in ("of", given_piece(reading)):
        if key is not None and getattr(reading, key) is not None:
            raise SceneError(f"{where}.{key}: a marker is on the triangle that is nearest to its point")
    if frame == "moving":
        raise SceneError(f"{where}: use outputs.NAME.markers with frame = 'moving', which the frame carries")
