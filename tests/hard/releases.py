"""The same scene reduced and run on each Debian release, to be read on the other.

python tests/hard/releases.py NAME    writes tests/data/rom-NAME.h5 and run-NAME.h5
"""

import sys
import tempfile
import warnings
from pathlib import Path

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

sys.path.append(str(Path(__file__).parents[1]))
from bodies import box_arrays, scene_text, write_arrays

DATA = Path(__file__).parents[1] / "data"

RUN = """dt = 0.01
duration = 0.4
snapshots = 4
[[run.load]]
contact = "right"
stop = 0.2
force = [0.0, 0.0, 1.0]
[[run.load]]
contact = "top"
start = 0.2
stop = 0.3
force = [0.0, 0.5, 0.0]"""


def system(folder: Path) -> fr.System:
    """A box of degree 2 with gravity, a tendon and two contact modes."""
    write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1), shake=0.2))
    effects = (
        "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\ngravity = { acceleration = [0, 0, -9.81] }\n"
        "[effects.tendon.rope]\npoints = [[0.0, 0.2, 0.3], [0.5, 0.2, 0.3], [1.0, 0.2, 0.3]]"
    )
    parts = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]", "reduction": "order = 6", "run": RUN, "effects": effects}
    return fr.assemble(parse_scene(scene_text(Path("box.msh"), **parts), folder=folder))


def main() -> None:
    """See above."""
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        body = system(Path(folder))
        fr.write_rom(DATA / f"rom-{sys.argv[1]}.h5", fr.reduce(body))
        fr.write_trajectory(DATA / f"run-{sys.argv[1]}.h5", fr.simulate(body))


if __name__ == "__main__":
    main()
