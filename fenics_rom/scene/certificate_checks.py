"""What is looked at in a world file's certificate before anything is run."""

from fenics_rom.errors import SceneError, check_known, exactly
from fenics_rom.scene.certificate_format import OF_POSE, BodyRanges, CertificateTable
from fenics_rom.scene.world_format import STANDS_STILL, JointEntry, WorldBody, WorldFile


def check_certificate_table(file: WorldFile) -> None:
    """A SceneError where the certificate of a world file asks for what there is not, or says what has no effect."""
    table = file.certificate
    assert table is not None
    _check_who(table, file)
    if file.run is None:
        raise SceneError("certificate: its runs are as long as [run] says; add one")
    if table.limits is not None and table.region is None:
        raise SceneError("certificate.limits: has no effect without the region, which is a row of it")
    varied = 0
    for name, ranges in table.ranges.items():
        where = f"certificate.ranges.{name}"
        check_known("body", name, file.bodies, SceneError, f"{where}: ")
        given = {key: value for key, value in vars(ranges).items() if value is not None}
        if not given:
            raise SceneError(f"{where}: says nothing; use {', '.join(vars(ranges))}")
        for key, (low, high) in given.items():
            lows, highs = (low, high) if isinstance(low, tuple) else ((low,), (high,))
            for least, most in zip(lows, highs, strict=True):
                if least > most:
                    raise SceneError(
                        f"{where}.{key}: from {exactly(least)} to {exactly(most)}: put the lower one first"
                    )
                varied += least < most
        _check_body(ranges, file.bodies[name], where)
        _check_joined(name, given.keys() & OF_POSE, file, where)
    if not varied:
        raise SceneError("certificate.ranges: nothing changes from low to high; use at least one range")


def joined_to(name: str, file: WorldFile) -> list[str]:
    """A body and all that joints hold to it, directly or through others, but for what stands still."""
    found = [name]
    for body in found:  # which grows meanwhile
        for joint in file.joints:
            ends = {joint.first, joint.second}
            found += sorted(ends - {*found, STANDS_STILL}) if body in ends else []
    return found


def joints_to_world(group: list[str], file: WorldFile) -> list[JointEntry]:
    """Those that hold one of a group to what stands still."""
    ends = [({joint.first, joint.second}, joint) for joint in file.joints]
    return [joint for names, joint in ends if STANDS_STILL in names and names & {*group}]


def _check_who(table: CertificateTable, file: WorldFile) -> None:
    check_known("body", table.body, file.bodies, SceneError, "certificate.body: ")
    own = joined_to(table.body, file)
    for name in table.by:
        check_known("body", name, file.bodies, SceneError, "certificate.by: ")
        if name in own:
            raise SceneError(f"certificate.by: {name!r} is joined to {table.body!r}, or is it: use others")
    rigid = [name for name in (table.body, *table.by) if file.bodies[name].shape is not None]
    if table.body in rigid and len(rigid) > 1:
        raise SceneError(
            f"certificate.by: {rigid[1]!r} and {table.body!r} are rigid: their force grows as the step shrinks, "
            "and nothing tells a pressure; one of both must be soft"
        )
    if len(set(table.by)) < len(table.by):
        raise SceneError(f"certificate.by: use different bodies (got {', '.join(table.by)})")


def _check_body(ranges: BodyRanges, body: WorldBody, where: str) -> None:
    if ranges.mass is not None and body.mass is None:
        raise SceneError(f"{where}.mass: give it to a rigid body with a mass")
    if ranges.pace is not None and body.path is None:
        raise SceneError(f"{where}.pace: give it to a body with a path")
    still = body.shape is not None and body.mass is None and body.density is None
    for key in ("position", "rotation"):
        if getattr(ranges, key) is not None and body.path is not None:
            raise SceneError(f"{where}.{key}: has no effect beside a path, which says where the body is")
    for key in ("velocity", "spin"):
        if getattr(ranges, key) is not None and (still or body.on is not None):
            raise SceneError(f"{where}.{key}: give it to a body that moves freely")


def _check_joined(name: str, keys: set[str], file: WorldFile, where: str) -> None:
    """What is joined moves as one, and about what holds it to the world."""
    if not keys:
        return
    table, group = file.certificate, joined_to(name, file)
    assert table is not None
    for other in group[1:]:
        ranges = table.ranges.get(other)
        if ranges is not None and any(getattr(ranges, key) is not None for key in OF_POSE):
            raise SceneError(f"{where}: is joined to {other!r}, and moves with it: use ranges of one of both")
    held = joints_to_world(group, file)
    refused = sorted(keys & {"position", "velocity"})
    if held and refused:
        raise SceneError(f"{where}.{refused[0]}: is joined to the world; use rotation and spin about its joint")
    if held and (len(held) > 1 or held[0].point is None):
        raise SceneError(f"{where}.{min(keys)}: give it to what one joint with a point holds to the world")
