"""The ROM file: one HDF5 file with everything the runtime needs.

Format 2.8. The first 512 bytes are a user block with the SHA-256 of the rest (see io.hdf5).
Root attributes (fixed-length UTF-8 text): format = "fenics-rom", format_version, content = "rom", software, name,
method, switching, weighting, scene (the scene file), warnings (one a line). Every dataset has an attribute `unit`.
Sizes: n free displacement components, k shared basis vectors, N nodes, F triangles; for each contact mode m order,
p input columns, r Hankel singular values, f sampled frequencies; P points of an output.

    basis (n, k) kg^-1/2             Q, QᵀMQ = I; the rigid motions of a body that is not wholly held come first
    stiffness (k,) 1/s^2             κ, QᵀKQ = diag(κ); 0 for these
    springs (k, k) 1/s^2             what of that is springs to the ground; absent where no material relaxes beside them
    free (n,)                        index of each free component among 3 N, or 0 to n - 1 where there is no mesh
    nodes (N, 3) m, triangles (F, 3), node_mass (N,) kg; empty where there is no mesh
    cells (4,)                       of the mesh: number, of these near-flat, least and mean radius ratio; may be absent
    outputs/NAME (3P, k) kg^-1/2     C Q; any number of rows where there is no mesh
    actuators/NAME (1,)              number of input columns
    loads/NAME (1,)                  the same of loads with signals of their own; absent where there are none
    contact_surfaces/NAME (s,)       nodes of the surface of a contact mode; none where there is no mesh
    surfaces/NUMBER (s,)             nodes of a surface that has a name; attribute `name`; absent without contact
    points_between/                  contact points beside nodes: nodes, weights (B, c), gap (1,) m; may be absent
    environment/                     what acts in the runs of the scene; see rom.environment_file
    offline/NUMBER (2,) s, B         wall-clock time and peak memory of a stage of the offline work; attribute `name`
    contact_models/NAME/             in the order of the scene
        eigenvalues (m,) 1/s^2       γ; 0 for rigid motions, which come first, the same in all modes
        damping (m,) or (m, m) 1/s
        inputs (m, p) kg^-1/2        G = W_iᵀB_i; contact columns, then actuators', then loads'
        coordinates (k, m)           C_i, W_i = Q C_i
        directions (m, m)            first columns span the models of lower order
        hankel_singular_values (r,)  s^2/kg^1/2 under mass weighting, else s^2/kg; absent where there are none
        static_error (1,)            may be absent
        frequencies (f,) rad/s       ascending; may be absent, with
        transfer_errors (f,)         at these frequencies
        left_inverse (m, k)          only for switching = "oblique"
        contact_points (P,)          nodes that obstacles can touch; absent where there are none
    deformation/                     where the scene has large_deformation; attribute `law`; Q kept points; of the K
                                     vectors that strain, here k: all, but for the rigid motions of a free body
        gradients (3, 3, Q, k)       ∂W_i/∂X_j, kg^-1/2/m; W is the basis, as all contact modes have the same
        weights (Q,) m^3, first_lame, shear (Q,) Pa, viscosity (Q,) s; fibres, as readings have: see rom.fibres_file
        external_damping (k, k) 1/s, springs (k, k) 1/s^2
        training_radius (1,) m kg^1/2, points_of (1,), cubature_error, validation_error (1,); the last may be absent
        pressures/NAME (k, 1 + k + k (k+1)/2) m^2/kg^1/2     force of 1 Pa: of 1, q_i and q_i q_j (i <= j)
        tendons/NAME/points (K, 3) m, shapes (3K, k) kg^-1/2
        bars/NAME/points (2, 3) m, shapes (6, k) kg^-1/2     of rigid surfaces; may be absent
        rims/NAME/points, pieces (G, 3) m, shapes, piece_shapes (3G, k) kg^-1/2      of open surfaces; may be absent
        trained/                     how far training and validation went; absent where it was not kept
            inputs/NAME (1,)         largest of each actuator and load, in the unit of the input
            pushes/NAME (1,) N       largest force on each contact mode
            strains (Q,)             largest at each kept point
            smoothing_time (1,) s    that forces of obstacles are averaged over before they are compared
            accelerations (3,) m/s^2, angular_accelerations (3,) rad/s^2, spins (3,) rad/s     largest along and about
                                     the axes of a moving frame, gravity taken off; absent where none strains the body
    force_validation/                how far contact forces are off; absent where it was not measured
        run (2,) s                   time step and duration from rest
        reduction/NAME (3,)          of force, peak and impulse of an obstacle, relative; in files of earlier releases
        time_step/NAME (3,)          obstacles/NAME (2, 3) of the reduction and of the reduced model's time step
    residual_compliance/             what contact points yield beyond the shared basis; absent where it is not known
        factor (3P, r) m^1/2/N^1/2   L of L Lᵀ + floor, points as in the order of the nodes, then those between; or
        static/                      order (P,), blocks (b, 5), values (v,) m/N of S K⁻¹Sᵀ: see rom.block_matrix
        time_constants (r,) s, floor (1,) m/N, damping (1,) s
        dt (1,) s, errors/NAME (2,)  of the Delassus operator at dt by contact mode, without and with it
    moving_frame/                    of a body that moves as far as it likes, else absent; K = k less rigid motions
        carried (1,)                 1: by a base; 0: the body is free
        origin (3,) m, mass (1,) kg, first_moment (3,) kg m, moment_modes (3, K) kg^1/2
        inertia0 (6,) kg m^2, inertia1 (6, K) kg^1/2 m, inertia2 (6, K, K)       xx, yy, zz, yz, xz, xy
        coupling0 (3, K) kg^1/2 m, coupling (3, K, K)
        stiffening (6, K, K)         what stress takes from inertia2; absent where it is not known
        springs, dashpots (4 + 3K, 4 + 3K)       of what ties nodes to the ground, over 1, X and vectors; may be absent
        wrenches/NAME (6, p)         of the inputs of a contact mode: force, N, and torque about the origin, N m
        torque_modes/NAME (p, 3, K)  what the shape adds to these torques, N/kg^1/2
        output_points/NAME (P, 3) m  of an output, at rest
    error_model/                     what runs need to know their errors; absent if not asked for; rom.error_model_file
    readings/NAME/                   what else is read, absent where nothing is; attributes `quantity`, `of`
        rest (1,) m or m3           of a length or a volume; of touch, reaction: rom.touch_file, rom.reactions_file
        nodes (s,), facets (F, 3, 4, 6 or 9), areas (F,) m^2          of contact_pressure: facets are rows of nodes
        triangles (P,), operator (3, 3, P, k) kg^-1/2/m, first_lame, shear (P,) Pa          of surfaces
        points (G, 3) m, corner_points (K,), corner_weights (K,), value_corners (T,), value_shares (T,),
        place_weights (T, R) or absent, operator, first_lame, shear as above, of T R places or twice as many  of stress
        foot (3, k) kg^-1/2, gradients (2, 3, k) kg^-1/2/m, tangents (2, 3), offset (3,) m  of marker

Before 2.8 there are no fibres, before 2.7 no static, before 2.6 no error_model, before 2.5 no time_constants (0), but
maybe an inertia, not read. Before 2.3 no base path and moving_frame, before 2.2 no residual_compliance, before 2.1 no
readings, cells and force_validation, and nothing in trained. Those of 1.x are read, too: rom.format_1 makes them such.
"""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fenics_rom.errors import FileError, check_known
from fenics_rom.io import hdf5
from fenics_rom.io.given import Kind, object_or_file
from fenics_rom.io.hdf5 import Entry, Sizes
from fenics_rom.io.overwriting import write_over
from fenics_rom.io.stages import Stage
from fenics_rom.mechanics.body_facts import CellQuality
from fenics_rom.mechanics.contact_points import PointsBetween
from fenics_rom.mechanics.environment import SWITCHINGS
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.environment_file import put_environment, take_environment
from fenics_rom.rom.rom import ForceValidation, Rom, check_rom

