"""Registers the tasks: after `import soft_tasks`, `gymnasium.make_vec("fenics_rom/ArmFollow-v0", num_envs=256)`.

`rom=` says where the file of the body is, which soft_bodies.make makes; else it is that in out/, which train.py makes.
"""

from pathlib import Path

import gymnasium

OUT = Path(__file__).parent / "out"
TASKS = {  # the file of the body, and the environment
    "PlateReach": ("plate", "environment:PlateReach"),
    "ArmFollow": ("far", "arms:ArmFollow"),
    "ArmReach": ("far", "arms:ArmReach"),
    "ArmPegs": ("pegs", "arms:ArmPegs"),
    "ArmNest": ("pegs", "arms:ArmNest"),
    "FingerLift": ("finger", "lifting:FingerLift"),
}
for name, (body, environment) in TASKS.items():
    gymnasium.register(
        id=f"fenics_rom/{name}-v0", vector_entry_point=environment, kwargs={"rom": str(OUT / f"{body}.h5")}
    )
