"""pyMOR, MuJoCo and Exudyn beside this project: the same matrices, the same errors, one thread each.

    python demos/peers/peers.py                 # some ten minutes; installs the peers into demos/peers/out first
    python demos/peers/peers.py --full          # the paper's mesh and larger flexes: more than an hour
    python demos/peers/peers.py --quick         # without the peers, on coarse meshes, to see that it works

Each peer is installed in a virtual environment of its own and asked by a worker that needs nothing of this project;
it runs as it comes and in the best settings that were found. One that cannot be installed is a line in the tables. The
script

1. reduces the paper's cylinder with pyMOR: time, errors, what its other reductors make of symmetry and energy, and the
   rate of its time stepper (against_pymor.py);
2. lets a beam swing with MuJoCo's flexes: what is left of the amplitude, errors of time and of space, and what they
   cost (against_mujoco.py);
3. lets a shaft that is out of balance spin freely with Exudyn's floating frame: error and rate (against_exudyn.py);
4. shakes a box that two jaws hold by friction, with MuJoCo's rigid bodies: creep, and where it slips; not with --quick
   (against_mujoco_grip.py).

What pyMOR and MuJoCo can and this project cannot is not measured: pyMOR reduces much more than soft bodies, MuJoCo's
flexes may bend as far as they like and touch whatever they like. Everything is written to demos/peers/out/, with
--quick to out/quick/. The checks at the end are on errors and ratios of rates; with --quick not on the latter.
"""

import argparse
import json
import os
import sys
import warnings
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "scaling"))
sys.path.append(str(Path(__file__).parents[1] / "rates"))
sys.path.append(str(Path(__file__).parents[1] / "hold"))

import against_exudyn
import against_mujoco
import against_mujoco_grip
import against_pymor
from cylinder import PAPER
from environments import ONE_THREAD, PeerError, environment
from findings import Findings
from turns import ROUNDS

from fenics_rom.errors import FenicsRomWarning

OUT = Path(__file__).parent / "out"
USUAL, COARSE = 2.0, 3.2  # size factors of meshes of 1,758 and 603 unknowns
COARSE_BEAM = (0.014, 0.0245)  # m


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Compares with pyMOR, MuJoCo and Exudyn.")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="without the peers, on coarse meshes; rates are not judged")
    size.add_argument("--full", action="store_true", help="the paper's mesh and larger flexes")
    parser.add_argument("--only", choices=["pymor", "mujoco", "exudyn", "grip"], help="one of the peers")
    options = parser.parse_args()
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    quick, full = options.quick, options.full
    out = OUT / "quick" if quick else OUT  # so that a test does not overwrite what took minutes
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # these tetrahedra lock, which is no matter here

    rounds, held = 1 if quick else ROUNDS, True
    if options.only in (None, "pymor"):
        findings = Findings(judge_rates=not quick)
        system = against_pymor.cylinder(COARSE if quick else PAPER if full else USUAL, out)
        against_pymor.compare(system, interpreter("pymor", quick), out, findings, rounds)
        held &= written(findings, out / "pymor")
    if options.only in (None, "mujoco"):
        findings = Findings(judge_rates=not quick)
        flexes = against_mujoco.FLEXES + (against_mujoco.LARGER if full else ())
        sizes = COARSE_BEAM if quick else (against_mujoco.FINE, against_mujoco.COARSER)
        against_mujoco.compare(interpreter("mujoco", quick), out, findings, flexes, sizes, rounds)
        held &= written(findings, out / "mujoco")
    if options.only in (None, "exudyn"):
        findings = Findings(judge_rates=not quick)
        against_exudyn.compare(interpreter("exudyn", quick), out, findings, min(rounds, 3), quick)
        held &= written(findings, out / "exudyn")
    if options.only in (None, "grip") and not quick:
        findings = Findings(judge_rates=True)
        against_mujoco_grip.compare(interpreter("mujoco", quick), out, findings)
        held &= written(findings, out / "grip")
    if not held:
        sys.exit(1)


def interpreter(name: str, quick: bool) -> Path | PeerError:
    """The Python of a peer's environment, or why there is none."""
    if quick:
        return PeerError(f"{name} is left out by --quick")
    print(f"Installing {name}, if it is not there ...", flush=True)
    try:
        return environment(name, OUT)
    except PeerError as error:
        return error


def written(findings: Findings, file: Path) -> bool:
    """Writes tables and numbers; whether every claim holds."""
    held = findings.verdict()
    file.with_suffix(".md").write_text("\n".join(findings.tables))
    file.with_suffix(".json").write_text(json.dumps(findings.numbers, indent=1))
    return held


if __name__ == "__main__":
    main()
