"""ROMs and runs as files of other programs: what each can become, and how."""

from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import check_flag, is_number, names_in, path_in
from fenics_rom.deployment.plant import PLANT_FORMATS, write_plant
from fenics_rom.errors import FileError, check_known, exactly, shown
from fenics_rom.io.given import object_or_file
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.obstacle_poses import with_turns
from fenics_rom.mechanics.readings import TENSORS
from fenics_rom.mechanics.touch import TouchState
from fenics_rom.rom.file import ROM_FILE
from fenics_rom.rom.rom import Rom
from fenics_rom.trajectory.elastic_part import deformation
from fenics_rom.trajectory.file import RUN_FILE
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.contact_fields import ContactFields, traction_arrows
from fenics_rom.visualization.exports.body_renderer import DISPLACEMENT, BodyRenderer, Quantity
from fenics_rom.visualization.exports.mode_shapes import SHAPE_KINDS, mode_shapes, write_sheet
from fenics_rom.visualization.exports.paraview import Fields, write_grid, write_series
from fenics_rom.visualization.exports.pictures import write_film, write_still
from fenics_rom.visualization.optional_dependencies import pyvista_package

VTK_COMPONENTS = [0, 1, 2, 5, 3, 4]  # of xx, yy, zz, yz, xz, xy: VTK has xx, yy, zz, xy, yz, xz
SHEET_FORMATS = (".png", ".pdf", ".svg")
ROM_FORMATS = (".vtu", *SHEET_FORMATS, *PLANT_FORMATS)
FILM_FORMATS = (".gif", ".mp4")
PICTURE_FORMATS = (".png", *FILM_FORMATS)
RUN_FORMATS = (".pvd", ".vtu", *PICTURE_FORMATS)
CONTACT_PRESSURE = "contact_pressure"
COLOURS = ("displacement", CONTACT_PRESSURE)  # of pictures of a run
SHEET_SHAPES = 6  # shapes of each contact mode on a sheet
FRAMES_PER_SECOND = 20  # of a film
DEFAULT_MAX_SECONDS = 10.0  # how long a film is at most, unless it is told
MAX_SECONDS = 3600.0
WIDTH_PIXELS, FILM_WIDTH_PIXELS = 1000, 720


