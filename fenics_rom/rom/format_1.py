"""ROM files of format 1.x, made ones of this release's format in memory."""

import re

import h5py

from fenics_rom.io.hdf5 import get_text, put_text, rename_all

NAMES = {
    "modes": "contact_models",
    "deformation/drag": "deformation/external_damping",
    "deformation/reach": "deformation/training_radius",
}


SELECTION = "eigenvector-selection"  # that it selects a basis was called a switching


def upgrade(h5: h5py.File) -> None:
    """Gives everything its name of today."""
    rename_all(h5, NAMES)
    scene = re.sub(r"^(\s*)shapes(\s*=)", r"\1snapshots\2", get_text(h5, "scene"), flags=re.MULTILINE)
    if re.search(r"\bswitching\s*=\s*[\"']modal[\"']", scene):
        scene = re.sub(r"^\s*method\s*=\s*[\"']balanced[\"']", "", scene, flags=re.MULTILINE)
        scene = re.sub(r"\bswitching(\s*=\s*)[\"']modal[\"']", rf'method\1"{SELECTION}"', scene)
    put_text(h5, scene=scene)
    if get_text(h5, "switching") == "modal":
        put_text(h5, method=SELECTION, switching="energy")
