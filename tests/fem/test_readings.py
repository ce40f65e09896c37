"""Readings by name, at full order and reduced, against what a hand calculation says."""

import warnings

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.readings import principal_size, von_mises
from fenics_rom.scene.file import parse_scene

# Readings are sums of some ten products of displacements that a solve finds to a condition number of 1e4 times 1e-16.
EXACT = 1e-10
YOUNG = 1e6
LENGTHS = LENGTH, WIDTH, HEIGHT = 1.0, 0.1, 0.2
AREA = WIDTH * HEIGHT
NO_POISSON = f"young = {YOUNG}\npoisson = 0.0\ndensity = 1000.0"  # a bar that is pulled does not thin
RIGHT = '[contacts.right]\nsurface = "right"'
STRESS = {"readings.stress": 'quantity = "von_mises_stress"', "readings.strain": 'quantity = "strain"\nof = "top"'}
PULL = '[effects.prescribed.pull]\nsurface = "right"\nforce = [400.0, 0.0, 0.0]'
CABLE = "[effects.tendon.cable]\npoints = [[0.0, 0.05, 0.1], [0.5, 0.05, 0.1], [1.0, 0.05, 0.1]]"
LENGTH_OF_CABLE = {"readings.cable": 'quantity = "length"\nof = "cable"'}
LARGE = '[effects.large_deformation]\nmaterial = "{law}"'
DEGREES = pytest.mark.parametrize("degree", [1, 2])
BOTH = pytest.mark.parametrize("model", ["full", "reduced"])


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A straight bar of tetrahedra."""
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays(LENGTHS, (2, 1, 2)))


def scene_of(mesh, effects="", degree=2, contacts=RIGHT, **parts):
    """A bar without Poisson's effect; without inertia, so that one step is an equilibrium."""
    return acted_on(mesh, effects, degree=degree, contacts=contacts, **({"material": NO_POISSON} | parts))


def reduced(system, **choices):
    """A ROM of all that is there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, order=system.size, **choices)


def body_of(scene, model):
    """A body at rest."""
    system = fr.assemble(scene)
    if model == "full":
        return FullOrderSimulator(system, 1.0, scene.environment)
    return fr.Simulator(reduced(system), 1.0)


def displaced(scene, field):
    """A full-order body whose nodes X (N, 3) are displaced by field(X) (N, 3), where they can be."""
    system = fr.assemble(scene)
    body = FullOrderSimulator(system, 1.0, scene.environment)
    x = field(system.body.nodes).ravel()[system.body.free]
    body.stepper.set_state(x, np.zeros_like(x))
    return system, body


def middles(system, triangles):
    """Of surface triangles."""
    return system.body.nodes[system.body.triangles[triangles]].mean(axis=1)


@BOTH
@DEGREES
def test_a_bar_in_tension_has_force_over_area(bar, degree, model):
    body = body_of(scene_of(bar, PULL, degree, **STRESS), model)
    body.step(np.zeros(3))
    σ = 400.0 / AREA
    assert np.abs(body.reading("stress") - σ).max() <= EXACT * σ
    ε = body.reading("strain")
    assert ε.shape[1] == 6
    assert np.abs(ε - np.array([σ / YOUNG, 0, 0, 0, 0, 0])).max() <= EXACT * σ / YOUNG


@BOTH
def test_a_cable_in_a_bar_that_is_pulled_is_as_much_longer_as_the_bar(bar, model):
    body = body_of(scene_of(bar, PULL + "\n" + CABLE, **LENGTH_OF_CABLE), model)
    assert body.reading("cable") == pytest.approx(LENGTH, rel=EXACT)
    body.step(np.zeros(4))
    assert body.reading("cable") - LENGTH == pytest.approx(400.0 / AREA / YOUNG * LENGTH, rel=EXACT)


def test_a_gauge_on_a_bent_beam_reads_curvature_times_height(bar):
    """u = κ (x z, 0, -x²/2) is bending without Poisson's effect, and of second degree: at each middle ε_xx = κ z."""
    κ = 0.02
    system, body = displaced(
        scene_of(bar, **STRESS), lambda X: κ * np.stack([X[:, 0] * X[:, 2], 0 * X[:, 0], -(X[:, 0] ** 2) / 2], axis=1)
    )
    reading = system.readings["stress"]
    assert len(reading.triangles) == len(system.body.triangles)  # in the order in which they are drawn
    z = middles(system, reading.triangles)[:, 2]
    assert np.abs(body.reading("stress") - YOUNG * κ * z).max() <= EXACT * YOUNG * κ
    top = system.readings["strain"]
    assert np.abs(middles(system, top.triangles)[:, 2] - HEIGHT).max() <= 1e-12
    assert np.abs(body.reading("strain")[:, 0] - κ * HEIGHT).max() <= EXACT * κ
    assert np.abs(body.reading("strain")[:, 1:]).max() <= EXACT * κ