BODY = {
    "basis": Entry("kg^-1/2", ("n", "k")),
    "stiffness": Entry("1/s^2", ("k",)),
    "springs": Entry("1/s^2", ("k", "k"), optional=True),
    "free": Entry("1", ("n",), "i"),
    "nodes": Entry("m", ("N", 3)),
    "triangles": Entry("1", ("F", 3), "i"),
    "node_mass": Entry("kg", ("N",)),
}
CELLS = {"cells": Entry("1", (4,), optional=True)}
HANKEL_UNIT = {"mass": "s^2/kg^1/2", "nodal": "s^2/kg", "outputs": "s^2/kg"}  # by weighting
MODE = {
    "eigenvalues": Entry("1/s^2", ("m",)),
    "inputs": Entry("kg^-1/2", ("m", "p")),
    "coordinates": Entry("1", ("k", "m")),
    "directions": Entry("1", ("m", "m")),
    "static_error": Entry("1", (1,), optional=True),
    "frequencies": Entry("rad/s", ("f",), optional=True),
    "transfer_errors": Entry("1", ("f",), optional=True),
    "left_inverse": Entry("1", ("m", "k"), optional=True),
    "contact_points": Entry("1", ("P",), "i", optional=True),
}
EMPTY_WHERE_ABSENT = ("hankel_singular_values", "frequencies", "transfer_errors", "contact_points")
STAGE = Entry("s, B", (2,))
SURFACE = Entry("1", ("s",), "i")
ALIKE = {  # groups of arrays by name, each with sizes of its own
    "outputs": Entry("kg^-1/2", ("3P", "k")),
    **dict.fromkeys(("actuators", "loads"), Entry("1", (1,), "i")),
    "contact_surfaces": Entry("1", ("s",), "i"),
}
GROUPS = ("outputs", "actuators", "contact_models", "contact_surfaces", "environment")
MAYBE = (
    *("offline", "loads", "deformation", "force_validation", "readings", "points_between", "residual_compliance"),
    *("moving_frame", "surfaces", "error_model"),
)
FORCE_RUN, FORCE_ERRORS = Entry("s", (2,)), Entry("1", (3,))
BETWEEN = {"nodes": Entry("1", ("B", "c"), "i"), "weights": Entry("1", ("B", "c")), "gap": Entry("m", (1,))}


