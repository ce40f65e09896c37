"""A force and a torque at one end throw a slender beam: it flies, turns, and bends by more than a third of its length.

    python demos/spin/flight.py             # some minutes, most of them to reduce the beam
    python demos/spin/flight.py --quick     # of degree 1, until force and torque have ended

As demos/spin, of a beam that bends far. One reduced model of order 30 flies beside full order; and a bar that is
reduced like it is that of demos/spin where strains are small. Everything is written to demos/spin/out/; models and runs
at full order are kept there. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from spin import COMPARED, changes, rates, shortened, words_of_rates

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.large_deformation import LargeDeformation
from fenics_rom.visualization.figure import figure_class

HERE = Path(__file__).parent
LENGTH, ENDED = 0.5, 1.0  # m; s, when force and torque have
ERROR = 0.01  # of every node, as a share of the length
WEAKER, SAME = 0.1, 1e-6  # share of the throw of demos/spin that strains little, and what "the same" is
DRAWN = (0.0, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0)  # s

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A slender beam is thrown.")
    parser.add_argument("--quick", action="store_true", help="of degree 1, until force and torque have ended")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # runs hold them
    scene = fr.read_scene(HERE / "flight.toml")
    assert scene.run is not None
    if quick:
        scene = shortened(replace(scene, degree=1), ENDED + 0.1)
    system = fr.assemble(scene)
    rom = kept_rom(system, out / "beam.h5")
    file = out / "beam_full.h5"
    if not file.is_file():
        fr.write_trajectory(file, fr.simulate(system))
    full, run = fr.read_trajectory(file), fr.simulate(rom)
    assert rom.deformation is not None
    print(f"{system.size} unknowns at full order; {len(rom.deformation.weights)} of {rom.deformation.points_of} points")
    claims = judged(full, run)
    if not quick:  # elements of degree 1 are too stiff to bend that far
        sag = bent(full).max() / LENGTH
        claims.append((f"it bends by more than a third of its length ({sag:.3f})", sag > 1 / 3))
        print(words_of_rates(*rates(rom, scene, "full", scene.run.dt)))
        same = beside_small_strains(out)
        claims.append((f"where strains are small it is demos/spin to {SAME:g} ({same:.1e})", same < SAME))
        draw(out / "flight.png", full, run)
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def kept_rom(system: fr.System, file: Path) -> fr.Rom:
    """The model of a file, which is made where there is none."""
    if not file.is_file():
        fr.write_rom(file, fr.reduce(system))
    return fr.read_rom(file)


def judged(full: fr.Trajectory, run: fr.Trajectory) -> list[tuple[str, bool]]:
    """What is claimed of the flight."""
    away = distances(full, run).max() / LENGTH
    assert run.momentum is not None
    assert full.pose is not None
    kept = {
        name: changes(part, run.times, ENDED)
        for name, part in (("momentum", run.momentum[:, :3]), ("angular momentum", run.momentum[:, 3:]))
    }
    axes = np.array([rotation_matrix(pose[3:])[:, 0] for pose in full.pose])
    turned = np.degrees(np.arccos(np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)).sum())
    print(f"{full.times[-1]:g} s in steps of {1e3 * run.settings['dt']:g} ms: it turns by {turned:.0f} degrees")
    print(f"accounts: {run.balance_error:.0e}, at full order {full.balance_error:.0e}")
    return [
        (f"every node is within {ERROR:.0%} of the length of full order ({away:.2%})", away < ERROR),
        *((f"{name} is kept to 1e-13 ({change:.0e})", change < 1e-13) for name, change in kept.items()),
        ("the account closes to 1e-12", run.balance_error < 1e-12),
    ]


def distances(full: fr.Trajectory, run: fr.Trajectory) -> Array:
    """Of every node from where it is at full order (snapshots, nodes), m."""
    distance: Array = np.linalg.norm(run.snapshots - full.snapshots, axis=2)
    return distance


def bent(run: fr.Trajectory) -> Array:
    """How far the axis is from the line between its ends at most (snapshots,), m."""
    _, station = np.unique(run.nodes[:, 0].round(6), return_inverse=True)
    mean = np.equal.outer(np.arange(station.max() + 1), station) / np.bincount(station)[:, None]
    axis = mean @ (run.nodes + run.snapshots)  # (snapshots, stations, 3)
    along = axis[:, -1:] - axis[:, :1]
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    arm = axis - axis[:, :1]
    away: Array = np.linalg.norm(arm - (arm * along).sum(axis=2, keepdims=True) * along, axis=2).max(axis=1)
    return away


def beside_small_strains(out: Path) -> float:
    """How far the bar of demos/spin, reduced like the beam, is from its model of small strains in a weaker throw."""
    spin = fr.read_scene(HERE / "spin.toml")
    spin = shortened(replace(spin, effects=replace(spin.effects, contact=None, gravity=None)), COMPARED)
    large = replace(spin, effects=replace(spin.effects, large_deformation=LargeDeformation()))
    assert large.reduction is not None
    large = replace(large, reduction=replace(large.reduction, method=None, order=30, cubature=1e-3))
    roms = kept_rom(fr.assemble(spin), out / "bar.h5"), kept_rom(fr.assemble(large), out / "bar_large.h5")
    runs = [fr.simulate(rom, scene=weaker(scene)) for rom, scene in zip(roms, (spin, large), strict=True)]
    return fr.compare(runs[1], runs[0])["shape"].relative


def weaker(scene: fr.Scene) -> fr.Scene:
    """The scene with a share of its throw."""
    assert scene.run is not None
    loads = [replace(load, signal=replace(load.signal, values=WEAKER * load.signal.values)) for load in scene.run.loads]
    return replace(scene, run=replace(scene.run, loads=tuple(loads)))


def draw(file: Path, full: fr.Trajectory, run: fr.Trajectory) -> None:
    """The beam as it flies, how far it bends, how far any node is from full order, and what is kept."""
    figure = figure_class()(figsize=(14, 4.6), layout="constrained")
    flight, sag, errors = figure.subplots(1, 3, width_ratios=[1.5, 1, 1])
    for k, time in enumerate(DRAWN):
        at = np.abs(full.snapshot_times - time).argmin()
        moved, reduced = (each.nodes + each.snapshots[at] for each in (full, run))
        flight.triplot(moved[:, 0], moved[:, 2], full.triangles, color=f"{0.8 - 0.09 * k:.2f}", linewidth=0.5)
        flight.plot(reduced[::5, 0], reduced[::5, 2], ".", color="C3", markersize=2)
        flight.annotate(f"{time:g} s", moved[np.argmax(full.nodes[:, 0])][[0, 2]], fontsize=8)
    flight.set(xlabel="x (m)", ylabel="z (m)", title="full order; in red order 30", aspect="equal")
    for each, style in ((full, {"linewidth": 4, "alpha": 0.35}), (run, {"linewidth": 1})):
        sag.plot(each.snapshot_times, bent(each) / LENGTH, color="C0", **style)
    sag.axhline(1 / 3, color="0.6", linestyle="--", linewidth=1)
    sag.set(title="axis from the line between its ends", ylabel="share of the length")
    errors.semilogy(
        full.snapshot_times, np.maximum(distances(full, run).max(axis=1) / LENGTH, 1e-6), label="farthest node"
    )
    errors.axhline(ERROR, color="0.6", linestyle="--", linewidth=1)
    errors.set(title="distance from full order", ylabel="share of the length", ylim=(1e-5, 0.05))
    for axes in (sag, errors):
        axes.axvspan(0, ENDED, color="0.92", zorder=0)
        axes.set(xlabel="time (s)")
    figure.savefig(file, dpi=130)


if __name__ == "__main__":
    main()
