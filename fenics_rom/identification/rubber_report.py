"""What a fit of tests of rubber leaves in a folder: a scene that runs, a report, the residuals and a picture."""

import csv
import io
from pathlib import Path

import numpy as np

from fenics_rom.arguments import path_in
from fenics_rom.errors import check_type
from fenics_rom.identification.parameters import YOUNG, parameters_of
from fenics_rom.identification.rubber import RubberFit
from fenics_rom.identification.write import FILES, Keys, listed, scene_text, with_warnings
from fenics_rom.io.atomic_write import make_folder, write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.mechanics.isochoric import isochoric_terms
from fenics_rom.mechanics.rubber_tests import nominal_stress
from fenics_rom.visualization.figure import figure_class, write_figure

HEADING = ("test", "values", "stretch", "off, root mean square", "stable at stretches")


def write_rubber_fit(folder: str | Path, fit: RubberFit, *, force: bool = False) -> None:
    """Writes identified.toml, identification.md, residuals.csv, fit.png and fit.pdf; under MPI rank 0 alone writes.

    Args:
        folder: is made where it does not exist.
        fit: what `fit_rubber` found.
        force: whether files of other kinds are written over.

    Raises:
        FileError: the folder cannot be made or written to, or one of the files there was read for the fit, or is of
            another kind.
        MissingPackageError: there is no Matplotlib.

    Example:
        >>> fr.write_rubber_fit("rubber", fr.fit_rubber(fr.read_scene("rubber.toml"), ["rubber.csv"]))
        >>> fr.read_scene("rubber/identified.toml").name
        'plate'
    """
    check_type("write_rubber_fit", fit, RubberFit, "fr.fit_rubber(scene, data)")
    place = path_in("write_rubber_fit", folder)
    if not is_rank_0():
        return
    figure_class()
    read: list[str | Path] = [*fit.scene.files, *(part.file for part in fit.data)]
    check_outputs_in(place, FILES, inputs=read, force=force)
    make_folder(place)
    write_whole(place / "identified.toml", _identified_text(fit, place).encode())
    write_whole(place / "identification.md", markdown_report(fit).encode())
    write_whole(place / "residuals.csv", _residuals(fit).encode())
    _draw(fit, [place / "fit.png", place / "fit.pdf"])


def _identified_text(fit: RubberFit, folder: Path) -> str:
    """The scene with Young's modulus and the constants that were found."""
    young = next(each for each in parameters_of(fit.scene).values() if each.column == YOUNG)
    constants = ", ".join(f"{constant:.8g}" for constant in fit.constants)
    found: dict[Keys, str] = {young.path: f"{fit.young:.8g}"}
    found["effects", "large_deformation", "constants"] = f"[{constants}]"
    return scene_text(fit.scene, found, folder)


def law_lines(fit: RubberFit) -> dict[str, str]:
    """What was found, line by line."""
    return {
        "law": f"{fit.material}, constants = [{', '.join(f'{constant:.5g}' for constant in fit.constants)}]",
        "shear modulus": f"{fit.shear:.5g} Pa at rest",
        "Young's modulus": f"{fit.young:.5g} Pa, with the scene's Poisson's ratio",
        "residual": f"{fit.residual:.3g} Pa (root mean square)",
    }


def rows_of_tests(fit: RubberFit) -> list[tuple[str, ...]]:
    """Under HEADING: each kind of test, what was measured, and where the law is stable."""
    rows: list[tuple[str, ...]] = []
    for test, (least, largest) in fit.stable.items():
        parts = [part for part in fit.data if part.test == test]
        measured = ("0", "-", "-")
        if parts:
            stretch = np.concatenate([part.stretch for part in parts])
            off = np.concatenate([fit.predicted(part) - part.stress for part in parts])
            measured = (
                str(len(off)),
                f"{stretch.min():.3g} to {stretch.max():.3g}",
                f"{np.sqrt(np.mean(off**2)):.3g} Pa",
            )
        rows.append((test, *measured, f"{least:.3g} to {largest:.3g}"))
    return rows


def markdown_report(fit: RubberFit) -> str:
    """Everything in Markdown."""
    parts = [f"# Rubber of {fit.scene.name}\n", listed(law_lines(fit)), markdown(HEADING, rows_of_tests(fit))]
    return with_warnings(parts, fit.warnings)


def _residuals(fit: RubberFit) -> str:
    """Every value, measured and as the law has it, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("file", "test", "stretch", "measured (Pa)", "law (Pa)", "residual (Pa)"))
    for part in fit.data:
        law = fit.predicted(part)
        for values in np.stack([part.stretch, part.stress, law, part.stress - law], axis=1).tolist():
            writer.writerow((part.file, part.test, *(f"{value:.9g}" for value in values)))
    return text.getvalue()


def _draw(fit: RubberFit, files: list[Path]) -> None:
    """Measured stresses, and the law between and a little beyond them."""
    figure = figure_class()(figsize=(5.5, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for color, test in enumerate(fit.stable):
        for part in (part for part in fit.data if part.test == test):
            ends = min(part.stretch.min(), 1.0), 1 + 1.05 * (max(part.stretch.max(), 1.0) - 1)
            stretch = np.linspace(*ends, 200)
            stress = fit.shear * nominal_stress(isochoric_terms(fit.law), test, stretch)
            axes.plot(stretch, 1e-3 * stress, color=f"C{color}", linewidth=1.2)
            axes.plot(part.stretch, 1e-3 * part.stress, "o", color=f"C{color}", markersize=4, label=test)
    axes.set_xlabel("stretch")
    axes.set_ylabel("nominal stress (kPa)")
    axes.set_title(f"{fit.material}, {fit.residual:.2g} Pa off", fontsize=10)
    axes.legend()
    for file in files:
        write_figure(figure, file, dpi=110)