def write_rom(file: str | Path, rom: Rom | str | PathLike[str], *, force: bool = False) -> None:
    """Writes a ROM, or that of another file; an existing file is replaced only by a complete one.

    Args:
        file: where to.
        rom: what.
        force: whether an existing file that is no ROM is replaced.

    Raises:
        RomFileError: it cannot be written, there is another kind of file, or its parts do not fit each other.
        SceneError, FileError: something else than a ROM was given.
        StructureError: the ROM lacks the structure that passivity rests on.

    Example:
        >>> fr.write_rom("small.h5", fr.truncate(rom, 5))
    """
    given: Rom = object_or_file("write_rom", rom, ROM_FILE)
    write_over(file, "rom", lambda h5: _fill(h5, given), force=force)


def read_rom(file: str | Path) -> Rom:
    """Reads a ROM.

    Raises:
        RomFileError: the file is missing, damaged, of another format, or its model lacks structure.

    Example:
        >>> list(fr.read_rom("plate.h5").contact_models)
        ['tip_left', 'middle']
    """
    return hdf5.read_file(file, "rom", _take, _upgrade)


def _upgrade(h5: h5py.File) -> None:
    from fenics_rom.rom.format_1 import upgrade  # here, as few files are of earlier releases

    upgrade(h5)


ROM_FILE = Kind(Rom, "rom", read_rom)