def export(
    model: Rom | Trajectory | str | PathLike[str],
    output: str | Path,
    *,
    what: str | None = None,
    count: int | None = None,
    time: float | None = None,
    scale: float = 1.0,
    colour: str | None = None,
    seconds: float | None = None,
    dark: bool = False,
    dt: float | None = None,
    outputs: Sequence[str] | None = None,
    at: Any = None,
    force: bool = False,
    report: Report = silent,
) -> Path:
    """Writes a ROM's shapes or linear models, or a run, as a file that others read; nothing of it where it fails.

    Of a ROM: .vtu, for ParaView, every shape a field on the nodes; .png, .pdf, .svg, a sheet of the first shapes of
    each contact mode; .npz, .mat, the state spaces of all contact modes, and the maps between them; .c, .fmu, the same
    model in C with a header beside it, and as an FMU. Of a run: .pvd with a folder of .vtu files, displacement (m),
    velocity (m/s), contact pressure and traction (Pa), inputs and readings at each instant of which it holds the whole
    shape; .vtu or .png of one instant; .gif or .mp4 of all. Cells are the triangles of the surface, and points all
    nodes.

    Args:
        model: the ROM or the run, or the name of its file.
        output: the file; its ending says what becomes of it.
        what: of a ROM: "modes", the directions that lower orders keep, the most important first (balanced modes, if
            it is balanced); "eigenvectors" of its reduced models; or "rest", its shapes at rest under unit inputs.
            None: modes.
        count: of shapes of each contact mode; None: six on a sheet, all in a file for ParaView.
        time: of one instant, s; the nearest one of which there is a shape is taken. None: the last.
        scale: by which displacements are multiplied in pictures, of a moving frame those that strain the body; ParaView
            does so itself.
        colour: what pictures of a run show: "displacement", of bodies that turn what strains them; or
            "contact_pressure", with arrows of traction and through obstacles. None: displacement.
        seconds: how long a film is to be. None: as many pictures as there are shapes, but not longer than ten seconds.
        dark: light on dark instead of dark on light, in pictures.
        dt: time step of linear models, s; None: continuous time, in C that of the scene's run.
        outputs: names of those that linear models read; None: all.
        at: of a body that is not linear: the state about which linear models hold, in whose contact mode: a Simulator,
            what its `save` gave, or a run of the ROM (its end), or the name of its file; None: rest at the start.
        force: whether an existing file of another kind is written over.
        report: called with the stage, how much of it is done, and of how much.

    Returns:
        The file.

    Raises:
        FileError: another ending, a file that cannot be written, is the model's own or of another kind, or a run
            without what was asked for.
        SceneError: there is no such kind of shape, no surface, or neither a ROM nor a run.
        StepError: as `Rom.state_space`.
        MissingPackageError: a package is not installed.
        FenicsRomError: PyVista was imported after dolfinx by somebody else; VTK would abort.

    Example:
        >>> fr.export(rom, "modes.vtu").name
        'modes.vtu'
    """
    place, given = path_in("export", output), object_or_file("export", model, ROM_FILE, RUN_FILE)
    check_flag("dark", dark, FileError)
    if outputs is not None:
        outputs = names_in("outputs", outputs, FileError)
    endings, kind = (ROM_FORMATS, "a ROM") if isinstance(given, Rom) else (RUN_FORMATS, "a run")
    if place.suffix not in endings:
        raise FileError(f"{place}: {kind} becomes a file that ends in {', '.join(endings)}")
    files = [place, *([place.with_suffix(".h")] if place.suffix == ".c" else [])]
    check_outputs(*files, inputs=[model] if isinstance(model, str | PathLike) else [], force=force)
    if place.suffix in PLANT_FORMATS and isinstance(given, Rom):
        if what is not None or count is not None or time is not None:
            raise FileError(f"{place}: has neither shapes nor instants; --what, --count and --time are for other files")
        if isinstance(at, str | PathLike):
            at = object_or_file("export: at", at, RUN_FILE)
        write_plant(place, given, outputs, dt, at)
        return place
    if dt is not None or outputs is not None or at is not None:
        raise FileError(f"{place}: --dt, --outputs and --at are for models of ROMs: {', '.join(PLANT_FORMATS)}")
    pyvista_package()
    if isinstance(given, Rom):
        if time is not None:
            raise FileError(f"ROM {given.name!r} has no instants; --time is for runs")
        if colour is not None:
            raise FileError(f"ROM {given.name!r} touches nothing by itself; --colour is for runs")
        _export_rom(place, given, next(iter(SHAPE_KINDS)) if what is None else what, count, dark)
    else:
        if what is not None or count is not None:
            raise FileError(f"run {given.name!r} has no modes; --what and --count are for ROMs")
        _export_run(place, given, time, colour, scale, seconds, dark, report)
    return place


def _said(given: Any) -> str:
    return exactly(given) if is_number(given) else shown(given)


def _export_rom(place: Path, rom: Rom, kind: str, count: int | None, dark: bool) -> None:
    if count is not None and not (is_number(count, whole=True) and count >= 1):
        raise FileError(f"--count {shown(count)}: use whole numbers from 1")
    if place.suffix in SHEET_FORMATS:
        write_sheet(place, rom, kind, SHEET_SHAPES if count is None else count, dark)
        return
    fields: dict[str, Array] = {}
    whole: dict[str, Array] = {}
    for name, row in mode_shapes(rom, kind).items():
        kept = row[:count]
        fields |= {f"{name}.{kind}.{shape.number}": shape.displacement for shape in kept}
        numbers = {"frequency": [shape.frequency for shape in kept], "sigma": [shape.σ for shape in kept]}
        whole |= {f"{name}.{key}": np.array(of, dtype=float) for key, of in numbers.items() if None not in of}
    write_grid(place, rom.nodes, rom.triangles, Fields(fields, whole=whole))


