"""How many times as fast steps are as at another commit of this project, on this machine, in turns.

    python demos/rates/beside_commit.py COMMIT                  # all cases, half an hour
    python demos/rates/beside_commit.py COMMIT pad "batch, 8"   # those whose names contain one of these
    python demos/rates/beside_commit.py COMMIT pad --own 44     # the commit reduces the pads itself, to this order
    python demos/rates/beside_commit.py COMMIT --quick          # two short turns of small models, to see that it works

Cases are pads in contact and batches of them (../contact_rates), an arm and a finger that bend far (here and in
../bending), the plate by steps, rollouts and a batch, the finger of ../swing, the bar of ../spin, and ../gripper.
"Now" is the package beside this file, with changes that are not committed. Today's code reduces a scene, and the
commit reads that file, or reduces the scene itself where it cannot. Both step it on one thread, each in a process of
its own (steps_of_a_version.py), in many short turns from where the body has settled. The table has the best and the
median of the rates in steps of a body per second of processor time, how many times as many are made now, and the
largest difference of displacements on the way of a turn, as a share of the largest; where each has a model of its
own, that is how far these two are apart. Cases whose rates change while others are at work are better measured again.
"""

import argparse
import io
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "contact_rates"))

import large_deformation as arm
import pads
from pad_batches import ORDER, POINTS, PUSHED

from fenics_rom.io.markdown import markdown

PROJECT = Path(__file__).resolve().parents[2]
WORKER = Path(__file__).with_name("steps_of_a_version.py")
ALONE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
TOGETHER, FEW_TOGETHER = 1024, 16  # pads of a batch, and with --quick
PULLS = {"arm": {"flexor": arm.TENSION}, "finger": {"flexor": 2.0, "air": 2000.0}}  # N and Pa, the largest


@dataclass(frozen=True)
class Case:
    """A scene, the order of its model, and what steps it: a function of steps_of_a_version.py, and what that takes."""

    name: str
    scene: str
    order: int
    drive: str
    given: dict[str, Any]
    bodies: int = 1


class Version:
    """A version of the package that steps a case, in a process of its own.

    Attributes:
        order: of its model.
        path: displacements (steps, nodes, 3) on the way of a turn, m.
        rates: of its turns, in steps of a body per second.
    """

    def __init__(self, name: str, package: Path, case: Case, folder: Path, own: int | None = None):
        """Has it read the model of the case, or make that if it has none to read, or is to have its own."""
        self.name, self.case, self.rates = name, case, list[float]()
        scene, path = folder / "scene.toml", folder / "path.npy"
        scene.write_text(case.scene)
        files = {"package": package, "scene": scene, "rom": folder / f"{case.name}.h5", "path": path}
        told = {"order": case.order, "own": own, "drive": case.drive, "given": case.given}
        self._process = subprocess.Popen(
            [sys.executable, WORKER, json.dumps(told | {name: str(file) for name, file in files.items()})],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | ALONE | {"PYTHONPATH": str(package)},
        )
        self.order = int(self._answer())
        self.path = np.load(path)

    def turn(self) -> None:
        """Has it take a turn."""
        assert self._process.stdin is not None
        print(file=self._process.stdin, flush=True)
        self.rates.append(self.case.bodies * self.case.given["steps"] / float(self._answer()))

    def close(self) -> None:
        """Ends its process, which ends with its input."""
        self._process.communicate()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        if not (answer := self._process.stdout.readline()):
            sys.exit(f"error: the package of {self.name} cannot step {self.case.name!r}; why, stands above")
        return answer


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures steps beside those of another commit, in turns.")
    parser.add_argument("commit", help="of this project, by any name that Git has for it")
    parser.add_argument("cases", nargs="*", help="parts of the names of cases; none: all of them")
    parser.add_argument("--own", type=int, metavar="ORDER", help="the commit reduces scenes itself, to this order")
    parser.add_argument("--rounds", type=int, default=20, help="turns of each (20)")
    parser.add_argument("--quick", action="store_true", help="two short turns of small models")
    told = parser.parse_intermixed_args()
    with tempfile.TemporaryDirectory(prefix="fenics-rom-") as name:
        folder, rounds = Path(name), 2 if told.quick else max(1, told.rounds)
        before = unpacked(told.commit, folder / "before")
        every = list(cases(folder, told.quick))
        chosen = [case for case in every if any(part in case.name for part in told.cases or [""])]
        if not chosen:
            names = "; ".join(case.name for case in every)
            sys.exit(f"error: no case is called {' or '.join(told.cases)}; there are: {names}")
        rows = [row_of(case, told.commit, before, folder, told.own, rounds) for case in chosen]
    heading = ("case", f"order, {told.commit}", "now", f"best, {told.commit}", "now", "ratio", "median", "now", "ratio")
    print(markdown((*heading, "difference"), rows))


