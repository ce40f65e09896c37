"""Gradients of bodies made of any parts: elastic law x frame x what acts x what touches."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import check_gradient
from soft_rom import soft_rom
from test_differentiation_frames import lowered, thrown
from test_moving_parts import KINDS, PARTS, in_frame

import fenics_rom as fr
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.mechanics.tendon import turning_angles, turning_slopes
from fenics_rom.scene.file import parse_scene

H = 2e-3
pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
WINDING = (
    "points = [[0.0, 0.015, 0.0], [0.08, 0.015, 0.008], [0.15, 0.015, 0.0], [0.22, 0.015, 0.008], [0.3, 0.015, 0.0]]"
)
RUBS = {"tendon_friction": "coefficient = 0.6"}
SMALL = {
    "guides": {"tendon.rope": WINDING, **RUBS},
    "stroke at guides": {"tendon.rope": f'{WINDING}\ncontrol = "length"', **RUBS},
    "volume": PARTS["volume"],
    "gas": PARTS["gas"],
    "touched": PARTS["touched"],
}
AMPLITUDE = {"guides": 2.0, "stroke at guides": 1e-3, "volume": 1e-7, "gas": 1e-6, "touched": 1e-3}
TIP = {"outputs.tip": "points = [[0.3, 0.0, 0.0], [0.3, 0.03, 0.02]]"}


def small(folder, parts, frame):
    """A ROM of a beam of small strains."""
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    effects = {f"effects.{name}": text for name, text in SMALL[parts].items()}
    supports = None if frame in ("free", "drifting") else 'clamped = ["left"]'
    contacts = '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'
    text = scene_text(mesh, supports=supports, damping="alpha = 0.5, beta = 2e-4", contacts=contacts, **effects | TIP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(
            fr.assemble(parse_scene(f'frame = "{"fixed" if frame in ("held", "drifting") else "moving"}"\n{text}')),
            order=8,
        )


def along(make, frame, amplitude, size, steps=14):
    """How a body is put somewhere, inputs with an actuator that comes, the start, and directions."""
    random, at_rest = np.random.default_rng(0), make()
    order, ω = at_rest.model.order, at_rest.model.safe_frequencies

    def body(q, r, *pose):
        body = make()
        body.state = q, r
        if pose:
            body.place(thrown(*pose))
        return body

    u = 0.01 * size * random.standard_normal((steps, at_rest.inputs))
    grows = amplitude * np.linspace(0.2, 1.0, steps)
    u[:, at_rest.input_slices()[next(iter(at_rest.rom.actuators))]] = grows[:, None]
    start = 1e-3 * size * random.standard_normal(order) / ω, 1e-3 * size * random.standard_normal(order)
    directions = [np.abs(part) * random.standard_normal(part.shape) for part in (u, *start)]
    directions[0] *= 0.1
    if frame == "free":
        start += tuple(np.zeros((4, 3)))
        directions += list(np.array([1e-4, 1e-3, 1e-3, 1e-2])[:, None] * random.standard_normal((4, 3)))
    return body, u, start, directions


@pytest.mark.parametrize("frame", ["held", "carried", "free"])
@pytest.mark.parametrize("parts", SMALL)
def test_gradient_of_small_strains_goes_through_all_that_acts(tmp_path, parts, frame):
    """Guides that slide and stick, strokes and volumes that are held, materials that relax, on a floor."""
    if frame == "free" and parts in ("volume", "gas"):
        pytest.skip("a chamber needs a body that encloses it")
    rom, signals = small(tmp_path, parts, frame), {"base_path": lowered} if frame == "carried" else {}
    at, u, start, directions = along(lambda: fr.Simulator(rom, H, signals=signals), frame, AMPLITUDE[parts], 1.0)
    check_gradient(at, u, start, directions)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_gradient_of_a_body_that_drifts_goes_through_contact(tmp_path):
    """Of rigid motions of small size, in a frame that stays."""
    rom = small(tmp_path, "touched", "drifting")

    def make():
        return fr.Simulator(rom, H)

    at, u, start, directions = along(make, "held", AMPLITUDE["touched"], 1.0)
    u[:, 2] -= 10.0
    body = at(*start)
    for row in u:
        body.step(row)
    assert len(start[0]) > rom.rigid == 6
    assert body.contact_forces().any()
    check_gradient(at, u, start, directions)


@pytest.mark.parametrize("law", ["st_venant_kirchhoff", "neo_hookean"])
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", ["held", "carried"])
def test_gradient_of_large_deformation_goes_through_relaxation_and_contact(law, stepper, kind, frame):
    """By both steps, of a material that relaxes or not, by a tension or a stroke."""
    rom, signals = KINDS[kind](soft_rom(law, order=8, contact=True)), {}
    if frame == "carried":
        rom, signals = in_frame(rom), {"base_path": lowered}
        points = {name: np.tile(rom.nodes[-1], (len(rows) // 3, 1)) for name, rows in rom.outputs.items()}
        rom = replace(rom, moving_frame=replace(rom.moving_frame, output_points=points))

    def make():
        return fr.Simulator(rom, H, stepper=stepper, signals=signals)

    check_gradient(*along(make, frame, 2e-3 if kind == "stroke" else 0.5, 1.0))


@pytest.mark.parametrize("law", ["st_venant_kirchhoff", "neo_hookean"])
@pytest.mark.parametrize("kind", ["plain", "stroke"])
@pytest.mark.parametrize("stiffness", [None, 30.0], ids=["rigid", "penalty"])
def test_gradient_of_equilibria_on_a_base_goes_through_contact_and_large_deformation(law, kind, stiffness):
    """By a tension or a stroke, on a base that lowers the body onto the floor and turns it."""
    rom = in_frame(KINDS[kind](soft_rom(law, order=8, contact=True, inertia=False)))
    points = {name: np.tile(rom.nodes[-1], (len(rows) // 3, 1)) for name, rows in rom.outputs.items()}
    acting = replace(rom.environment, contact_law=replace(rom.environment.contact_law, stiffness=stiffness))
    rom = replace(rom, moving_frame=replace(rom.moving_frame, output_points=points), environment=acting)

    def make():
        return fr.Simulator(rom, H, signals={"base_path": lambda time: lowered(2 * time)})

    at, u, start, directions = along(make, "carried", 0.5, 0.05)
    body = at(*start)
    for row in u:
        body.step(row)
    assert body.contact_forces().any()
    start, directions[1:] = [0 * part for part in start], [0 * part for part in start]
    check_gradient(at, u, start, directions)


FREE = {
    "relaxing": {"tendon.rope": PARTS["stroke"]["tendon.rope"], "viscoelasticity": "ratios = [0.5]\ntimes = [0.02]"},
    "pressed": {"pressure.air": 'surface = "top"'},
    "tied": {"tendon.rope": WINDING, **RUBS, "springs.bed": 'surface = "right"\nstiffness = 1.0'},
}


@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("parts", FREE)
def test_gradient_of_a_free_body_that_bends_far(tmp_path, parts, stepper):
    """Strokes and relaxation; an open surface under pressure; guides that rub, and springs to the ground."""
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((0.3, 0.03, 0.02), (3, 1, 1)))
    effects = {f"effects.{name}": text for name, text in FREE[parts].items()} | {"effects.large_deformation": ""}
    largest, actuator = 1e-4 if parts == "relaxing" else 0.1, "air" if parts == "pressed" else "rope"
    run = f'dt = 1e-3\nduration = 2e-3\n[[run.load]]\nactuator = "{actuator}"\nforce = [{largest}]'
    text = scene_text(mesh, supports=None, damping="alpha = 0.5, beta = 2e-4", run=run, **effects | TIP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = fr.assemble(parse_scene(f'frame = "moving"\n{text}'))
        rom = fr.reduce(system, order=6, method="modal+derivatives")
    amplitude = {"relaxing": 1e-3, "pressed": 30.0, "tied": 1.0}[parts]
    ε = 1e-5 if parts == "tied" else 1e-4  # where guides rub there are kinks, which a difference must not go over
    check_gradient(*along(lambda: fr.Simulator(rom, H, stepper=stepper), "free", amplitude, 1.0), ε=ε)


def test_what_a_cable_turns_by_at_its_guides_has_a_slope():
    """Against differences of the fourth order; where it goes straight on it is 0."""
    random, reach = np.random.default_rng(1), 1e-3
    points = random.standard_normal((5, 3))
    slopes = turning_slopes(points)
    for place in np.ndindex(points.shape):
        moved = np.zeros(points.shape)
        moved[place] = reach
        near, far = (turning_angles(points + k * moved) - turning_angles(points - k * moved) for k in (1, 2))
        assert slopes[(slice(None), *place)] == pytest.approx((8 * near - far) / (12 * reach), abs=1e-9)
    assert not turning_slopes(np.arange(12.0).reshape(4, 3)).any()
