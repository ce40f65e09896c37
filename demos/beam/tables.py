"""Tables of what was found, and of what is foretold beside what was measured."""

import numpy as np
from predictions import Prediction
from recordings import MARKERS, Recording
from relaxation import Found, Law

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

COMSOL_SAG = 16.84e-3  # m, of those who measured it, with 52 g
Predictions = dict[tuple[str, str], Prediction]  # by law and weight


def found_table(elastic: fr.Identification, found: Found) -> str:
    """Both laws' values, with intervals of 95 %."""
    law, width = found.law, found.half_widths
    rows = [
        ("elastic", one.parameter.name, f"{one.value:.4g} {one.parameter.unit}", f"{one.low:.4g} to {one.high:.4g}")
        for one in elastic.estimates
    ]
    rows.append(("", "left over", f"{1e3 * elastic.residual:.3f} mm", ""))
    for name, unit, value, k in (("young, relaxed", "Pa", law.young, 0), ("beta", "s", law.beta, 1)):
        low, high = value * np.exp([-width[k], width[k]])
        rows.append(("relaxing", name, f"{value:.4g} {unit}", f"{low:.4g} to {high:.4g}"))
    levels = " and ".join(f"{1e3 * level:.2f}" for level in found.levels)
    rows += [
        ("", "ratio in a decade", f"{law.ratio:.4f}", f"{law.ratio - width[2]:.4f} to {law.ratio + width[2]:.4f}"),
        ("", "held below level", f"{levels} mm", f"± {1e3 * width[3]:.2f}"),
        ("", "left over", f"{1e3 * found.residual:.3f} mm", ""),
    ]
    return markdown(("law", "", "found", "95 %"), rows)


def comparison(measured: list[Recording], predictions: Predictions) -> str:
    """52 g, measured and foretold."""
    laws = [predictions[law, "52 g"] for law in ("elastic", "relaxing")]
    rows = [
        (f"{marker} (mm)", [-1e3 * r.at_rest[k, 2] for r in measured], [1e3 * p.falls[k] for p in laws], "")
        for k, marker in enumerate(MARKERS)
    ]
    sags = [-1e3 * r.at_rest[:, 2].mean() for r in measured]
    rows.append(("**sag** (mm)", sags, [1e3 * p.sag for p in laws], f"{1e3 * COMSOL_SAG:.2f}"))
    seen, told = ([one.ringing for one in side] for side in (measured, laws))
    rows.append(("**frequency** (Hz)", [r.frequency for r in seen], [r.frequency for r in told], ""))
    rows.append(("decay (1/s)", [r.decay for r in seen], [r.decay for r in told], ""))
    rows.append(
        ("creep (mm for each e-fold of time)", [-1e3 * r.creep for r in seen], [-1e3 * r.creep for r in told], "")
    )
    texts = [
        (what, *(f"{v:.2f}" for v in seen), *(f"{v:.2f} ({v / np.mean(seen) - 1:+.1%})" for v in told), others)
        for what, seen, told, others in rows
    ]
    return markdown(("52 g", "measured, a", "b", "elastic", "relaxing", "COMSOL"), texts)


def foretold(predictions: Predictions, time: float, found: Found | None, law: Law) -> str:
    """What both laws say of both weights after a time, s, with intervals of the sag by the fit where there was one."""
    rows = []
    for (name, weight), told in predictions.items():
        band = f" ± {1e3 * sag_half_width(told, time, found, law):.2f}" if found and name == "relaxing" else ""
        falls = (f"{1e3 * v:.2f}" for v in told.falls)
        ringing = (f"{told.ringing.frequency:.3f}", f"{told.ringing.decay:.2f}")
        rows.append((name, weight, *falls, f"{1e3 * told.sag:.2f}{band}", *ringing))
    return markdown(("law", "weight", *MARKERS, "sag (mm)", "frequency (Hz)", "decay (1/s)"), rows)


def sag_half_width(told: Prediction, time: float, found: Found, law: Law) -> float:
    """Half of the sag's interval of 95 %, m: it goes as 1/E(t), from which the level is taken."""
    whole, left = told.sag + told.level, law.remaining(time)
    slope = np.array([-whole, 0.0, -whole * left / (1 + law.ratio * left), -1.0])
    return 1.96 * float(np.sqrt(slope @ found.covariance @ slope))
