"""A box that two jaws hold by friction while it is shaken, by MuJoCo and by this project.

Sizes, masses, friction and forces are those of demos/hold. MuJoCo's jaws are rigid and pressed by these forces; here
they have soft pads and are moved as they are told. It runs as it comes, and in the settings that were found to creep
least: with elliptic cones, a large impratio, and iterations that take slip away after the solver.
"""

import json
from pathlib import Path

import hold
import numpy as np
from environments import PeerError, ask
from findings import Findings

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone

STEP = hold.DT
SETTINGS = {
    "as it comes": (STEP, "pyramidal", 1, 0),
    "elliptic cones": (STEP, "elliptic", 1, 0),
    "elliptic cones, impratio 100": (STEP, "elliptic", 100, 0),
    "elliptic cones, 10 noslip iterations": (STEP, "elliptic", 1, 10),
}
SCENE = {
    "edge": hold.EDGE,
    "mass": hold.MASS,
    "gravity": hold.GRAVITY,
    "friction": hold.FRICTION,
    "frequency": hold.FREQUENCY,
    "shaking": hold.SHAKING,
    "margin": hold.MARGIN,
    "shaken": hold.SHAKEN,
    "slips": hold.SLIPS,
}


def compare(interpreter: Path | PeerError, out: Path, findings: Findings) -> None:
    """All of it, or what can be said without MuJoCo.

    Args:
        interpreter: of an environment with MuJoCo, or why there is none.
        out: where files go.
        findings: where tables, numbers and claims go.
    """
    scene = out / "grip.json"
    scene.write_text(json.dumps(SCENE))
    rom = fr.reduce(fr.assemble(fr.read_scene(Path(hold.__file__).parent / "pad.toml")))
    seconds = hold.WHOLE
    with numpy_alone():
        in_numpy = hold.shaken(rom, seconds)
    own = hold.shaken(rom, seconds) if fr.compiled() else in_numpy
    means, accelerations = hold.means_of(own), (0.0, hold.GRAVITY)
    slips = [hold.share_where_it_slips(hold.loosened(rom, a), a) for a in accelerations]
    rows = [_row("`fenics_rom`, NumPy, soft pads of order 20", hold.means_of(in_numpy), slips, in_numpy.rate)]
    if fr.compiled():
        rows.append(_row("`fenics_rom`, compiled, soft pads of order 20", means, slips, own.rate))
    try:
        if isinstance(interpreter, PeerError):
            raise interpreter
        tasks = [{"what": "shaken", "seconds": seconds}, *({"what": "loosened", "a": a} for a in accelerations)]
        shaken, *loosened = (
            ask(interpreter, "grip_worker.py", scene, out / "grip.npz", task | {"settings": list(SETTINGS.values())})
            for task in tasks
        )
        for k, name in enumerate(SETTINGS):
            rate, *places = shaken[f"found_{k}"]
            shares = [float(found[f"found_{k}"]) for found in loosened]
            rows.append(_row(f"MuJoCo, {name}", np.array(places), shares, rate))
    except PeerError as error:
        rows.append(("MuJoCo", str(error), "", "", "", ""))
    findings.table(
        f"## A box shaken for {seconds:g} s, and grips that are loosened",
        ("", "creeps by", "lost after", "slips at rest from", "rising with 1 g from", "steps per second"),
        rows,
    )
    findings.at_most("creep, mm", 1e3 * float(np.ptp(means)), 0.1)
    for a, share in zip(accelerations, slips, strict=True):
        findings.at_most(f"2 mu N/(m (g + a)) where slip begins, less 1, a = {a:g} m/s2", abs(share - 1), 0.01)


def _row(name: str, means: np.ndarray, slips: list[float], rate: float) -> tuple[object, ...]:
    """Of a table."""
    periods = len(means)
    creep = f"{1e3 * abs(means[-1] - means[0]):.2g} mm" if periods > 1 else "-"
    lost = "" if periods and abs(means[-1]) < LOST else f"{periods / hold.FREQUENCY:.1f} s"
    return (name, creep, lost, *(f"{share:.3f}" for share in slips), f"{rate:,.0f}")


LOST = 0.015  # m: of the mean of a period of what is lost in the next