def _fill(h5: h5py.File, rom: Rom) -> None:
    for names in (rom.outputs, rom.actuators, rom.loads, rom.contact_models):
        hdf5.check_names(names)
    hdf5.put_text(h5, name=rom.name, method=rom.method, switching=rom.switching, weighting=rom.weighting)
    hdf5.put_text(h5, scene=rom.scene_text, warnings="\n".join(rom.warnings))
    sizes: Sizes = {}
    hdf5.put_arrays(h5, BODY, sizes, vars(rom))
    if rom.cells is not None:
        hdf5.put_arrays(h5, CELLS, sizes, {"cells": rom.cells.array})
    for kind, entry in ALIKE.items():
        if kind in GROUPS or getattr(rom, kind):
            hdf5.put_each(h5, kind, entry, getattr(rom, kind), sizes)
    if rom.points_between is not None:
        hdf5.put_arrays(h5.create_group("points_between"), BETWEEN, {}, vars(rom.points_between))
    put_environment(h5, rom.environment)
    hdf5.put_each(h5, "offline", STAGE, {str(k): (of.seconds, of.peak_memory) for k, of in enumerate(rom.stages)})
    for number, stage in enumerate(rom.stages):
        hdf5.put_text(h5["offline"][str(number)], name=stage.name)
    if rom.surfaces:
        numbers = {str(k): nodes for k, nodes in enumerate(rom.surfaces.values())}
        hdf5.put_each(h5, "surfaces", SURFACE, numbers)
        for key, name in zip(numbers, rom.surfaces, strict=True):
            hdf5.put_text(h5["surfaces"][key], name=name)
    models = h5.create_group("contact_models", track_order=True)
    for name, mode in rom.contact_models.items():
        table = _mode_table(rom.weighting, dense=mode.damping.ndim == 2)
        arrays = vars(mode) | {key: None for key in EMPTY_WHERE_ABSENT if not len(getattr(mode, key))}
        hdf5.put_arrays(models.create_group(name, track_order=True), table, {"k": sizes["k"]}, arrays)
    if rom.deformation is not None:
        from fenics_rom.rom.deformation_file import put_deformation  # here, as few bodies deform largely

        put_deformation(h5, rom.deformation)
    if rom.force_validation is not None:
        _put_forces(h5, rom.force_validation)
    if rom.readings:
        from fenics_rom.rom.readings_file import put_readings  # here, as few bodies have some

        put_readings(h5, rom)
    if rom.residual_compliance is not None:
        from fenics_rom.rom.residual_compliance_file import put_residual_compliance  # here, as few bodies touch

        put_residual_compliance(h5, rom.residual_compliance)
    if rom.moving_frame is not None:
        from fenics_rom.rom.moving_frame_file import put_moving_frame  # here, as few bodies move so far

        put_moving_frame(h5, rom.moving_frame)
    if rom.error_model is not None:
        from fenics_rom.rom.error_model_file import put_error_model  # here, as few runs tell their errors

        put_error_model(h5, rom)
    _check_fit(rom)
    check_rom(rom)