@DEGREES
def test_strain_on_the_surface_is_that_of_the_field(tmp_path_factory, degree):
    """Every field of the element's degree is held exactly, here with all nine derivatives of all monomials."""
    mesh = write_arrays(tmp_path_factory.mktemp("shaken") / "box.msh", *box_arrays(LENGTHS, (3, 3, 3), shake=0.2))
    rng = np.random.default_rng(0)
    linear, quadratic = rng.standard_normal((3, 3)), rng.standard_normal((3, 3, 3)) * (degree - 1)
    quadratic += quadratic.transpose(0, 2, 1)

    def field(X):
        return X @ linear.T + np.einsum("ijk,nj,nk->ni", quadratic, X, X)

    system, body = displaced(scene_of(mesh, degree=degree, supports=None, effects="inertia = {}", **STRESS), field)
    X = middles(system, system.readings["strain"].triangles)
    H = linear + 2 * np.einsum("ijk,nk->nij", quadratic, X)
    ε = (H + H.transpose(0, 2, 1)) / 2
    expected = np.stack([ε[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))], axis=1)
    assert np.abs(body.reading("strain") - expected).max() <= 1e-12 * np.abs(H).max()


@pytest.fixture(scope="module")
def hollow(tmp_path_factory):
    """A cube of 0.3 m with a chamber of any shape inside, the surface "chamber", and the volume of what is missing."""
    points, cells = box_arrays((0.3, 0.3, 0.3), (3, 3, 3), shake=0.2)
    brick = np.arange(len(cells)) % 27
    missing, cells = cells[brick == 13], cells[brick != 13]
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    outer = box_surfaces(points, cells)
    known = np.unique(np.sort(np.concatenate(list(outer.values())), axis=1), axis=0)
    skin = unique[count == 1]
    inner = skin[~(skin[:, None] == known).all(axis=2).any(axis=1)]
    file = write_arrays(tmp_path_factory.mktemp("hollow") / "hollow.msh", points, cells, outer | {"chamber": inner})
    edges = points[missing[:, 1:]] - points[missing[:, :1]]
    return file, float(np.abs(np.linalg.det(edges)).sum()) / 6


AIR = '[effects.pressure.air]\nsurface = "chamber"'
VOLUME = {"readings.volume": 'quantity = "volume"\nof = "air"'}


@DEGREES
@pytest.mark.parametrize("law", ["", "neo_hookean"])
def test_volume_of_a_chamber_follows_the_body(hollow, degree, law):
    """Moved by u = (F - I)(X - c), its volume is det F times that at rest; of a linear body 1 + tr(F - I) times."""
    mesh, volume = hollow
    F = np.eye(3) + np.array([[0.3, 0.1, 0.0], [0.0, -0.2, 0.2], [0.1, 0.0, 0.1]])
    scene = scene_of(mesh, AIR + "\n" + (LARGE.format(law=law) if law else ""), degree, **VOLUME)
    _, body = displaced(scene, lambda X: (X - 0.15) @ (F - np.eye(3)).T)
    factor = np.linalg.det(F) if law else 1 + np.trace(F - np.eye(3))
    assert body.reading("volume") == pytest.approx(factor * volume, rel=1e-12)


