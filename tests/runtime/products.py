"""Scenes of two effects or one, on a small beam that is held, carried or free: what every use of a ROM has to take."""

import warnings

from bodies import box_arrays, scene_text, write_arrays
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

INERTIA = "inertia = {}\n"
DAMPING = "damping = { alpha = 0.5, beta = 2e-4 }\n"
GRAVITY = "gravity = { acceleration = [0.0, 0.0, -9.81] }\n"
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -4e-4]\nnormal = [0, 0, 1]\n'
BALL = '[effects.contact.obstacles.ball]\nshape = "sphere"\ncenter = [0.27, 0.015, -0.0505]\nradius = 0.05\n'
ROUGH = "friction = { coefficient = 0.4 }\n"
ROPE = "[effects.tendon.rope]\npoints = [[0.0, 0.015, 0.004], [0.15, 0.015, 0.002], [0.3, 0.015, 0.004]]\n"
RUBS = "tendon_friction = { coefficient = 0.3 }\n"
RELAXES = "viscoelasticity = { ratios = [0.5, 0.2], times = [0.02, 0.3] }\n"
HELD = {
    "contact": ROUGH + FLOOR,
    "springs": ROUGH + "[effects.contact]\nmethod = 'penalty'\nstiffness = 1e3\n" + FLOOR,
    "bare": ROUGH + "[effects.contact]\nresidual_compliance = false\n" + BALL,
    "stroke": ROPE + 'control = "length"\n',
    "rubbing": RUBS + ROPE,
    "relaxing": RELAXES + ROUGH + FLOOR,
    "large": "",
    "still": ROUGH + FLOOR,
}
MOVING = {"plain": ROPE, "touching": ROUGH + FLOOR}


def kinds() -> list[tuple[str, str]]:
    """Frame and effects of each."""
    return [("held", name) for name in HELD] + [(frame, name) for frame in ("carried", "free") for name in MOVING]


def product(folder, frame: str, name: str) -> fr.Rom:
    """The ROM of one."""
    if name == "large":  # which needs no training
        return soft_rom(contact=True, order=6)
    effects = HELD[name] if frame == "held" else MOVING[name]
    inertia = "" if name == "still" else INERTIA
    damping = "" if name == "still" else DAMPING
    scene = scene_text(
        write_arrays(folder / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1))),
        material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
        supports=None if frame == "free" else 'clamped = ["left"]',
        contacts='[contacts.right]\nsurface = "right"\n[contacts.bottom]\nsurface = "bottom"\n',
        effects=inertia + damping + GRAVITY + effects,
        **{"outputs.tip": "points = [[0.3, 0.03, 0.02]]"},
    )
    moving = "" if frame == "held" else 'frame = "moving"\n'
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(moving + scene)), order=6)
