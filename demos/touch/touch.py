"""Two soft fingertips feel an egg begin to slip, and grip harder before it does.

    python demos/touch/touch.py             # a minute
    python demos/touch/touch.py --quick     # without the stills

The fingers hold an egg by 1.15 times the force that friction needs, over a table, and a thread pulls it down more and
more. Each tip has a sense of touch (`fingertip.toml`): what it feels, and what a sensor of 100 Hz shows of that 10 ms
late, with noise. The egg slips out of fingers that go by nothing. Others close a little whenever a tip's sensor shows
that much of what presses slides: the rim of a patch of contact slips before the whole does. Everything is written to
demos/touch/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of
from fenics_rom.mechanics.touch import TouchState
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.shapes import Box, Capsule, HalfSpace

HERE = Path(__file__).parent
DT, LOOKS = 2e-3, 0.01  # s: of a step, and how often the fingers decide
RADIUS, LENGTH, MASS = 0.022, 0.012, 0.06  # m, m, kg: of an egg
GRAVITY, FRICTION, SPARE = 9.81, 0.6, 1.15  # m/s2, 1, and friction that there is at rest, of that which is needed
THICKNESS, AIR = 0.009, 1e-4  # m: of a tip; before it touches
CLOSED, PULLED, END = 0.15, 0.4, 1.4  # s: when the grip is closed, when the thread begins to pull, and the end
HARDEST, BELOW = 0.36, 0.015  # N, how hard it pulls in the end; m, how far below the table is then
SLIDES, CLOSES = 0.1, 1e-3  # of what presses: where the fingers begin to close, and m/s, how fast
TRIES, FEWER = 5, 3  # of squeezes, until the grip is right; with --quick
BREAKS = 30.0  # N, that an egg bears
SIDES = {"left": -1.0, "right": 1.0}

Array = np.ndarray


@dataclass
class Gripped:
    """A run: after each step, and what is kept of it as a whole."""

    times: Array  # s
    slipped: Array  # m, by which the egg is lower than when the thread began to pull
    grip: Array  # N, of a finger
    needed: Array  # N, of a finger, for friction to carry weight and thread
    margin: Array  # to slip, of the left tip
    sliding: Array  # part of what presses that slides, of the left tip
    shown: Array  # the same, as the sensor shows it
    felt: TouchState  # by the left tip in the end
    run: fr.Trajectory


class Fingers:
    """How the fingers close: smoothly on the egg, and further by what touch adds.

    Attributes:
        closing: what touch adds: since when, s, from where, m, and how fast, m/s.
    """

    def __init__(self, squeeze: float):
        self._squeeze, self.closing = squeeze, (0.0, 0.0, 0.0)

    def close(self, time: float, speed: float) -> None:
        """Goes on at a speed, m/s, from a time on."""
        self.closing = time, self._added(time), speed

    def _added(self, time: float) -> float:
        since, begun, speed = self.closing
        return begun + speed * max(0.0, time - since)

    def motion(self, side: str, time: float) -> fr.BaseState:
        """Of a finger at a time, s."""
        sign, s = SIDES[side], min(time / CLOSED, 1.0)
        x = self._squeeze * s * s * (3 - 2 * s) + self._added(time)
        v = self._squeeze * 6 * s * (1 - s) / CLOSED + self.closing[2]
        place = np.array([sign * (RADIUS + THICKNESS + AIR - x), 0.0, 0.0])
        mount = quaternion_of(np.array([[0, 0, -sign], [0, 1, 0], [sign, 0, 0]], dtype=float))
        return fr.BaseState(place, mount, np.array([-sign * v, 0.0, 0.0]), np.zeros(3))


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Fingertips that feel an egg begin to slip.")
    parser.add_argument("--quick", action="store_true", help="without the film")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    rom = fr.reduce(fr.assemble(fr.read_scene(HERE / "fingertip.toml")))
    squeeze = squeeze_for(rom, SPARE * MASS * GRAVITY / (2 * FRICTION), FEWER if quick else TRIES)
    numb, feels = (grip(rom, squeeze, feels) for feels in (False, True))
    lost = first(numb.times, numb.slipped > 1e-3)
    shown, gone = first(numb.times, numb.shown > SLIDES), first(numb.times, numb.margin < 0.01)
    print(f"without touch the egg slips by 1 mm until {lost:.3f} s, and by {1e3 * numb.slipped[-1]:.0f} mm in the end")
    print(f"its margin to slip is below 1 % from {gone:.3f} s on; the sensor shows sliding from {shown:.3f} s on")
    print(f"with touch it slips by {1e3 * feels.slipped[-1]:.3f} mm; fingers grip by {feels.grip.max():.2f} N at most")
    share = feels.grip[-1] / feels.needed[-1]
    print(f"in the end that is {share:.2f} of what friction needs; the account closes to {feels.run.balance_error:.1e}")
    pressed = float(feels.felt.pressures.ravel() @ rom.readings["felt"].map.areas)
    claims = [
        ("without touch the egg slips out", numb.slipped[-1] > 5e-3),
        ("the rim slides before the margin is gone, also as the sensor shows it", shown < gone),
        ("with touch the egg stays, to 0.3 mm", feels.slipped.max() < 3e-4),
        ("the fingers grip no harder than a tenth of what an egg bears", feels.grip.max() < BREAKS / 10),
        ("they grip by less than 1.6 times what friction needs", 1.0 < share < 1.6),
        ("pressures of taxels times areas are the normal force to 1e-12", abs(pressed / feels.grip[-1] - 1) < 1e-12),
        ("accounts close to 1e-10", max(of.run.balance_error for of in (numb, feels)) < 1e-10),
    ]
    draw(numb, feels, out / "touch.png")
    if not quick:
        draw_stills({"without touch": numb.run, "with touch": feels.run}, out)
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def first(times: Array, there: Array) -> float:
    """When something is there for the first time after the grip is closed, s; infinite where it never is."""
    found = np.flatnonzero(there & (times > PULLED))
    return float(times[found[0]]) if len(found) else np.inf


def world_of(rom: fr.Rom, fingers: Fingers) -> fr.World:
    """The egg on a table, which goes away when the grip is closed, between two fingers with soft tips."""
    bodies: dict[str, fr.RigidBody | fr.SoftBody] = {
        "table": fr.RigidBody(HalfSpace(), motion=table),
        "egg": fr.RigidBody(Capsule(RADIUS, LENGTH), mass=MASS),
    }
    for side in SIDES:
        bodies[side] = fr.RigidBody(Box((0.02, 0.02, 0.004)), motion=partial(fingers.motion, side))
        bodies[f"{side}_tip"] = fr.SoftBody(rom, on=side)
    tips = [f"{side}_tip" for side in SIDES]
    apart = [["table", *SIDES, *tips], ["egg", *SIDES]]
    return fr.World(bodies, DT, gravity=(0, 0, -GRAVITY), friction=FRICTION, apart=apart)


def table(time: float) -> fr.BaseState:
    """Under the egg until the grip is closed; then it goes down."""
    s, span = min(max((time - CLOSED) / (PULLED - CLOSED), 0.0), 1.0), PULLED - CLOSED
    place, speed = -RADIUS - LENGTH / 2 - BELOW * s * s * (3 - 2 * s), -BELOW * 6 * s * (1 - s) / span
    return fr.BaseState(np.array([0, 0, place]), np.array([1.0, 0, 0, 0]), np.array([0, 0, speed]), np.zeros(3))


def pull(time: float) -> float:
    """Of the thread, N."""
    return HARDEST * max(0.0, time - PULLED) / (END - PULLED)


def squeeze_for(rom: fr.Rom, force: float, tries: int) -> float:
    """How far the fingers close on the egg, m, for a force of each, N; by secants."""
    tried, found = [2e-4, 4e-4], list[float]()
    while True:
        world = world_of(rom, Fingers(tried[len(found)]))
        world.step(count=round(PULLED / DT))
        found.append(abs(float(world.force_between("egg", "left_tip")[0])))
        if len(found) == tries:
            return tried[-1]
        if len(found) > 1:
            (x, y), (f, g) = tried[-2:], found[-2:]
            tried.append(y + (y - x) * (force - g) / (g - f))


def grip(rom: fr.Rom, squeeze: float, feels: bool) -> Gripped:
    """Grips, and pulls; fingers that feel close while a tip's sensor shows that much slides."""
    fingers, steps = Fingers(squeeze), round(END / DT)
    world, rows = world_of(rom, fingers), []
    recorder = WorldRecorder(world, steps, snapshots=60)
    tips = [world.simulator(f"{side}_tip") for side in SIDES]
    for step in range(1, steps + 1):
        world.step({"egg": {"force": [0.0, 0.0, -pull(world.time + DT / 2)]}})
        if feels and world.time > PULLED and step % round(LOOKS / DT) == 0:
            most = max(float(tip.touch("sensed").patches.sliding[0]) for tip in tips)
            fingers.close(world.time, CLOSES if most > SLIDES else 0.0)
        felt, shown = (tips[0].touch(name) for name in ("felt", "sensed"))
        needed, patches = (MASS * GRAVITY + pull(world.time)) / (2 * FRICTION), felt.patches
        above, slides = world.pose("egg").position[2], (patches.sliding[0], shown.patches.sliding[0])
        rows.append((world.time, above, felt.normal_force, needed, patches.margin[0], *slides))
        recorder.sample(step)
    times, above, *others = np.array(rows).T
    begun = above[np.searchsorted(times, PULLED)]
    return Gripped(times, begun - above, *others, felt, recorder.record("egg"))