@DEGREES
def test_a_reduced_chamber_that_deforms_largely_has_the_volume_of_its_shape(hollow, degree):
    mesh, volume = hollow
    run = 'dt = 0.01\nduration = 0.05\nload = [{ actuator = "air", force = [3e4] }]'
    effects = "inertia = {}\n" + AIR + "\n" + LARGE.format(law="st_venant_kirchhoff")
    scene = scene_of(mesh, effects, degree, **VOLUME, run=run, reduction="order = 6")
    system = fr.assemble(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        body = fr.Simulator(fr.reduce(system, method="modal+derivatives"), dt=0.01)
        for _ in range(5):
            body.step([0.0, 0.0, 0.0, 3e4])
    full = FullOrderSimulator(system, 0.01, scene.environment)
    full.stepper.set_state(body.displacement().ravel()[system.body.free], np.zeros(system.size))
    assert abs(body.reading("volume") - volume) > 1e-3 * volume
    assert body.reading("volume") == pytest.approx(float(full.reading("volume")), rel=1e-9)


def test_a_surface_that_encloses_no_volume_is_refused(bar):
    with pytest.raises(SceneError, match=r"readings.volume: the surface has an opening whose rim moves"):
        fr.assemble(scene_of(bar, '[effects.pressure.air]\nsurface = "top"', **VOLUME))
    everywhere = "[effects.pressure.air]\nnear = { point = [0.5, 0.0, 0.0], radius = 10.0 }"
    with pytest.raises(SceneError, match=r"readings.volume: the surface is around the body"):
        fr.assemble(scene_of(bar, everywhere, **VOLUME))


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ('clamped = ["left"]', ""),
        ('held = [{ surface = "left", normal = [2, 0, 0] }, { surface = "right" }]', ""),  # a plane of symmetry
        ('held = [{ surface = "left", normal = [0, 1, 0] }, { surface = "right" }]', "opening whose rim moves"),
    ],
)
@DEGREES
def test_a_chamber_that_is_open_where_it_is_held_is_closed_there(tmp_path, degree, held, message):
    """A block without one brick at its held face: what is missing has an opening that stays in its plane."""
    points, cells = box_arrays((0.3, 0.3, 0.3), (3, 3, 3))
    brick = np.arange(len(cells)) % 27
    cells = cells[brick != 4]  # at x = 0, in the middle
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    skin = unique[count == 1]
    middle = points[skin].mean(axis=1)
    inside = ((middle > 1e-6) & (middle < 0.3 - 1e-6)).all(axis=1)
    mesh = write_arrays(tmp_path / "open.msh", points, cells, box_surfaces(points, cells) | {"chamber": skin[inside]})
    scene = scene_of(mesh, AIR, degree, contacts='[contacts.top]\nsurface = "top"', supports=held, **VOLUME)
    if message:
        with pytest.raises(SceneError, match=message):
            fr.assemble(scene)
        return
    rest = 1e-3
    _, body = displaced(scene, lambda X: X * [0.02, 0.05, 0.05])  # what is held at x = 0 stays there
    stretched = 1.07 if "clamped" in held else 1.12
    assert body.reading("volume") == pytest.approx(rest, rel=0.2)
    if "normal" in held:
        assert body.reading("volume") == pytest.approx(rest * stretched, rel=1e-12)


def test_lames_cylinder_has_lames_stress(tmp_path):
    """A quarter of a thick tube under pressure, between planes of symmetry: plane strain, in closed form."""
    inner, outer, pressure, ν = 0.05, 0.1, 2e4, 0.3
    points, cells = box_arrays((1.0, 1.0, 1.0), (8, 12, 1))
    surfaces = box_surfaces(points, cells)
    r, θ = inner + (outer - inner) * points[:, 0], np.pi / 2 * points[:, 1]
    points = np.stack([r * np.cos(θ), r * np.sin(θ), 0.02 * points[:, 2]], axis=1)
    mesh = write_arrays(tmp_path / "tube.msh", points, cells, surfaces)
    planes = {"front": [0, 1, 0], "back": [1, 0, 0], "bottom": [0, 0, 1], "top": [0, 0, 1]}
    held = ", ".join(f'{{ surface = "{name}", normal = {normal} }}' for name, normal in planes.items())
    on_both = {f"readings.{side}": f'quantity = "von_mises_stress"\nof = "{side}"' for side in ("left", "right")}
    air = '[effects.pressure.air]\nsurface = "left"'
    material = f"young = {YOUNG}\npoisson = {ν}\ndensity = 1000.0"
    scene = scene_of(mesh, air, supports=f"held = [{held}]", material=material, **on_both)
    system = fr.assemble(scene)
    body = FullOrderSimulator(system, 1.0, scene.environment)
    body.step(np.array([0.0, 0.0, 0.0, pressure]))
    A = pressure * inner**2 / (outer**2 - inner**2)
    for side in ("left", "right"):
        radius = np.linalg.norm(middles(system, system.readings[side].triangles)[:, :2], axis=1)
        B = A * outer**2 / radius**2
        expected = np.sqrt((4 * B**2 + (A + B - 2 * ν * A) ** 2 + (2 * ν * A - A + B) ** 2) / 2)
        error = body.reading(side) / expected - 1
        # Chords of 7.5 degrees in place of arcs, and eight elements of degree 2 across the wall: 2.3 %.
        assert np.abs(error).max() <= 0.03, side