def _take(h5: h5py.File) -> Rom:
    sizes: Sizes = {}
    body = hdf5.get_record(h5, BODY | CELLS, sizes, (*GROUPS, *MAYBE))
    body["cells"] = CellQuality.from_array(body["cells"])
    groups = {name: hdf5.get_group(h5, name) for name in (*GROUPS, *MAYBE) if name in GROUPS or name in h5}
    alike: Any = {kind: hdf5.get_each(groups[kind], entry, sizes) for kind, entry in ALIKE.items() if kind in groups}
    weighting = hdf5.get_text(h5, "weighting")
    models = groups["contact_models"]
    rom = Rom(
        name=hdf5.get_text(h5, "name"),
        method=hdf5.get_text(h5, "method") if "method" in h5.attrs else "balanced",
        switching=hdf5.get_text(h5, "switching"),
        contact_models={name: _take_mode(hdf5.get_group(models, name), weighting, sizes) for name in models},
        environment=take_environment(h5),
        scene_text=hdf5.get_text(h5, "scene"),
        warnings=tuple(filter(None, hdf5.get_text(h5, "warnings").split("\n"))),
        weighting=weighting,
        stages=_take_stages(groups["offline"]) if "offline" in groups else (),
        force_validation=_take_forces(groups["force_validation"]) if "force_validation" in groups else None,
        surfaces=_take_surfaces(groups["surfaces"]) if "surfaces" in groups else {},
        **body,
        **alike,
    )
    if "deformation" in groups:
        from fenics_rom.rom.deformation_file import get_deformation

        rom = replace(rom, deformation=get_deformation(h5, len(rom.stiffness) - rom.rigid))
    if "points_between" in groups:
        rom = replace(rom, points_between=PointsBetween(**hdf5.get_record(groups["points_between"], BETWEEN)))
    if "readings" in groups:
        from fenics_rom.rom.readings_file import take_readings

        rom = replace(rom, readings=take_readings(h5, sizes["k"]))
    if "residual_compliance" in groups:
        from fenics_rom.rom.residual_compliance_file import take_residual_compliance

        rom = replace(rom, residual_compliance=take_residual_compliance(h5))
    if "moving_frame" in groups:
        from fenics_rom.rom.moving_frame_file import take_moving_frame

        rom = replace(rom, moving_frame=take_moving_frame(h5))
    if "error_model" in groups:
        from fenics_rom.rom.error_model_file import take_error_model

        rom = replace(rom, error_model=take_error_model(h5, rom))
    _check_fit(rom)
    return check_rom(rom)


def _mode_table(weighting: str, dense: bool) -> dict[str, Entry]:
    check_known("weighting", weighting, HANKEL_UNIT, FileError)
    damping = Entry("1/s", ("m", "m") if dense else ("m",))
    σ = Entry(HANKEL_UNIT[weighting], ("r",), optional=True)
    return {**MODE, "damping": damping, "hankel_singular_values": σ}


def _take_mode(group: h5py.Group, weighting: str, sizes: Sizes) -> ContactModel:
    damping = group.get("damping")
    dense = isinstance(damping, h5py.Dataset) and damping.ndim == 2
    arrays = hdf5.get_record(group, _mode_table(weighting, dense), {"k": sizes["k"]})
    for key in EMPTY_WHERE_ABSENT:
        if arrays[key] is None:
            arrays[key] = np.empty(0, dtype=int if key == "contact_points" else float)
        elif not len(arrays[key]):
            raise FileError(f"{group.name}/{key} is empty")
    return ContactModel(**arrays)


def _take_stages(group: h5py.Group) -> tuple[Stage, ...]:
    numbers = hdf5.get_record(group, {str(k): STAGE for k in range(len(group))})
    return tuple(Stage(hdf5.get_text(group[key], "name"), *of) for key, of in numbers.items())


def _take_surfaces(group: h5py.Group) -> dict[str, np.ndarray]:
    return {hdf5.get_text(group[key], "name"): nodes for key, nodes in hdf5.get_each(group, SURFACE).items()}


def _put_forces(h5: h5py.File, validation: ForceValidation) -> None:
    hdf5.check_names(validation.reduction)
    group = h5.create_group("force_validation", track_order=True)
    hdf5.put_arrays(group, {"run": FORCE_RUN}, {}, {"run": (validation.dt, validation.duration)})
    for against in ("reduction", "time_step"):
        hdf5.put_each(group, against, FORCE_ERRORS, getattr(validation, against))


def _take_forces(group: h5py.Group) -> ForceValidation:
    run = hdf5.get_record(group, {"run": FORCE_RUN}, others=("reduction", "time_step", "obstacles"))["run"]
    if "obstacles" in group:  # of the reduction and, what nobody needs, of the reduced model's own time step
        both = hdf5.get_each(hdf5.get_group(group, "obstacles"), Entry("1", (2, 3)))
        errors: Any = {"reduction": {name: tuple(rows[0].tolist()) for name, rows in both.items()}, "time_step": {}}
    else:
        errors = {name: hdf5.get_each(hdf5.get_group(group, name), FORCE_ERRORS) for name in ("reduction", "time_step")}
    if min(run) <= 0 or any(min(numbers) < 0 for of in errors.values() for numbers in of.values()):
        raise FileError(f"{group.name}: a time is not positive, or an error is negative")
    return ForceValidation(*run, **errors)


