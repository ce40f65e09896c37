"""ROM files of format 1.x, made ones of this release's format in memory."""

import re

import h5py

from fenics_rom.io.hdf5 import get_text, put_text, rename_all

NAMES = {
    "modes": "contact_models",
    "deformation/drag": "deformation/external_damping",
    "deformation/reach": "deformation/training_radius",
}


def upgrade(h5: h5py.File) -> None:
    """Gives everything its name of today."""
    rename_all(h5, NAMES)
    put_text(h5, scene=re.sub(r"^(\s*)shapes(\s*=)", r"\1snapshots\2", get_text(h5, "scene"), flags=re.MULTILINE))