def row_of(case: Case, commit: str, before: Path, folder: Path, own: int | None, rounds: int) -> list[object]:
    """What the table says of a case; the model that is made now is there before the commit looks for it."""
    print(case.name, file=sys.stderr, flush=True)
    with (
        closing(Version("now", PROJECT, case, folder)) as now,
        closing(Version(commit, before, case, folder, own)) as then,
    ):
        for _ in range(rounds):
            then.turn()
            now.turn()
    row: list[object] = [case.name, then.order, now.order]
    for of_turns in (max, statistics.median):
        rates = of_turns(then.rates), of_turns(now.rates)
        row += [*(f"{rate:,.0f}" for rate in rates), f"{rates[1] / rates[0]:.2f}"]
    return [*row, f"{np.abs(now.path - then.path).max() / np.abs(then.path).max():.0e}"]


def unpacked(commit: str, folder: Path) -> Path:
    """The package as it was at a commit, in a folder, which is returned; says what it is compared with."""
    if Path(git("rev-parse", "--show-toplevel").decode().strip()).resolve() != PROJECT:
        sys.exit(f"error: {PROJECT} is not a Git repository of its own, which could have the commit")
    git("rev-parse", "--verify", f"{commit}^{{commit}}", otherwise=f"there is no commit {commit!r} here")
    changed = ", with changes that are not committed" if git("status", "--porcelain", "--", "fenics_rom") else ""
    print(f"Now: {git('rev-parse', '--short', 'HEAD').decode().strip()}{changed}\n", flush=True)
    zipfile.ZipFile(io.BytesIO(git("archive", "--format=zip", commit, "fenics_rom"))).extractall(folder)
    return folder


def git(*arguments: str, otherwise: str = "") -> bytes:
    """What Git prints; what it complains of, or is said instead, is an error."""
    try:
        return subprocess.run(["git", "-C", PROJECT, *arguments], capture_output=True, check=True).stdout
    except FileNotFoundError:
        sys.exit("error: there is no git on this machine")
    except subprocess.CalledProcessError as failed:
        sys.exit(f"error: {otherwise or failed.stderr.decode().strip()}")


