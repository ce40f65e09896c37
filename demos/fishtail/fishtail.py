"""A fishtail of silicone, cast around a thin sheet of carbon, beats by air: a stiff core in a soft body.

    python demos/fishtail/fishtail.py             # about a minute
    python demos/fishtail/fishtail.py --quick     # a tenth of the run, at one order

The carbon is a hundred thousand times stiffer than the silicone, and half a millimetre thin. A chamber in each flank is
blown up in turn, near the lowest natural frequency. Seven markers are looked at, five along a flank and two on the fin.
The script

1. writes the pressures, left.csv and right.csv, that the scene names;
2. runs the scene at full order and at several reduced orders, and tables errors and energy accounts;
3. draws the tail as it beats, to scale, and where the markers go.

Everything else is written to demos/fishtail/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.visualization.figure import figure_class
from fenics_rom.visualization.plots.body import draw_body

HERE = Path(__file__).parent
BEATS, PRESSURE = 6.5, 8.0e3  # 1/s, near the lowest natural frequency; Pa
ORDERS, BOUNDS = (10, 20, 30), (2e-2, 1e-3, 1e-4)  # and the error of the markers that each may have
ACCOUNT, FULL_ORDER = 1e-12, 1e-10  # share of the work to which accounts close: nodal velocities in double precision
# hold the balance of so stiff a sheet to some digits less
QUICK = 0.1
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # Matplotlib's z is the scene's y

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A fishtail beats by air.")
    parser.add_argument("--quick", action="store_true", help="a tenth of the run, at one order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)

    write_pressures()
    scene = fr.read_scene(HERE / "fishtail.toml")
    assert scene.run is not None
    if quick:
        scene = replace(scene, run=replace(scene.run, duration=QUICK * scene.run.duration))
    system = fr.assemble(scene)
    print(f"{system.size} unknowns at full order")
    full = fr.simulate(system)
    rows, claims, reduced = [], [], full
    for order, bound in list(zip(ORDERS, BOUNDS, strict=True))[-1 if quick else 0 :]:
        reduced = fr.simulate(fr.reduce(system, order=order))
        errors = fr.compare(reduced, full)
        markers, shape = (errors[what].relative for what in ("output markers", "shape"))
        rows.append(
            (order, f"{markers:.1e}", f"{shape:.1e}", f"{account_gap(reduced):.0e}", f"{account_gap(full):.0e}")
        )
        claims += [
            (f"order {order}: error of the markers at most {bound:g}", markers <= bound),
            (f"order {order}: account closes to {ACCOUNT:g}", account_gap(reduced) <= ACCOUNT),
        ]
    claims.append((f"full order: account closes to {FULL_ORDER:g}", account_gap(full) <= FULL_ORDER))
    claims.append(("strains and rotations are such that a linear model is good for", not told_too_far(full)))

    heading = ("order", "error of the markers", "error of the shape", "account, reduced", "account, full order")
    (out / "fishtail.md").write_text(markdown(heading, rows))
    print(markdown(heading, rows))
    draw(out / "fishtail.png", full, reduced)
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def write_pressures() -> None:
    """Half waves for one chamber, and those between for the other."""
    times = np.arange(0.0, 1.5, 0.0025)
    wave = PRESSURE * np.sin(2 * np.pi * BEATS * times)
    for name, pressure in (("left", np.maximum(wave, 0.0)), ("right", np.maximum(-wave, 0.0))):
        lines = [f"{t:.4f},{p:.1f}" for t, p in zip(times, pressure, strict=True)]
        (HERE / f"{name}.csv").write_text("\n".join(["time,pressure", *lines, ""]))


def account_gap(record: fr.Trajectory) -> float:
    """What the energy account misses, as a share of what was supplied."""
    gap = record.energy - record.supplied + record.dissipated + record.lost_in_switching
    return float(np.abs(gap).max() / np.abs(record.supplied).max())


def told_too_far(record: fr.Trajectory) -> bool:
    """Whether the run says that it left what a linear model can follow."""
    return any("linear model" in warning for warning in record.warnings)


def draw(file: Path, full: fr.Trajectory, reduced: fr.Trajectory) -> None:
    """The tail bent to both sides, and sideways motion of the markers, full order and reduced."""
    figure = figure_class()(figsize=(13, 4.5), layout="constrained")
    sideways = full.outputs["markers"][:, :, 2]
    tip = sideways[np.searchsorted(full.times, full.snapshot_times), -1]
    largest = np.linalg.norm(full.snapshots, axis=2).max()
    for place, instant in enumerate((tip.argmax(), tip.argmin())):
        axes = figure.add_subplot(1, 3, 1 + place, projection="3d")
        drawn = draw_body(
            axes, full.nodes @ UPRIGHT, full.triangles, full.snapshots[instant] @ UPRIGHT, largest=largest
        )
        axes.view_init(elev=30, azim=-65)
        axes.set_title(f"{full.snapshot_times[instant]:.2f} s")
    where = {"location": "bottom", "shrink": 0.5, "ticks": [0, largest], "format": "%.4f"}
    figure.colorbar(drawn, ax=figure.axes, label="displacement (m)", **where)
    axes = figure.add_subplot(1, 3, 3)
    for marker in range(sideways.shape[1]):
        line = axes.plot(full.times, 1e3 * sideways[:, marker], label=f"marker {marker + 1}", linewidth=2, alpha=0.5)[0]
        axes.plot(reduced.times, 1e3 * reduced.outputs["markers"][:, marker, 2], "--", color=line.get_color())
    axes.set(xlabel="time (s)", ylabel="sideways (mm)", title="full order (broad) and reduced (dashed)")
    axes.legend(fontsize="small", loc="lower left")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