@BOTH
@DEGREES
def test_a_block_that_is_pressed_evenly_has_an_even_pressure(bar, degree, model):
    """Held on top and pressed from below by d, without Poisson's effect: E d / H at every node."""
    floor = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]'
    scene = scene_of(
        bar,
        floor,
        degree,
        contacts='[contacts.sole]\nsurface = "bottom"',
        supports='clamped = ["top"]',
        **{"readings.sole": 'quantity = "contact_pressure"\nof = "sole"'},
    )
    system = fr.assemble(scene)
    signals = {"floor": lambda t: [0.0, 0.0, 1e-3 * t]}
    if model == "full":
        body = FullOrderSimulator(system, 1.0, scene.environment, signals)
    else:
        body = fr.Simulator(reduced(system), 1.0, signals=signals)
    assert not body.reading("sole").any()
    body.step(np.zeros(0))
    # Contact forces are found to 1e-9 of the velocities to be stopped.
    assert np.abs(body.reading("sole") - YOUNG * 1e-3 / HEIGHT).max() <= 1e-6 * YOUNG * 1e-3 / HEIGHT


@DEGREES
def test_pressures_times_areas_are_the_normal_forces_of_any_obstacle(bar, degree):
    """Also of a ball that is smaller than a triangle, and touches points between the nodes."""
    ball = '[effects.contact]\npoints = "surface"\n[effects.contact.obstacles.ball]\nshape = "sphere"\n'
    ball += "center = [0.4, 0.06, -0.05]\nradius = 0.05"
    sole = {"readings.sole": 'quantity = "contact_pressure"\nof = "sole"'}
    contacts = '[contacts.sole]\nsurface = "bottom"'
    scene = scene_of(bar, ball, degree, contacts=contacts, supports='clamped = ["top"]', **sole)
    system = fr.assemble(scene)
    body = FullOrderSimulator(system, 1.0, scene.environment, {"ball": lambda t: [0.0, 0.0, 2e-2 * t]})
    body.step(np.zeros(0))
    reading = system.readings["sole"]
    area = np.bincount(reading.facets.ravel(), np.repeat(reading.areas, 3 * degree) / (3 * degree))
    pushed = body.stepper.contact.normal_forces.sum()
    assert pushed > 0
    assert body.reading("sole") @ area == pytest.approx(pushed, rel=1e-12)


@pytest.mark.parametrize("law", ["st_venant_kirchhoff", "neo_hookean"])
def test_a_bar_that_is_stretched_far_has_cauchys_stress_and_greens_strain(bar, law):
    """Without Poisson's effect it does not thin: σ = F/A at any stretch s, of which P = μ (s³ - s) or μ (s - 1/s)."""
    pull = PULL.replace("400.0", "8000.0")
    effects = "\n".join([pull, CABLE, LARGE.format(law=law)])
    body = body_of(scene_of(bar, effects, **STRESS, **LENGTH_OF_CABLE), "full")
    body.step(np.zeros(4))
    σ, μ = 8000.0 / AREA, YOUNG / 2
    polynomial = [μ, 0, -μ, -σ] if law == "st_venant_kirchhoff" else [μ, -σ, -μ]
    stretch = max(np.roots(polynomial).real)
    assert stretch > 1.2
    accuracy = 1e-6  # to which Newton's method balances forces
    assert np.abs(body.reading("stress") / σ - 1).max() <= accuracy
    assert np.abs(body.reading("strain")[:, 0] - (stretch**2 - 1) / 2).max() <= accuracy
    assert np.abs(body.reading("strain")[:, 1:]).max() <= accuracy
    assert body.reading("cable") == pytest.approx(stretch * LENGTH, rel=accuracy)