def _export_run(
    place: Path,
    run: Trajectory,
    time: float | None,
    colour: str | None,
    scale: float,
    seconds: float | None,
    dark: bool,
    report: Report,
) -> None:
    if not len(run.triangles) or not len(run.snapshots):
        raise FileError(f"run {run.name!r} has no surface to draw")
    if not (is_number(scale) and scale > 0):
        raise FileError(f"--scale {_said(scale)}: use finite numbers > 0")
    if seconds is not None and not (is_number(seconds) and 0 < seconds <= MAX_SECONDS):
        raise FileError(f"--seconds {_said(seconds)}: use more than 0 and at most {MAX_SECONDS:g}")
    if colour is not None:
        if place.suffix not in PICTURE_FORMATS:
            raise FileError(f"{place}: holds all fields; --colour is for {', '.join(PICTURE_FORMATS)}")
        check_known("colour", colour, COLOURS, FileError)
        if colour == CONTACT_PRESSURE and run.touched is None:
            raise FileError(f"run {run.name!r} keeps no contact: its scene has none, or an earlier release wrote it")
    if time is not None:
        if place.suffix not in (".vtu", ".png"):
            raise FileError(f"{place}: shows all instants; --time is for .vtu and .png")
        if not (is_number(time) and 0 <= time <= run.times[-1]):
            raise FileError(f"--time {_said(time)}: use 0 to {run.times[-1]:g} s, which the run lasts")
    row = len(run.snapshots) - 1 if time is None else int(np.abs(run.snapshot_times - time).argmin())
    if place.suffix == ".pvd":
        touch = _touch_of(run)
        every = [_fields(run, k, touch) for k in range(len(run.snapshots))]
        write_series(place, run.snapshot_times, run.nodes, run.triangles, every)
    elif place.suffix == ".vtu":
        write_grid(place, run.nodes, run.triangles, _fields(run, row, _touch_of(run)))
    elif place.suffix == ".png":
        write_still(place, *_pictures(run, [row], colour, scale, WIDTH_PIXELS, dark, report))
    else:
        shapes = len(run.snapshots)
        length = min(shapes / FRAMES_PER_SECOND, DEFAULT_MAX_SECONDS) if seconds is None else seconds
        wanted = max(1, round(FRAMES_PER_SECOND * length))
        rows = np.unique(np.linspace(0, shapes - 1, min(wanted, shapes)).round().astype(int))
        pictures = _pictures(run, list(rows), colour, scale, FILM_WIDTH_PIXELS, dark, report)
        write_film(place, pictures, FRAMES_PER_SECOND * len(rows) / wanted)


def _touch_of(run: Trajectory) -> ContactFields | None:
    return None if run.touched is None else ContactFields(run)


def _fields(run: Trajectory, row: int, touch: ContactFields | None = None) -> Fields:
    """Of one whole shape, with inputs, reactions and readings of the nearest instant that is kept.

    A reading is not a number (NaN) where it is not read.
    """
    instant = int(np.abs(run.times - run.snapshot_times[row]).argmin())
    on_nodes = {"displacement": run.snapshots[row]}
    if run.velocities is not None:
        on_nodes["velocity"] = run.velocities[row]
    if touch is not None:
        on_nodes |= {"contact pressure": touch.pressure(row), "contact traction": touch.traction(row)}
    on_triangles: dict[str, Array] = {}
    whole = {"TimeValue": run.snapshot_times[[row]]}
    if run.inputs or run.readings or run.reactions or run.frame_series:
        whole["reading.TimeValue"] = run.times[[instant]]
    whole |= {f"input.{name}": series.values[instant] for name, series in run.inputs.items()}
    whole |= {f"reaction.{name}": series.values[instant] for name, series in run.reaction_series.items()}
    whole |= {name: series.values[instant] for name, series in run.frame_series.items()}
    for name, reading in run.readings.items():
        values, key = reading.values[instant], f"reading.{name}"
        if reading.taxels is not None:
            whole |= _felt(reading.at(instant).touch, key)
            if len(reading.taxels.triangles):
                pressures = reading.at(instant).on_surface[0]
                on_triangles[key] = _spread(pressures, reading.taxels.triangles, len(run.triangles))
        elif reading.quantity == "contact_pressure":
            on_nodes[key] = _spread(values, reading.nodes, len(run.nodes))
        elif not len(reading.triangles):
            whole[key] = np.atleast_1d(values)
        else:
            ordered = values[:, VTK_COMPONENTS] if reading.quantity in TENSORS else values
            on_triangles[key] = _spread(ordered, reading.triangles, len(run.triangles))
    return Fields(on_nodes, on_triangles, whole)