def draw(numb: Gripped, feels: Gripped, file: Path) -> None:
    """Margin to slip and grip over time, and what the tip feels in the end."""
    figure, axes = plt.subplots(1, 4, figsize=(14, 3.2), layout="constrained")
    for of, label, colour in ((numb, "without touch", "C1"), (feels, "with touch", "C0")):
        late = of.times > PULLED
        held = np.where(of.grip > 0, 1.0, np.nan)[late]
        axes[0].plot(of.times[late], held * of.margin[late], colour, label=f"margin, {label}")
        axes[0].plot(of.times[late], held * of.shown[late], f"{colour}:", label=f"slides, as shown, {label}")
        axes[1].plot(of.times, of.grip, colour, label=label)
        axes[2].plot(of.times[late], 1e3 * of.slipped[late], colour, label=label)
    axes[0].axhline(SLIDES, color="0.6", linewidth=0.7)
    axes[1].plot(feels.times, feels.needed, "k--", label="needed")
    axes[0].set(xlabel="time (s)", ylabel="share (1)", title="what the tip feels", ylim=(-0.03, 0.6))
    axes[1].set(xlabel="time (s)", ylabel="grip (N)", title="how hard it grips", ylim=(0, None))
    axes[2].set(xlabel="time (s)", ylabel="egg, down (mm)", title="how far the egg slips", ylim=(-0.1, 3))
    shown = axes[3].imshow(1e-3 * feels.felt.pressures, origin="lower", cmap="viridis")
    figure.colorbar(shown, ax=axes[3], label="pressure (kPa)")
    axes[3].set(title="taxels in the end", xlabel="column", ylabel="row")
    for axis in axes[:3]:
        axis.legend(fontsize=7)
    figure.savefig(file, dpi=110)


def draw_stills(runs: dict[str, fr.Trajectory], folder: Path) -> None:
    """Both runs at three instants, as pictures that the package makes."""
    instants = (PULLED, 0.5 * (PULLED + END), END)
    figure, axes = plt.subplots(len(runs), len(instants), figsize=(10.5, 5.4), layout="constrained")
    for row, (label, run) in zip(axes, runs.items(), strict=True):
        for axis, time in zip(row, instants, strict=True):
            still = fr.export(run, folder / "still.png", time=time, colour="contact_pressure")
            axis.imshow(plt.imread(still))
            axis.set_axis_off()
            axis.set_title(f"{label}, {time:.1f} s", fontsize=9)
    figure.savefig(folder / "egg.png", dpi=110)


if __name__ == "__main__":
    main()