def test_a_tendon_that_turns_with_the_body_has_its_own_length(bar):
    """Turned and stretched, the pieces between its points are as long as they are; a linear length is not."""
    scene = scene_of(bar, CABLE + "\n" + LARGE.format(law="neo_hookean"), **LENGTH_OF_CABLE)
    F = np.array([[0.0, -1.0, 0.0], [1.2, 0.0, 0.0], [0.0, 0.0, 1.0]])
    _, body = displaced(scene, lambda X: (X - [0.0, 0.05, 0.1]) @ (F - np.eye(3)).T)
    assert body.reading("cable") == pytest.approx(1.2 * LENGTH, rel=1e-12)


MARKERS = {"top": [0.31, 0.04, 0.23], "corner": [1.02, 0.12, 0.17], "inside": [0.4, 0.05, 0.19]}
READ_MARKERS = {f"readings.{name}": f'quantity = "marker"\npoint = {place}' for name, place in MARKERS.items()}
FREE = {"supports": None}


@DEGREES
@pytest.mark.parametrize("law", ["", "st_venant_kirchhoff"])
def test_markers_off_the_surface_turn_with_it(bar, degree, law):
    """As one rigid body, however far it is turned; of a linear body u = ω x X, on any of its sides."""
    if law:
        R, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
        turn = R * np.sign(np.linalg.det(R)) - np.eye(3)
    else:
        turn = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.1], [-0.2, 0.1, 0.0]])
    effects = "inertia = {}\n" + (LARGE.format(law=law) if law else "")
    outputs = {} if law else {"outputs.both": f"markers = {[*MARKERS.values()]}"}
    _, body = displaced(scene_of(bar, effects, degree, **FREE, **READ_MARKERS, **outputs), lambda X: X @ turn.T + 0.1)
    expected = np.array(list(MARKERS.values())) @ turn.T + 0.1
    assert np.abs([body.reading(name) for name in MARKERS] - expected).max() <= 1e-12
    if not law:
        assert np.abs(body.displacement("both") - expected).max() <= 1e-12


def test_markers_on_a_bent_beam_stand_on_its_normals(bar):
    """u = κ (x z, 0, -x²/2) keeps normals straight: what is above is displaced as if the beam were that high."""
    κ = 0.02
    _, body = displaced(
        scene_of(bar, **READ_MARKERS), lambda X: κ * np.stack([X[:, 0] * X[:, 2], 0 * X[:, 0], -(X[:, 0] ** 2) / 2], 1)
    )
    x, _, z = MARKERS["top"]
    assert np.abs(body.reading("top") - κ * np.array([x * z, 0, -(x**2) / 2])).max() <= 1e-12 * κ
    x, _, z = MARKERS["corner"]  # 0.02 m before the end, where the beam has the slope -κ
    assert np.abs(body.reading("corner") - κ * np.array([z, 0, -0.5 - 0.02])).max() <= 1e-12 * κ