def cases(folder: Path, quick: bool) -> Iterator[Case]:
    """Pads, batches of them, bodies that bend far, plain ones, moving ones, and a gripper."""
    file, (settle, steps) = folder / "pad.msh", (20, 10) if quick else (700, 100)
    pads.mesh(file, pads.BRICKS)
    given = {"dt": pads.STEP, "settle": settle, "steps": steps}
    for name in (*pads.ON_THE_GROUND, "no friction", "on a ball, sticks", "on a ball, slides"):
        yield Case(f"pad, {name}", pads.CASES[name].text(file, settle * pads.STEP), pads.ORDER, "pad", given)
    aside, down = pads.COEFFICIENT * pads.PRESSED, pads.PRESSED
    loads = {"push": ([0, 0, 0], [aside, aside, 0]), "press": ([0, 0, pads.WEIGHT - down], [0, 0, down])}
    scene = pads.CASES["sticks"].text(file, settle * pads.STEP)
    yield Case("pad, random pushes", scene, pads.ORDER, "pad_under_random_loads", given | {"loads": loads})

    size = FEW_TOGETHER if quick else TOGETHER
    given = {"dt": pads.STEP, "settle": steps // 2, "steps": steps // 2, "size": size}
    for points, bricks in POINTS.items():
        file = folder / f"pad-{points}.msh"
        pads.mesh(file, bricks)
        scene = pads.CASES["at rest"].text(file, pads.STEP)
        for name, (every, share) in PUSHED.items():
            pushes = given | {"every": every or 1, "largest": share * aside}
            yield Case(f"batch, {points} points, {name}", scene, ORDER, "batch", pushes, size)

    file = folder / "arm.msh"
    arm.mesh(file, arm.COARSE if quick else arm.BRICKS)
    for law, poisson in arm.LAWS.items():
        arms = arm.SCENE.format(file=file.name, law=law, poisson=poisson, step=arm.STEP)
        for name, scene in {"arm": arms, "finger": finger(law, poisson)}.items():
            push = arm.PUSH if name == "arm" else 0.0
            pulled = {"dt": arm.STEP, "settle": settle, "steps": steps, "pulls": PULLS[name], "push": push}
            for order in arm.COARSE_ORDERS if quick else arm.ORDERS:
                yield Case(f"{name}, {law}, order {order}", scene, order, "pulled", pulled)

    given = {"settle": settle // 2, "steps": steps}
    plate, spin = (
        of_demo("plate/plate.toml"),
        of_demo("spin/spin.toml", "gravity = .*?\n", r"\[effects.friction.*?(?=\[red)"),
    )
    for order in (10,) if quick else (20, 60):
        for name, at_once in (("steps", False), ("rollout", True)):
            own = {"dt": 1e-3, "largest": 0.5, "at_once": at_once, "settle": settle, "steps": 10 * steps}
            yield Case(f"plate, {name}, order {order}", plate, order, "pushed", own)
    pushes = given | {"dt": 1e-3, "size": size, "every": 1, "largest": 0.5}
    yield Case("plate, batch", plate, 10 if quick else 40, "batch", pushes, size)
    yield Case(
        "swing", of_demo("swing/swing.toml"), 20, "moving", {"dt": 2e-3, "spin": None, "settle": 200, "steps": steps}
    )
    yield Case("spin", spin, 20, "moving", given | {"dt": 1e-3, "spin": [1.0, 6.0, 0.5]})
    held = of_demo("gripper/finger.toml", "gravity = .*?\n", 'frame = "moving"')
    yield Case("gripper", held, 10 if quick else 40, "Holding", given | {"dt": 2e-3, "tension": 2.0})


def of_demo(file: str, *without: str) -> str:
    """A demo's scene, by files that are named from anywhere, without some of its entries."""
    path = PROJECT / "demos" / file
    text = path.read_text()
    for entry in without:
        text = re.sub(entry, "", text, flags=re.DOTALL)
    text = text.replace("../../meshes", str(PROJECT / "meshes"))
    return re.sub(r'table = "(\w+)', rf'table = "{path.parent}/\1', text)


def finger(law: str, poisson: float) -> str:
    """The scene of ../bending of that law, with elements of degree 1 and without the rod."""
    folder = PROJECT / "demos" / "bending"
    text = (folder / "bending.toml").read_text()
    text = re.sub(r"\[effects\.contact\.obstacles\.rod\].*?\n\n", "", text, flags=re.DOTALL)
    text = re.sub(r"degree = \d", "degree = 1", text)
    text = re.sub(r"poisson = [\d.]+", f"poisson = {poisson}", text)
    text = text.replace('"neo_hookean"', f'"{law}"').replace("../../meshes", str(PROJECT / "meshes"))
    return re.sub(r'table = "(\w+)', rf'table = "{folder}/\1', text)


if __name__ == "__main__":
    main()