def _check_fit(rom: Rom) -> None:
    """What a shape cannot say: indices that point somewhere, inputs that fit, a switching that exists."""
    check_known("switching", rom.switching, SWITCHINGS, FileError)
    modes, N = rom.contact_models, len(rom.nodes)
    if not modes or not len(rom.stiffness) or any(mode.order == mode.rigid for mode in modes.values()):
        raise FileError("holds no contact modes, or an empty one")
    if any(len(rows) == 0 or (N and len(rows) % 3) for rows in rom.outputs.values()):
        raise FileError("an output does not have three rows a point")
    components = 3 * N or len(rom.free)
    if not _are_indices(rom.free, components) or (np.diff(rom.free) <= 0).any():
        raise FileError(f"/free does not name components among {components}, in ascending order")
    if not _are_indices(rom.triangles, N):
        raise FileError(f"/triangles name nodes beyond {N}")
    if (rom.node_mass < 0).any():
        raise FileError("/node_mass has negative masses")
    if ("large_deformation" in rom.environment.effects) != (rom.deformation is not None):
        raise FileError("large_deformation among the effects and /deformation go together")
    if rom.environment.contact_law is not None and not any(len(mode.contact_points) for mode in modes.values()):
        raise FileError("has contact, and no node that obstacles can touch")
    if not all(_are_indices(nodes, N) for nodes in (*rom.contact_surfaces.values(), *rom.surfaces.values())):
        raise FileError(f"a surface names nodes beyond {N}")
    if rom.points_between is not None and not _are_indices(rom.points_between.nodes, N):
        raise FileError(f"points_between name nodes beyond {N}")
    if any(columns < 0 for columns in (*rom.actuators.values(), *rom.loads.values())):
        raise FileError("an actuator or a load has a negative number of columns")
    if any(stage.seconds < 0 or stage.peak_memory < 0 for stage in rom.stages):
        raise FileError("/offline has a negative time or memory")
    for name, mode in modes.items():
        if rom.contacts[name] < 0:
            raise FileError(f"contact mode {name!r} has fewer input columns than the actuators and loads")
        if (mode.left_inverse is None) == (rom.switching == "oblique"):
            raise FileError(f"contact mode {name!r}: left_inverse goes with oblique switching, and only with it")
        if not _are_indices(mode.contact_points, N):
            raise FileError(f"contact mode {name!r}: contact_points name nodes beyond {N}")
        _check_numbers(f"contact mode {name!r}", mode)
    if rom.readings:
        from fenics_rom.rom.readings_file import check_readings

        check_readings(rom)
    if rom.residual_compliance is not None:
        from fenics_rom.rom.residual_compliance_file import check_residual_compliance

        check_residual_compliance(rom)
    loads = {name: load.columns for name, load in rom.environment.loads.items()}
    if loads != dict(rom.loads):
        raise FileError(f"the loads of the environment are {loads}, those of the models {dict(rom.loads)}")


def _are_indices(array: np.ndarray, count: int) -> bool:
    return not array.size or bool(0 <= array.min() <= array.max() < count)


def _check_numbers(where: str, mode: ContactModel) -> None:
    """What is said of the quality of a mode."""
    ω = mode.frequencies
    if (mode.hankel_singular_values <= 0).any():
        raise FileError(f"{where}: Hankel singular values must be positive")
    if len(ω) != len(mode.transfer_errors):
        raise FileError(f"{where}: frequencies and transfer_errors go together")
    if (ω <= 0).any() or (np.diff(ω) <= 0).any():
        raise FileError(f"{where}: frequencies must be positive, in ascending order")
    if (mode.transfer_errors < 0).any() or (mode.static_error or 0.0) < 0:
        raise FileError(f"{where}: an error is negative")