def test_markers_of_a_reduced_body_that_bends_far_are_those_of_its_shape(bar, tmp_path):
    push = 'dt = 0.02\nduration = 0.1\nload = [{ contact = "right", force = [0, 0, -300] }]'
    scene = scene_of(bar, "inertia = {}\n" + LARGE.format(law="neo_hookean"), **READ_MARKERS, run=push)
    system = fr.assemble(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        rom = fr.reduce(system, method="modal+derivatives", order=6)
        fr.write_rom(tmp_path / "rom.h5", rom)
        run = fr.simulate(fr.read_rom(tmp_path / "rom.h5"))
    fr.write_trajectory(tmp_path / "run.h5", run)
    top = fr.read_trajectory(tmp_path / "run.h5").readings["top"]
    full = FullOrderSimulator(system, 0.02, scene.environment)
    full.stepper.set_state(run.snapshots[-1].ravel()[system.body.free], np.zeros(system.size))
    assert np.abs(top.values[-1]).max() > 0.02
    assert np.abs(top.values[-1] - full.reading("top")).max() <= 1e-12
    assert fr.compare(run, run)["reading top"].relative == 0
    assert top.sizes[-1] == pytest.approx(np.linalg.norm(top.values[-1]))


@pytest.mark.parametrize("frame", ["fixed", "moving"])
def test_a_reduced_body_that_nothing_holds_has_the_readings_of_its_shape(bar, frame, tmp_path):
    """Of all shapes, under a push that hardly turns it: in both frames strains and stresses are those at full order."""
    push = 'dt = 1e-3\nduration = 0.02\nload = [{ contact = "right", force = [1e-4, 0, -1e-4] }]'
    scene = acted_on(bar, "inertia = {}", contacts=RIGHT, run=push, **FREE, **STRESS)
    full = fr.simulate(fr.assemble(scene))
    system = fr.assemble(parse_scene(f'frame = "{frame}"\n{scene.text}'))
    fr.write_rom(tmp_path / "rom.h5", reduced(system, method="modal"))
    run = fr.simulate(fr.read_rom(tmp_path / "rom.h5"))
    for name in ("stress", "strain"):
        own, its = (each.readings[name].values for each in (run, full))
        assert np.abs(its).max() > 0
        # A frame leaves out what a turn, by some 1e-6 here, makes of strains.
        assert np.abs(own - its).max() <= (1e-9 if frame == "fixed" else 1e-5) * np.abs(its).max()


def test_markers_of_a_moving_frame_are_carried_by_it(bar):
    """Of a body that is turned far and hardly strained: as far from other points as before."""
    places = [MARKERS["top"], *np.eye(3)[[0]].tolist(), [0.0, 0.1, 0.0], [0.0, 0.0, 0.2]]
    outputs = {"outputs.top": f"markers = {places[:1]}", "outputs.corners": f"points = {places[1:]}"}
    run = "dt = 0.01\nduration = 0.2\ninitial = { spin = [1, 10, 3] }"
    material = "young = 1e12\npoisson = 0.0\ndensity = 1000.0"
    text = scene_text(bar, effects="inertia = {}", contacts=RIGHT, material=material, run=run, **FREE, **outputs)
    system = fr.assemble(parse_scene(f'frame = "moving"\n{text}'))
    moved = fr.simulate(reduced(system, method="modal")).outputs
    now = np.array(places) + np.concatenate([moved["top"][-1], moved["corners"][-1]])
    assert np.linalg.norm(moved["top"][-1]) > 0.2
    distances = [np.linalg.norm(at[0] - at[1:], axis=1) for at in (now, np.array(places))]
    assert np.abs(distances[0] - distances[1]).max() <= 1e-6


def test_markers_far_from_the_body_are_refused(bar):
    far = {"readings.far": 'quantity = "marker"\npoint = [310.0, 40.0, 230.0]'}
    with pytest.raises(SceneError, match=r"readings.far.point: \[310.0.* m from the body; at most its size, 1.02 m"):
        fr.assemble(scene_of(bar, **far))
    with pytest.raises(SceneError, match=r"outputs.far.markers: \[310.0"):
        fr.assemble(scene_of(bar, **{"outputs.far": "markers = [[310.0, 40.0, 230.0]]"}))


@pytest.mark.parametrize("quantity", ["von_mises_stress", "strain"])
def test_stress_of_a_material_that_relaxes_is_told_to_lack_its_branches(bar, quantity):
    effects = "inertia = {}\n[effects.viscoelasticity]\nratios = [0.5, 0.25]\ntimes = [0.1, 1.0]"
    told = fr.assemble(scene_of(bar, effects, **{"readings.at": f'quantity = "{quantity}"'})).warnings
    said = [text for text in told if text.startswith("readings.at: stress is read of the relaxed material alone")]
    assert len(said) == (quantity != "strain")
    assert all("up to 1.75 times as large" in text for text in said)


def test_numbers_of_stress_and_strain():
    shear = np.array([[0.0, 0, 0, 0, 0, 2.0], [3.0, 3, 3, 0, 0, 0], [-5.0, 0, 0, 0, 0, 0]]).T
    assert von_mises(shear) == pytest.approx([2 * np.sqrt(3), 0, 5], abs=1e-15)
    assert principal_size(shear.T) == pytest.approx([2, 3, 5])


@BOTH
def test_a_reading_that_is_not_there_is_refused(bar, model):
    with pytest.raises(StepError, match=r"reading 'strian' .* did you mean 'strain'|no reading 'strian'|strian"):
        body_of(scene_of(bar, **STRESS), model).reading("strian")
