"""Certificates in files: numbers in JSON, models beside it; and the check of one, which runs the worst again.

The file holds the world as its TOML has it, with the tables that this names, the ranges, all runs in the order of the
search, those that tell errors, the limits, and what follows from them. A seal is over all of it and over the models.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import path_in
from fenics_rom.certification.certificate import Certificate, corners_of
from fenics_rom.certification.certify import Strikes
from fenics_rom.certification.impacts import QUANTITIES
from fenics_rom.certification.limits import Limits, read_limits
from fenics_rom.certification.search import search
from fenics_rom.errors import FenicsRomError, FileError
from fenics_rom.io.atomic_write import write_whole
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.file import read_rom, write_rom
from fenics_rom.scene.world_file import parse_world

FORMAT = "certificate of impact 1"
CLOSE = 1e-9  # relative: of sums that another machine may add up in another order
SAME_RUN = 1e-4  # of the largest: of runs on another machine, whose forces are found to 1e-12 in each step
SAMPLES = 3  # runs that are drawn from all others, beside the worst ones


def write_certificate(file: str | Path, certificate: Certificate, *, force: bool = False) -> list[Path]:
    """Writes a certificate and, beside it, its models: all files that it made.

    Raises:
        FileError: a file cannot be written.

    Example:
        >>> fr.write_certificate("impact.json", certificate)  # doctest: +SKIP
        [PosixPath('impact.json'), PosixPath('impact.pad.h5')]
    """
    file = path_in("write_certificate", file)
    models = model_files(file, certificate.roms)
    for name, model in models.items():
        write_rom(model, certificate.roms[name], force=force)
    digests = {name: {"file": path.name, "sha256": _digest(path.read_bytes())} for name, path in models.items()}
    write_whole(file, (json.dumps(_sealed(_written(certificate, digests)), indent=1) + "\n").encode())
    return [file, *models.values()]


def model_files(file: Path, names: Iterable[str]) -> dict[str, Path]:
    """Where the models of bodies of these names are, by name."""
    return {name: file.with_name(f"{file.stem}.{name}.h5") for name in names}


def check_certificate(file: str | Path, *, samples: int = SAMPLES, report: Report = silent) -> Certificate:
    """Reads a certificate, draws all conclusions again from its runs, and runs some of them again.

    These are the worst ones, all with half of the step, and some that are drawn. What finer models give is not run
    again, as they are not at hand.

    Args:
        file: that `write_certificate` made, with its models beside it.
        samples: how many others.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        FileError: it cannot be read, or was altered: the message says what does not fit.

    Example:
        >>> fr.check_certificate("impact.json").is_kept  # doctest: +SKIP
        True
    """
    certificate = read_certificate(file)
    points, peaks = certificate.points, certificate.peaks
    worst = np.unique(peaks.argmax(axis=0))
    others = np.setdiff1d(np.arange(len(points)), worst)
    drawn = np.random.default_rng().permutation(others)[:samples]
    run = certificate.scene.file.run
    assert run is not None
    whole, half = (Strikes(certificate.scene, certificate.roms, dt) for dt in (run.dt, run.dt / 2))
    again = [(whole, points[row], peaks[row]) for row in (*worst, *drawn)]
    again += [(half, *each) for each in zip(points[certificate.compared], certificate.halved, strict=True)]
    for k, (strikes, point, said) in enumerate(again):
        report("runs", k, len(again))
        off = np.abs(strikes(point) - said) / np.maximum(peaks.max(axis=0), np.finfo(float).tiny)
        if (off > SAME_RUN).any():
            quantity = [*QUANTITIES][int(off.argmax())]
            raise FileError(
                f"{file}: was altered: at {strikes.where(point)} the model gives a {quantity} that is "
                f"{off.max():.1e} of the largest away from what is written; at most {SAME_RUN:g}"
            )
    report("runs", len(again), len(again))
    return certificate


def read_certificate(file: str | Path) -> Certificate:
    """Reads a certificate; all that is said in it follows from its runs, which are not run again.

    Raises:
        FileError: it cannot be read, or was altered.

    Example:
        >>> fr.read_certificate("impact.json").points.shape  # doctest: +SKIP
        (25, 2)
    """
    file = path_in("read_certificate", file)
    try:
        given = json.loads(file.read_text())
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise FileError(f"{file}: is no certificate of impact") from error
    if not isinstance(given, dict) or given.get("format") != FORMAT:
        raise FileError(f"{file}: is no {FORMAT}")
    if given != _sealed({key: value for key, value in given.items() if key != "seal"}):
        raise FileError(f"{file}: was altered: the seal does not fit what it holds")
    try:
        return _read(file, given)
    except (AttributeError, LookupError, TypeError, ValueError, FenicsRomError) as error:
        said = str(error) if isinstance(error, FenicsRomError) else f"{type(error).__name__} {error}"
        raise FileError(said if said.startswith(str(file)) else f"{file}: was altered: {said}") from error


def _written(certificate: Certificate, models: Mapping[str, Any]) -> dict[str, Any]:
    scene, cover = certificate.scene, certificate.cover
    raw = {**scene.raw, "bodies": {name: dict(body) for name, body in scene.raw["bodies"].items()}}
    for name, model in models.items():
        raw["bodies"][name].pop("scene", None)
        raw["bodies"][name]["rom"] = model["file"]
    return {
        "format": FORMAT,
        "name": scene.file.name,
        "findings": _findings(certificate),
        "limits": None if certificate.limits is None else vars(certificate.limits),
        "parameters": [vars(each) | {"unit": each.unit} for each in certificate.parameters],
        "warnings": list(certificate.warnings),
        "models": models,
        "world": raw,
        "tables": {name: table.tolist() for name, table in scene.tables.items()},
        "quantities": QUANTITIES,
        "runs": {
            "points": cover.middles.tolist(),
            "peaks": cover.values.tolist(),
            "corners": certificate.corners.tolist(),
        },
        "errors": {"finer": certificate.finer.tolist(), "halved": certificate.halved.tolist()},
    }


def _findings(certificate: Certificate) -> dict[str, Any]:
    return {
        name: {**vars(each), "at": list(each.at), "certified": each.certified, "is_kept": each.is_kept}
        for name, each in certificate.findings.items()
    }


def _read(file: Path, given: dict[str, Any]) -> Certificate:
    roms = {}
    for name, model in given["models"].items():
        path = file.with_name(model["file"])
        try:
            content = path.read_bytes()
        except OSError as error:
            raise FileError(f"{file}: its model {path.name} cannot be read: {error.strerror}") from error
        if _digest(content) != model["sha256"]:
            raise FileError(f"{file}: its model {path.name} is not the one that was certified")
        roms[name] = read_rom(path)
    tables = {name: np.array(rows) for name, rows in given["tables"].items()}
    scene = parse_world(given["world"], str(file), file.parent, tables)
    limits = None if given["limits"] is None else Limits(**given["limits"])
    table = scene.file.certificate
    if table is None or table.region != (limits and limits.region):
        raise FileError("the limits are not those of the region")
    if limits is not None and table.limits is None and limits != read_limits(limits.region):
        raise FileError(f"limits of {limits.region!r} are not those of the table")
    points, peaks = (np.array(given["runs"][key]) for key in ("points", "peaks"))
    known, asked = {tuple(point): value for point, value in zip(points.tolist(), peaks, strict=True)}, []

    def look_up(point: Array) -> Array:
        asked.append(point)
        return known[tuple(point.tolist())]

    cover = search(look_up, points.shape[1], table.tolerance, table.runs)
    if len(asked) != len(points):
        raise FileError("it holds runs that its search did not ask for")
    corners = np.array(given["runs"]["corners"]).reshape(len(corners_of(points.shape[1])), peaks.shape[1])
    finer, halved = (np.array(given["errors"][key]) for key in ("finer", "halved"))
    certificate = Certificate(scene, cover, corners, finer, halved, limits, roms, tuple(given["warnings"]))
    if not finer.shape == halved.shape == (len(certificate.compared), len(QUANTITIES)):
        raise FileError("its errors are not of the middle of the ranges and of the worst runs")
    _check_findings(given["findings"], _findings(certificate))
    return certificate


def _check_findings(given: Mapping[str, Any], found: Mapping[str, Any]) -> None:
    """A FileError where what is said does not follow from the runs."""
    for quantity, finding in found.items():
        for key, value in finding.items():
            said = given[quantity][key]
            same = (
                said == value if isinstance(value, str | bool | None) else np.allclose(said, value, rtol=CLOSE, atol=0)
            )
            if not same:
                raise FileError(f"its {quantity} has {key} = {said}, and from its runs follows {value}")


def _sealed(content: dict[str, Any]) -> dict[str, Any]:
    return {**content, "seal": _digest(json.dumps(content, sort_keys=True).encode())}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