def _felt(felt: TouchState, key: str) -> dict[str, Array]:
    """What a sense of touch tells of an instant on the whole, and of patches, by names."""
    others = {name: of for name, of in felt._asdict().items() if name not in ("patches", "pressures")}
    parts = others | {f"patches.{name}": of for name, of in felt.patches._asdict().items()}
    return {f"{key}.{name}": of[0] if of[0].ndim else of for name, of in parts.items()}


def _spread(values: Array, places: Array, count: int) -> Array:
    """Values at some of so many places, and NaN at the others."""
    everywhere = np.full((count, *values.shape[1:]), np.nan)
    everywhere[places] = values
    return everywhere


def _pictures(
    run: Trajectory, rows: list[int], colour: str | None, scale: float, width: int, dark: bool, report: Report
) -> Iterator[Array]:
    """Pictures of some instants, all from one place and in the same colours.

    Of a body that turns as far as it likes displacement is what strains it, and that alone is what is scaled.
    """
    shapes, turns = run.snapshots, run.pose is not None or bool(run.bodies)
    strained = deformation(run, shapes)
    if turns:
        shapes = shapes + (scale - 1) * strained
    quantity, pressed = Quantity("deformation", "m") if turns else DISPLACEMENT, colour == CONTACT_PRESSURE
    values, touch = np.linalg.norm(strained, axis=2), ContactFields(run) if pressed else None
    if touch is not None:
        quantity, values = Quantity("contact pressure", "Pa"), np.array([touch.pressure(k) for k in range(len(shapes))])
        tractions = {row: touch.traction(row) for row in rows}
        most = max(float(np.linalg.norm(traction, axis=1).max()) for traction in tractions.values())
    for body in run.bodies.values():
        if body.kind == "rigid":
            values[:, body.nodes] = np.nan
    motions = with_turns([*run.obstacle_motion.values()])
    moved = np.array(motions).reshape(-1, len(run.snapshots), motions[0].shape[1] if motions else 3).swapaxes(0, 1)
    by = 1.0 if turns else scale
    renderer = BodyRenderer(
        run.nodes,
        run.triangles,
        list(shapes),
        coloured=(quantity, list(values)),
        scale=by,
        obstacles=run.obstacles,
        offsets=moved,
        tendons=run.tendons,
        width=width,
        dark=dark,
        ghost=not run.bodies,
        coloured_triangles=None if touch is None else touch.touchable,
        see_through=pressed,
    )
    digits, size = max(0, int(np.ceil(-np.log10(np.diff(run.snapshot_times, prepend=0.0).min()) - 1e-9))), _size(run)
    try:
        for done, row in enumerate(rows):
            report("pictures", done, len(rows))
            what = "deformation" if turns else "displacements"
            words = f"{run.snapshot_times[row]:.{digits}f} s" + (f", {what} x {scale:g}" if scale != 1 else "")
            arrows = traction_arrows(run.nodes + by * shapes[row], tractions[row], most, size) if pressed else None
            yield renderer.render(shapes[row], moved[row], words, values[row], arrows)
        report("pictures", len(rows), len(rows))
    finally:
        renderer.close()


def _size(run: Trajectory) -> float:
    """Of all bodies of a run at its start, m."""
    return float(np.ptp(run.nodes[run.triangles].reshape(-1, 3), axis=0).max())
