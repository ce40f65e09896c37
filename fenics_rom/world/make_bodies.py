"""The bodies of a world in motion, of its records."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError, check_known, shown
from fenics_rom.mechanics.base_path import BaseState, checked_base, given_base
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.world.driven import Driven
from fenics_rom.world.free_soft import FreeSoft
from fenics_rom.world.records import STILL, UPRIGHT, RigidBody, SoftBody
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.soft import Soft

FIXED = "world"  # what stands still, as a body of joints
AnyBody = Rigid | Driven | Soft
AT_REST = BaseState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


def make_bodies(
    records: Mapping[str, RigidBody | SoftBody], dt: float, gravity: Sequence[float] | Array, is_met: bool = False
) -> dict[str, AnyBody]:
    """Bodies that begin as their records say, those first that carry others; and the one that stands still.

    `is_met`: whether a body that is alone is joined to this, or touches itself.

    Raises:
        SceneError: a record that is none, or that names who cannot carry it.
        StepError: a pose that is none.
    """
    g = real_numbers_or_nan(gravity)
    if g.shape != (3,) or not np.isfinite(g).all():
        raise SceneError(f"gravity: use three finite numbers, in m/s2 (got {shown(gravity)})")
    bodies: dict[str, AnyBody] = {FIXED: Driven(None, lambda time: AT_REST)}
    for name, record in records.items():
        if name == FIXED:
            raise SceneError(f"body {name!r}: use any other name, as this is of what stands still")
        if isinstance(record, RigidBody):
            bodies[name] = _rigid(name, record, g)
        elif not isinstance(record, SoftBody):
            raise SceneError(f"body {name!r}: use a RigidBody or a SoftBody (got {record!r})"[:200])
    for name, record in records.items():
        if isinstance(record, SoftBody):
            bodies[name] = _soft(name, record, _carrier(name, records, bodies), dt, len(records) == 1 and not is_met)
    return {name: bodies[name] for name in (FIXED, *records)}


def _rigid(name: str, record: RigidBody, gravity: Array) -> Rigid | Driven:
    _check_driven(name, record)
    if record.motion is not None:
        try:
            return Driven(record.shape, given_base(record.motion, "its motion"))
        except StepError as error:
            raise StepError(f"body {name!r}: {error}") from error
    if record.is_driven:
        return Driven(record.shape, given_base(record.pose(f"body {name!r}")))
    try:
        mass, inertia = record.mass_and_inertia()
    except SceneError as error:
        raise SceneError(f"body {name!r}: {error}") from error
    shape = checked_base((record.shape_position, record.shape_rotation, STILL, STILL), f"body {name!r}: shape")
    off = shape.position, rotation_matrix(shape.rotation)
    return Rigid(record.shape, mass, inertia, record.pose(f"body {name!r}"), gravity, off)


def _check_driven(name: str, record: RigidBody) -> None:
    """A SceneError where something is given that has no effect on a body that moves as it is told, or stands still."""
    if not record.is_driven:
        return
    begins = {"position": STILL, "rotation": UPRIGHT, "velocity": STILL, "angular_velocity": STILL}
    given = [key for key in ("density", "mass", "inertia") if getattr(record, key) is not None]
    given += [key for key, default in begins.items() if tuple(getattr(record, key)) != default]
    if record.motion is not None and given:
        raise SceneError(
            f"body {name!r}: {given[0]} has no effect beside its motion, which says where it is and how it moves: "
            "leave one of them out"
        )
    if moves := [key for key in given if "velocity" in key]:
        raise SceneError(
            f"body {name!r}: {moves[0]}: it has neither density nor mass, so it stands still: use it beside one of "
            "them, or a motion"
        )


def _carrier(name: str, records: Mapping[str, RigidBody | SoftBody], bodies: Mapping[str, AnyBody]) -> Driven | None:
    """What carries a soft body; None: nothing does."""
    chain = [name]
    while (on := getattr(records[chain[-1]], "on", None)) is not None:
        check_known("body", on, records, SceneError, f"body {chain[-1]!r}: on: ")
        if on == name and len(chain) == 1:
            raise SceneError(f"body {name!r}: on = {name!r}: use another body, no body carries itself")
        if on in chain:
            raise SceneError(f"body {name!r}: on: {' is on '.join([*chain, on])}: use a chain without a circle")
        chain.append(on)
    if len(chain) == 1:
        return None
    if not isinstance(carrier := bodies.get(chain[1]), Driven):
        raise SceneError(
            f"body {name!r}: on = {chain[1]!r}: use a rigid body with a motion; to one that moves freely "
            "a free soft body can be joined"
        )
    return carrier


def _soft(name: str, record: SoftBody, carrier: Driven | None, dt: float, is_alone: bool) -> Soft:
    where = f"body {name!r}"
    rom = given_rom("SoftBody", record.rom)
    is_free = carrier is None and rom.environment is not None and rom.environment.is_moving
    pose = record.pose(where)
    if not is_free and (pose.velocity.any() or pose.angular_velocity.any()):
        given = f"velocity = {record.velocity!r}, angular_velocity = {record.angular_velocity!r}"
        raise SceneError(f"{where}: {given}: use 0 of a body that is held or carried; a free one has its own")
    kind = FreeSoft if is_free and rom.moving_frame is not None and not rom.moving_frame.carried else Soft
    return kind(name, rom, dt, pose, carrier, record.signals, is_alone)
