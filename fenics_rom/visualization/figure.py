"""Matplotlib's figures, which need no screen, in colours that the colour-blind can tell apart."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.visualization.optional_dependencies import load_package

Panel = Callable[[Any], None]  # draws into a figure, or a part of one

DASHES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class Style:
    """Colours of a plot: of background, lines and words, grid, and what is drawn, in the order in which it is."""

    paper: str
    ink: str
    faint: str
    colours: tuple[str, ...]

    @property
    def settings(self) -> dict[str, Any]:
        """Matplotlib's settings, for `matplotlib.rc_context`."""
        from cycler import cycler

        words = dict.fromkeys(
            ("text.color", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color", "axes.edgecolor"),
            self.ink,
        )
        return words | {
            "figure.facecolor": self.paper,
            "axes.facecolor": self.paper,
            "savefig.facecolor": self.paper,
            "legend.facecolor": self.paper,
            "legend.edgecolor": self.faint,
            "grid.color": self.faint,
            "axes.grid": True,
            "axes.axisbelow": True,
            "axes.prop_cycle": cycler(color=self.colours),
            "axes.spines.top": False,
            "axes.spines.right": False,
            "font.size": 8,
            "axes.titlesize": 8,
            "axes.titlelocation": "left",
            "figure.titlesize": 9,
            "legend.fontsize": 7,
            "legend.framealpha": 0.85,
            "axes.linewidth": 0.6,
            "grid.linewidth": 0.4,
            "lines.linewidth": 1.1,
            "lines.markersize": 4,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "xtick.minor.width": 0.4,
            "ytick.minor.width": 0.4,
            "axes.formatter.use_mathtext": True,
            "pdf.fonttype": 42,  # words stay words, which publishers ask for
            "svg.fonttype": "none",
        }


# Okabe & Ito (2008); for dark paper with its black and its blue made lighter.
LIGHT = Style(
    "white", "black", "#d9d9d9", ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
)
DARK = Style(
    "#14171c", "#ececec", "#3a404a", ("#4aa8e8", "#ff7f2a", "#2ac79a", "#e79bc6", "#ffb83d", "#8fd3ff", "#f0f0f0")
)


def figure_class() -> Any:
    """The class of figures; worth asking for before long work. Raises MissingPackageError without Matplotlib."""
    return load_package("matplotlib.figure", 'pictures need Matplotlib: pip install "fenics-rom[plot]"').Figure


def write_figure(figure: Any, file: Path, dpi: int) -> None:
    """Writes a picture in the format of its name's ending, or nothing. Raises FileError where it cannot be written."""
    picture = io.BytesIO()
    figure.savefig(picture, format=file.suffix[1:], dpi=dpi)
    figure.set_layout_engine("none")  # laid out once: that takes half the time, and other formats then look the same
    write_whole(file, picture.getvalue())
