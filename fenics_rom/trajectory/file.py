"""The run file: one HDF5 file, the same for full and reduced runs.

Format 2.8. The first 512 bytes are a user block with the SHA-256 of the rest (see io/hdf5.py).
Root attributes (fixed-length UTF-8 text): format = "fenics-rom", format_version, content = "run",
software, name, model ("full" or "reduced"), contacts, warnings, effects (one a line each), stepping (how a step was
taken and why, where there was a choice). Every dataset has an attribute `unit`. Sizes: S instants (steps + 1), s whole
shapes, N nodes, F triangles, P points of an output.

    times (S,) s, contact (S,)       index of the active contact mode
    energy, supplied, dissipated, lost_in_switching (S,) J, numerical (S,) J; the last is absent if always 0
    snapshot_times (s,) s, snapshots (s, N, 3) m, velocities (s, N, 3) m/s; these may be absent
    nodes (N, 3) m, triangles (F, 3), node_mass (N,) kg
    touched (c,)                     nodes of contact surfaces; absent where nothing can touch the body, as are the next
    contact_forces (s, c, 3) N       on them, in world axes, in the step that led to each shape, and
    contact_pressing (s, c) N        sums of normal forces
    cells (4,)                       of the mesh, as in a ROM; may be absent
    outputs/NAME (S, P, 3) m
    settings/NAME (1,)               dt in s, order; first_frequency in Hz, seconds (wall clock of the steps), mismatch,
                                     every and beyond_training may be absent
    forces/NAME (S, 3) N             of each obstacle on the body; absent where there are none, with
    contact_account/NAME (S,) J      running sums: obstacles (supplied), contact and perhaps friction (dissipated)
    obstacles/NAME/motion (s, 3) m   from where the scene puts it; turn (s, 4), a quaternion w x y z, where it has a
        motion: X is at motion + R X; attribute `shape`, and what describes that:
        point, normal; center, radius; start, end, radius; or center, size, rotation (3,) or (1,); m, 1, rad
    inputs/NAME (S, w)               N, Pa, m, m3, m/s2 or 1; in the step that led to each instant; absent if always 0
    readings/NAME/                   absent where nothing is read; attribute `quantity`
        values                       of length (S,) m, volume (S,) m3, contact_pressure (S, n) Pa, strain (S, G, 6),
                                     surface_stress (S, G, 6) Pa, principal_stress (S, G, 3) Pa,
                                     von_mises_stress, pressure (S, G) Pa,
                                     energy_density (S, G) J/m3, stress (S, p, 11) Pa, marker (S, 3) m, reaction
                                     (S, 6) N and N m; of touch (S, V), see mechanics.touch
        nodes (n,), triangles (G,), points (p, 3) m     where; one of them, or none; of touch the group taxels: see
                                                        io.taxel_map
    tendons/NAME (K, 3) m            points of the body at rest that it leads through; absent where there are none
    pose (S, 7) m and 1              of a moving frame: position, quaternion w x y z; absent in a fixed one, as are
    base_wrench (S, 6) N and N m     force and torque that the base exerts on a carried body
    momentum (S, 6) N s and N m s    linear and angular, about the frame's origin
    reactions/NAME (S,) N or Pa      forces of actuators whose strokes are given; absent where there are none
    bodies/NAME/                     of a world: pose (S, 7) m and 1, velocity (S, 6) m/s and rad/s, energy, supplied,
                                     dissipated, exchanged (S,) J, rows (2,) of its nodes; attribute `kind`; forces are
                                     then of pairs of bodies, FIRST-SECOND on the first
    errors/bound/, errors/estimate/  of a reduced run that stated its own; attribute `why`; may be absent
        norm (S,) J^1/2, shape (S,) kg^1/2 m (both may be absent), outputs/NAME (S, P, 3) m, readings/NAME like the
        values of readings/NAME (may be absent)
    tolerance/                       that such a run was to keep to; attribute `outputs`, a line each; may be absent
        value (1,) m, times (x,) s, errors (x,) m, orders (x, 2)
    profile/NUMBER (1,) s            per step, of a part of the run that attribute `name` names; absent if not measured

Format 2.0 named the snapshots anew; files of format 1.x are read, too. Those of 1.0 and 1.1 name no effects, and have
no forces, obstacles and profile; those of 1.2 have neither velocities nor obstacles; none before 2.1 have inputs,
tendons and readings, none before 2.2 reactions, none before 2.3 a moving frame, none before 2.4 bodies, none before 2.6
contact on nodes and errors.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FileError, check_known, check_type
from fenics_rom.io import hdf5
from fenics_rom.io.given import Kind
from fenics_rom.io.hdf5 import Entry, Sizes
from fenics_rom.io.overwriting import write_over
from fenics_rom.mechanics.body_facts import CellQuality
from fenics_rom.mechanics.obstacles import SHAPES, Obstacle, dimensions_of, shape_of
from fenics_rom.trajectory.bodies import put_bodies, take_bodies
from fenics_rom.trajectory.contact_snapshots import CONTACT, contact_arrays, take_contact
from fenics_rom.trajectory.error_series import ErrorSeries, ErrorTolerance
from fenics_rom.trajectory.series import ReadingSeries
from fenics_rom.trajectory.series_file import check_series, put_misread, put_series, take_misread, take_series
from fenics_rom.trajectory.trajectory import CONTACT_ACCOUNT, Trajectory

RUN = {
    "times": Entry("s", ("S",)),
    "contact": Entry("1", ("S",), "i"),
    **{name: Entry("J", ("S",)) for name in ("energy", "supplied", "dissipated", "lost_in_switching")},
    "numerical": Entry("J", ("S",), optional=True),
    "snapshot_times": Entry("s", ("s",)),
    "snapshots": Entry("m", ("s", "N", 3)),
    "velocities": Entry("m/s", ("s", "N", 3), optional=True),
    "nodes": Entry("m", ("N", 3)),
    "triangles": Entry("1", ("F", 3), "i"),
    "node_mass": Entry("kg", ("N",)),
    "cells": Entry("1", (4,), optional=True),
    "pose": Entry("m and 1", ("S", 7), optional=True),
    "base_wrench": Entry("N and N m", ("S", 6), optional=True),
    "momentum": Entry("N s and N m s", ("S", 6), optional=True),
    **CONTACT,
}
SETTINGS = {
    "dt": Entry("s", (1,)),
    "seconds": Entry("s", (1,), optional=True),
    "order": Entry("1", (1,)),
    "mismatch": Entry("1", (1,), optional=True),
    "first_frequency": Entry("Hz", (1,), optional=True),
    "every": Entry("1", (1,), optional=True),
    "beyond_training": Entry("1", (1,), optional=True),
}
NAMES_IN_FORMAT_1 = {"shape_times": "snapshot_times", "shapes": "snapshots"}  # new ones by old
ALIKE = {  # groups of arrays by name, each with sizes of its own beside those of the run
    "outputs": Entry("m", ("S", "P", 3)),
    "forces": Entry("N", ("S", 3)),
    "contact_account": Entry("J", ("S",)),
    "tendons": Entry("m", ("K", 3)),
    "reactions": Entry("N or Pa", ("S",)),
}
GROUPS = (*("settings", "obstacles", "profile", "inputs", "readings", "bodies", "errors", "tolerance"), *ALIKE)
MOTION = {"motion": Entry("m", ("s", 3)), "turn": Entry("1", ("s", 4), optional=True)}
ERROR_NORMS = {"norm": Entry("J^1/2", ("S",), optional=True), "shape": Entry("kg^1/2 m", ("S",), optional=True)}
ERROR_KINDS = ("bound", "estimate")
TOLERANCE = {
    "value": Entry("m", (1,)),
    "times": Entry("s", ("x",)),
    "errors": Entry("m", ("x",)),
    "orders": Entry("1", ("x", 2), "i"),
}
SECONDS_PER_STEP = Entry("s", (1,))


def write_trajectory(file: str | Path, trajectory: Trajectory, *, force: bool = False) -> None:
    """Writes a run; an existing file is replaced only by a complete one.

    Args:
        file: where to.
        trajectory: what.
        force: whether an existing file that is no run is replaced.

    Raises:
        TrajectoryFileError: it cannot be written, there is another kind of file, or it holds numbers that are not
            finite.
        SceneError: something else than a Trajectory was given.

    Example:
        >>> fr.write_trajectory("again.h5", run)
    """
    check_type("write_trajectory", trajectory, Trajectory, "fr.simulate(model)")
    write_over(file, "run", lambda h5: _fill(h5, trajectory), force=force)


def read_trajectory(file: str | Path) -> Trajectory:
    """Reads a run.

    Raises:
        TrajectoryFileError: the file is missing, damaged or of another format.

    Example:
        >>> fr.read_trajectory("run.h5").steps
        300
    """
    return hdf5.read_file(file, "run", _take, lambda h5: hdf5.rename_all(h5, NAMES_IN_FORMAT_1))


RUN_FILE = Kind(Trajectory, "run", read_trajectory)


def _fill(h5: h5py.File, run: Trajectory) -> None:
    hdf5.check_names([*run.contacts, *run.outputs, *run.forces, *run.reactions])
    hdf5.put_text(
        h5,
        name=run.name,
        model=run.model,
        contacts="\n".join(run.contacts),
        warnings="\n".join(run.warnings),
        effects="\n".join(run.effects),
        stepping=run.stepping,
    )
    sizes: Sizes = {}
    cells = None if run.cells is None else run.cells.array
    numerical = run.numerical if run.numerical.any() else None
    given = {"cells": cells, "numerical": numerical, **contact_arrays(run.touched)}
    hdf5.put_arrays(h5, RUN, sizes, vars(run) | given)
    for kind, entry in ALIKE.items():
        if kind == "outputs" or getattr(run, kind):
            hdf5.put_each(h5, kind, entry, getattr(run, kind), sizes)
    settings = h5.create_group("settings", track_order=True)
    hdf5.put_arrays(settings, SETTINGS, sizes, {name: run.settings.get(name) for name in SETTINGS})
    if run.obstacles:
        obstacles = h5.create_group("obstacles", track_order=True)
        for name, obstacle in run.obstacles.items():
            group, table = obstacles.create_group(name, track_order=True), _dimensions(shape_of(obstacle))
            motion, turn = np.split(run.obstacle_motion[name], [3], axis=1)
            moved = {"motion": motion, "turn": turn if turn.size else None}
            hdf5.put_arrays(group, table | MOTION, sizes, vars(obstacle) | moved)
            hdf5.put_text(group, shape=shape_of(obstacle))
    if run.profile:
        profile = h5.create_group("profile", track_order=True)
        for number, (name, seconds) in enumerate(run.profile.items()):
            hdf5.put_arrays(profile, {str(number): SECONDS_PER_STEP}, sizes, {str(number): seconds})
            hdf5.put_text(profile[str(number)], name=name)
    for kind, stated in run.errors.items():
        part = h5.require_group("errors").create_group(kind)
        hdf5.put_text(part, why=stated.why)
        hdf5.put_arrays(part, ERROR_NORMS, sizes, vars(stated))
        hdf5.put_each(part, "outputs", ALIKE["outputs"], stated.outputs, sizes)
        put_misread(part, stated.readings, sizes)
    if run.tolerance is not None:
        part = h5.create_group("tolerance", track_order=True)
        hdf5.put_text(part, outputs="\n".join(run.tolerance.outputs))
        hdf5.put_arrays(part, TOLERANCE, sizes, vars(run.tolerance))
    put_series(h5, run, sizes)
    if run.bodies:
        put_bodies(h5, run.bodies, sizes)
    _check_fit(run)


def _take(h5: h5py.File) -> Trajectory:
    sizes: Sizes = {}
    arrays = hdf5.get_record(h5, RUN, sizes, GROUPS)
    arrays["cells"] = CellQuality.from_array(arrays["cells"])
    if arrays["numerical"] is None:
        arrays["numerical"] = np.zeros_like(arrays["energy"])
    needed = ("outputs", "settings")
    groups = {name: hdf5.get_group(h5, name) if name in h5 or name in needed else {} for name in GROUPS}
    settings = hdf5.get_record(groups["settings"], SETTINGS, sizes)
    alike: Any = {kind: hdf5.get_each(groups[kind], entry, sizes) for kind, entry in ALIKE.items()}
    moved_obstacles = {
        name: _take_obstacle(hdf5.get_group(groups["obstacles"], name), sizes) for name in groups["obstacles"]
    }
    inputs, readings = take_series(h5, sizes)
    run = Trajectory(
        name=hdf5.get_text(h5, "name"),
        model=hdf5.get_text(h5, "model"),
        settings={name: value for name, value in settings.items() if value is not None},
        contacts=tuple(hdf5.get_text(h5, "contacts").split("\n")),
        warnings=tuple(filter(None, hdf5.get_text(h5, "warnings").split("\n"))),
        effects=tuple(filter(None, hdf5.get_text(h5, "effects").split("\n"))) if "effects" in h5.attrs else (),
        stepping=hdf5.get_text(h5, "stepping") if "stepping" in h5.attrs else "",
        profile=_take_profile(groups["profile"]),
        obstacles={name: obstacle for name, (obstacle, _) in moved_obstacles.items()},
        obstacle_motion={name: motion for name, (_, motion) in moved_obstacles.items()},
        inputs=inputs,
        readings=readings,
        bodies=take_bodies(groups["bodies"], sizes),
        touched=take_contact(arrays, sizes["N"]),
        errors={
            kind: _take_errors(hdf5.get_group(groups["errors"], kind), readings, sizes) for kind in groups["errors"]
        },
        tolerance=_take_tolerance(hdf5.get_group(h5, "tolerance")) if "tolerance" in h5 else None,
        **alike,
        **arrays,
    )
    _check_fit(run)
    return run


def _take_obstacle(group: h5py.Group, sizes: Sizes) -> tuple[Obstacle, Array]:
    """An obstacle, and how far it was from where the scene puts it."""
    shape = hdf5.get_text(group, "shape")
    check_known("shape", shape, SHAPES, FileError, f"{group.name}: ")
    table = _dimensions(shape)
    described = hdf5.get_record(group, table | MOTION, sizes)
    motion, turn = described.pop("motion"), described.pop("turn")
    return SHAPES[shape](**described), motion if turn is None else np.hstack([motion, turn])


def _dimensions(shape: str) -> dict[str, Entry]:
    """What describes an obstacle of a shape."""
    return {name: Entry(*of) for name, of in dimensions_of(shape).items()}


def _take_errors(group: h5py.Group, readings: Mapping[str, ReadingSeries], sizes: Sizes) -> ErrorSeries:
    check_known("kind of error", group.name.rpartition("/")[2], ERROR_KINDS, FileError)
    norms = hdf5.get_record(group, ERROR_NORMS, sizes, ("outputs", "readings"))
    outputs = hdf5.get_each(hdf5.get_group(group, "outputs"), ALIKE["outputs"], sizes)
    return ErrorSeries(
        hdf5.get_text(group, "why"), outputs=outputs, **norms, readings=take_misread(group, readings, sizes)
    )


def _take_tolerance(group: h5py.Group) -> ErrorTolerance:
    outputs = tuple(filter(None, hdf5.get_text(group, "outputs").split("\n")))
    found = ErrorTolerance(outputs=outputs, **hdf5.get_record(group, TOLERANCE))
    if len(outputs) != len(found.times):
        raise FileError(f"{group.name}: {len(outputs)} outputs at {len(found.times)} times")
    return found


def _take_profile(group: Any) -> dict[str, float]:
    seconds = hdf5.get_record(group, {str(k): SECONDS_PER_STEP for k in range(len(group))}) if group else {}
    return {hdf5.get_text(group[key], "name"): of_part for key, of_part in seconds.items()}


def _check_fit(run: Trajectory) -> None:
    """What a shape cannot say: times that pass, indices that point somewhere."""
    for name in ("times", "snapshot_times"):
        if not len(getattr(run, name)) or (np.diff(getattr(run, name)) <= 0).any():
            raise FileError(f"/{name} does not increase, or is empty")
    if not 0 <= run.contact.min() <= run.contact.max() < len(run.contacts):
        raise FileError(f"/contact names contact modes beyond {len(run.contacts)}")
    if run.triangles.size and not 0 <= run.triangles.min() <= run.triangles.max() < len(run.nodes):
        raise FileError(f"/triangles name nodes beyond {len(run.nodes)}")
    if (run.node_mass < 0).any():
        raise FileError("/node_mass has negative masses")
    if run.contact_account.keys() - CONTACT_ACCOUNT.keys():
        raise FileError(f"/contact_account: use {', '.join(CONTACT_ACCOUNT)}")
    check_series(run)
