"""Plots of a ROM: how its Hankel singular values fall, and its frequency responses beside the full model's."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.progress import Report
from fenics_rom.io.units import readable
from fenics_rom.rom.file import HANKEL_UNIT
from fenics_rom.rom.rom import Rom
from fenics_rom.system.system import System
from fenics_rom.visualization.figure import Panel, Style

REDUCED_POINTS = 400  # at which a reduced model is asked, beside those around its eigenfrequencies
FULL_POINTS = 40  # at which the full one is
PEAK_OFFSETS = (-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0)  # an eigenfrequency, in half-widths of its peak
FULL_PEAK_OFFSETS = (-1.0, 0.0, 1.0)
MIN_PEAK_DISTANCE = 0.25  # half-widths that frequencies around peaks are apart at least
LOWEST_SHARE, HIGHEST_SHARE = 0.2, 1.2  # of the lowest eigenfrequency and of the highest one that is shown
COLOUR_MAP = "viridis"  # where there are more contact modes than colours


def reduced_panels(rom: Rom, style: Style, full: Mapping[str, tuple[Array, Array, Array]] | None) -> dict[str, Panel]:
    """What there is to draw of a ROM, by name; `full` is its `full_response`, where that was asked for."""
    panels: dict[str, Panel] = {}
    if any(len(mode.hankel_singular_values) for mode in rom.contact_models.values()):
        panels["sigma"] = partial(_draw_hankel_values, rom=rom, style=style)
    if has_frequencies(rom):
        panels["response"] = partial(_draw_response, rom=rom, style=style, full=full)
    return panels


def has_frequencies(rom: Rom) -> bool:
    """Whether it oscillates: a scene without inertia knows equilibria only."""
    return rom.environment.has_inertia


def plotted_frequencies(rom: Rom, points: int, around: Sequence[float]) -> Array:
    """Evenly spread on a logarithmic axis, and denser around the eigenfrequencies that are shown, rad/s, ascending.

    From below the lowest eigenfrequency of all contact modes to above the middle one, up to where the validation goes:
    beyond it a reduced model is not meant to be right. `points` are evenly spread, and those `around` each
    eigenfrequency are in half-widths of its peak.
    """
    ω = [np.sqrt(mode.eigenvalues[mode.rigid :]) for mode in rom.contact_models.values()]
    first = LOWEST_SHARE * min(of_mode[0] for of_mode in ω)
    last = HIGHEST_SHARE * max(of_mode[len(of_mode) // 2] for of_mode in ω)
    peaks: dict[float, float] = {}  # and their half-widths; those of another contact mode may be the same
    for of_mode, mode in zip(ω, rom.contact_models.values(), strict=True):
        damping = (mode.damping if mode.damping.ndim == 1 else np.diag(mode.damping))[mode.rigid :] / 2
        for peak, half in zip(of_mode, damping, strict=True):
            if first <= peak <= last and all(abs(peak - other) > MIN_PEAK_DISTANCE * half for other in peaks):
                peaks[float(peak)] = float(half)
    near = [peak + half * step for peak, half in peaks.items() for step in around]
    every = np.unique(np.concatenate([np.geomspace(first, last, points), near]))
    return every[(every >= first) & (every <= last)]


def full_response(rom: Rom, system: System, report: Report) -> Mapping[str, tuple[Array, Array, Array]]:
    """Frequencies, |H| and |H - H_i| of each contact mode; those of the validation are among them."""
    from fenics_rom.reduction.frequency_response import full_responses  # needs SciPy, which a plot of a run does not

    sampled = [mode.frequencies for mode in rom.contact_models.values()]
    ω = np.unique(np.concatenate([plotted_frequencies(rom, FULL_POINTS, FULL_PEAK_OFFSETS), *sampled]))
    return {name: (ω, full.sizes, full.errors) for name, full in full_responses(system, rom, ω, report).items()}


def response_scale(rom: Rom) -> tuple[float, str]:
    """What turns |H| in M, over the contact's columns, into what is drawn, and its unit.

    Of a body with a mesh the root mean square of its displacement by mass, |H| / √m, in m for a force of 1 N in each
    column; of other matrices |H| itself.
    """
    mass = float(rom.node_mass.sum())
    return (1 / math.sqrt(mass), "m/N") if mass > 0 else (1.0, "")


def reduced_response(rom: Rom, name: str, frequencies: Array) -> Array:
    """|H_i(iω)| of a contact mode in M over its own columns (Frobenius), (f,), without rigid motions."""
    # Here, as it needs SciPy, which a plot of a run does not.
    from fenics_rom.reduction.frequency_response import elastic_response, relative_modulus

    mode, columns = rom.contact_models[name], rom.contacts[name]
    moduli = (relative_modulus(rom.environment, ω) for ω in frequencies)
    responses = (elastic_response(mode, columns, ω, E) for ω, E in zip(frequencies, moduli, strict=True))
    return np.array([np.linalg.norm(H) for H in responses])


def _draw_hankel_values(figure: Any, rom: Rom, style: Style) -> None:
    """σ of each contact mode; what is in the model filled, what was left out empty."""
    axes = figure.subplots()
    for (name, mode), colour in zip(rom.contact_models.items(), _choose_colours(rom, style), strict=True):
        σ, order = mode.hankel_singular_values, mode.order - mode.rigid
        if not len(σ):
            continue
        k = np.arange(1, len(σ) + 1)
        axes.plot(k, σ, color=colour, linewidth=0.6, alpha=0.6)
        axes.plot(k[:order], σ[:order], "o", color=colour, markersize=2.5, label=f"{name}, order {order}")
        axes.plot(k[order:], σ[order:], "o", color=colour, markersize=2.5, fillstyle="none", markeredgewidth=0.6)
    axes.set(
        yscale="log",
        xlabel="number k",
        ylabel=f"σ$_k$ ({readable(HANKEL_UNIT[rom.weighting])})",
        title="Hankel singular values; empty: left out",
    )
    figure.legend(loc="outside lower center", ncols=2)


def _draw_response(figure: Any, rom: Rom, style: Style, full: Mapping[str, tuple[Array, Array, Array]] | None) -> None:
    """|H| of every contact mode, and below it how far the reduced models are from the full one, where that is known."""
    known = full is not None or any(len(mode.frequencies) for mode in rom.contact_models.values())
    above, *below = figure.subplots(1 + known, 1, sharex=True, height_ratios=(3, 2)[: 1 + known], squeeze=False)[:, 0]
    ω, (scale, unit) = plotted_frequencies(rom, REDUCED_POINTS, PEAK_OFFSETS), response_scale(rom)
    for (name, mode), colour in zip(rom.contact_models.items(), _choose_colours(rom, style), strict=True):
        if full is not None:
            above.plot(full[name][0] / math.tau, scale * full[name][1], color=style.ink, linewidth=2.2, alpha=0.25)
            below[0].plot(full[name][0] / math.tau, full[name][2] / full[name][1].max(), color=colour, linewidth=0.8)
        if rom.contacts[name]:
            H = scale * reduced_response(rom, name, ω)
            above.plot(ω / math.tau, H, color=colour, label=f"{name}, order {mode.order - mode.rigid}")
        if len(mode.frequencies):
            f = mode.frequencies / math.tau
            below[0].plot(f, mode.transfer_errors, "o", color=colour, fillstyle="none")
    if full is not None:
        above.plot([], [], color=style.ink, linewidth=2.2, alpha=0.25, label="full order")
    what = "RMS displacement" if unit else "|H|"
    above.set(xscale="log", yscale="log", title="frequency response to the contact's forces")
    above.set_ylabel(f"{what} ({unit})" if unit else what)
    if below:
        below[0].plot([], [], "o", color=style.ink, fillstyle="none", label="validation")
        if full is not None:
            below[0].plot([], [], color=style.ink, linewidth=0.8, label="full solves")
        below[0].set(yscale="log", ylabel="error / max |H|")
    (below or [above])[-1].set_xlabel("frequency (Hz)")
    figure.legend(loc="outside lower center", ncols=2)


def _choose_colours(rom: Rom, style: Style) -> list[Any]:
    """One for each contact mode."""
    if len(rom.contact_models) <= len(style.colours):
        return list(style.colours[: len(rom.contact_models)])
    from matplotlib import colormaps

    return list(colormaps[COLOUR_MAP](np.linspace(0.1, 0.9, len(rom.contact_models))))
