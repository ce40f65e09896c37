"""What is kept of each body of a world, and how it is written."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy import ndarray as Array

from fenics_rom.errors import FileError, check_known
from fenics_rom.io import hdf5
from fenics_rom.io.hdf5 import Entry, Sizes

BODY = {
    "rows": Entry("1", (2,), "i"),
    "pose": Entry("m and 1", ("S", 7)),
    "velocity": Entry("m/s and rad/s", ("S", 6)),
    **{name: Entry("J", ("S",)) for name in ("energy", "supplied", "dissipated", "exchanged")},
}

KINDS = ("rigid", "soft")


@dataclass(frozen=True, eq=False)
class BodyTrack:
    """One body of a world in a run.

    Attributes:
        rows: the first of its nodes in the run's, and the one after its last.
        pose: (S, 7) of its centre of mass, or of the frame of a soft body: position, m, and quaternion w x y z.
        velocity: (S, 6) of the same: m/s, and angular velocity, rad/s, in world axes.
        energy: (S,) kinetic and elastic, J.
        supplied, dissipated: (S,) running sums, J, of loads on it and in it; and
        exchanged: what other bodies did to it.
        kind: "rigid" or "soft".
    """

    rows: Array
    pose: Array
    velocity: Array
    energy: Array
    supplied: Array
    dissipated: Array
    exchanged: Array
    kind: str

    @property
    def nodes(self) -> slice:
        """Of the run, that are its."""
        return slice(*self.rows)

    @property
    def stands_still(self) -> bool:
        """Whether its frame does, as that of a body which is held."""
        return bool((self.pose == self.pose[0]).all())


def put_bodies(h5: Any, bodies: Mapping[str, BodyTrack], sizes: Sizes) -> None:
    """Writes the bodies of a world."""
    hdf5.check_names(bodies)
    group = h5.create_group("bodies", track_order=True)
    for name, body in bodies.items():
        of_body = group.create_group(name, track_order=True)
        hdf5.put_arrays(of_body, BODY, sizes, vars(body))
        hdf5.put_text(of_body, kind=body.kind)


def take_bodies(group: Any, sizes: Sizes) -> dict[str, BodyTrack]:
    """Reads them."""
    bodies: dict[str, BodyTrack] = {}
    for name in group:
        of_body = hdf5.get_group(group, name)
        kind, arrays = hdf5.get_text(of_body, "kind"), hdf5.get_arrays(of_body, BODY, sizes)
        check_known("kind", kind, KINDS, FileError, f"{of_body.name}: ")
        bodies[name] = BodyTrack(kind=kind, **arrays)  # type: ignore[arg-type]
    last = 0
    for name, body in bodies.items():
        begin, end = body.rows.tolist()
        if begin != last or not begin <= end <= sizes["N"]:
            raise FileError(f"/bodies/{name}/rows: use nodes of the run, body after body")
        last = end
    return bodies
