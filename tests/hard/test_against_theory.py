"""Scenes whose answer stands in a textbook: at full order, and of ROMs of them, with the bound they allow."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

G = 9.81
SYMMETRIC = '[[supports.held]]\nsurface = "{}"\nnormal = {}\n'
MATERIAL = "young = {}\npoisson = {}\ndensity = 1000.0"


def mapped_box(file, lengths, bricks, place=lambda points: points):
    """A box, its faces named, whose points are moved."""
    points, cells = box_arrays(lengths, bricks)
    return write_arrays(file, place(points), cells, box_surfaces(points, cells))


def both(text, order=None):
    """The run of a scene at full order, and of a ROM of it where an order is given."""
    scene = parse_scene(text)
    system = fr.assemble(scene)
    return [fr.simulate(system), *([] if order is None else [fr.simulate(fr.reduce(system, order=order), scene=scene)])]


def test_drop_takes_the_time_of_free_fall(tmp_path):
    """√(2 h/g), to one step."""
    h, dt = 0.1, 2e-4
    text = scene_text(
        write_arrays(tmp_path / "box.msh", *box_arrays((0.1, 0.1, 0.1), (1, 1, 1))),
        supports=None,
        effects=f"inertia = {{}}\ndamping = {{ beta = 1e-3 }}\ngravity = {{ acceleration = [0, 0, -{G}] }}",
        contacts='[contacts.bottom]\nsurface = "bottom"',
        run=f"dt = {dt}\nduration = 0.16",
        **{"effects.contact.obstacles.ground": f'shape = "half-space"\npoint = [0, 0, -{h}]\nnormal = [0, 0, 1]'},
    )
    for run in both(text, order=12):
        touched = run.times[np.flatnonzero(run.forces["ground"][:, 2] > 0)[0]]
        assert abs(touched - np.sqrt(2 * h / G)) <= 1.01 * dt


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_block_on_an_incline_slides_or_sticks_around_the_tangent(tmp_path, share):
    """Slides with g (sin θ - μ cos θ) where μ < tan θ, and does not where μ > tan θ; stands on it from the start."""
    θ, duration = 0.5, 0.1
    μ = share * np.tan(θ)
    down = [float(G * np.sin(θ)), 0.0, float(-G * np.cos(θ))]
    text = scene_text(
        write_arrays(tmp_path / "box.msh", *box_arrays((0.2, 0.1, 0.05), (2, 1, 1))),
        supports=None,
        material=MATERIAL.format(1e7, 0.3),
        effects=f"inertia = {{}}\ndamping = {{ beta = 1e-3 }}\ngravity = {{ acceleration = {down} }}\n"
        f"friction = {{ coefficient = {μ} }}",
        contacts='[contacts.bottom]\nsurface = "bottom"',
        run=f"dt = 1e-3\nduration = {duration}",
        **{
            "effects.contact.obstacles.ground": 'shape = "half-space"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]',
            "outputs.top": 'surface = "top"',
        },
    )
    sag = 1000.0 * G * 0.05**2 / 1e7  # what the block gives way under its own weight
    for run in both(text, order=20):
        along = run.outputs["top"][:, 0, 0]
        if share > 1:
            assert np.abs(along).max() <= 10 * sag
        else:
            acceleration = 2 * np.polyfit(run.times, along, 2)[0]
            assert acceleration == pytest.approx(G * (np.sin(θ) - μ * np.cos(θ)), rel=0.03)
        assert run.balance_error <= 1e-12


def test_ball_is_pressed_in_as_hertz_says(tmp_path):
    """F = 4/3 E* √R δ^1.5 of a rigid ball on a half-space; a quarter of a block 40 radii of contact wide."""
    radius, depth, young, poisson = 0.01, 1e-4, 1e6, 0.3
    a = np.sqrt(radius * depth)
    text = scene_text(
        mapped_box(
            tmp_path / "block.msh", (1, 1, 1), (8, 8, 8), lambda p: 40 * a * (0.05 * p + 0.95 * p**4) * [1, 1, -1]
        ),
        degree=2,
        supports='clamped = ["top"]\nheld = [{ surface = "left", normal = [1, 0, 0] }, '
        '{ surface = "front", normal = [0, 1, 0] }]',
        material=MATERIAL.format(young, poisson),
        contacts=f"[contacts.touched]\nnear = {{ point = [0, 0, 0], radius = {1.3 * a} }}",
        effects="",
        run="dt = 1.0\nduration = 1.0",
        **{
            "effects.contact.obstacles.ball": f'shape = "sphere"\ncenter = [0, 0, {radius}]\nradius = {radius}\n'
            'table = "ball.csv"'
        },
    )
    (tmp_path / "ball.csv").write_text(f"time (s), x (m), y (m), z (m)\n0, 0, 0, 0\n1, 0, 0, -{depth}\n")
    scene = parse_scene(text, folder=tmp_path)
    force = -4 * fr.simulate(fr.assemble(scene)).forces["ball"][-1, 2]
    assert force == pytest.approx(4 / 3 * young / (1 - poisson**2) * np.sqrt(radius) * depth**1.5, rel=0.05)


def test_tendon_bends_a_beam_by_its_moment(tmp_path):
    """A cable under T at a distance e of the axis is a moment T e: the tip goes by T e L²/2 E I."""
    length, side, young, tension = 1.0, 0.05, 1e6, 0.01
    z = side / 2
    text = scene_text(
        mapped_box(tmp_path / "beam.msh", (length, side, side), (20, 1, 2), lambda p: p - [0, z, z]),
        degree=2,
        material=MATERIAL.format(young, 0.0),
        effects=f"[effects.tendon.cable]\npoints = [[0, 0, {z}], [{length}, 0, {z}]]",
        run=f'dt = 1.0\nduration = 1.0\n[[run.load]]\nactuator = "cable"\nforce = [{tension}]',
        **{"outputs.tip": f"points = [[{length}, 0, 0]]"},
    ).replace("[effects]\n", "")
    for run in both(text, order=4):
        assert run.outputs["tip"][-1, 0, 2] == pytest.approx(
            tension * z * length**2 / (2 * young * side**4 / 12), rel=0.02
        )


def test_pressure_widens_a_pipe_as_lame_says(tmp_path):
    """u(a) = (1 + ν) p a/(E (b² - a²)) ((1 - 2 ν) a² + b²), in plane strain; a quarter between planes of symmetry."""
    a, b, young, poisson, pressure = 1.0, 2.0, 1e6, 0.3, 1e3

    def bend(p):
        r, φ = a + (b - a) * p[:, 0], np.pi / 2 * p[:, 1]
        return np.column_stack([r * np.cos(φ), r * np.sin(φ), 0.2 * p[:, 2]])

    planes = (("front", [0, 1, 0]), ("back", [1, 0, 0]), ("bottom", [0, 0, 1]), ("top", [0, 0, 1]))
    held = "".join(SYMMETRIC.format(*plane) for plane in planes)
    text = held + scene_text(
        mapped_box(tmp_path / "pipe.msh", (1, 1, 1), (4, 8, 1), bend),
        degree=2,
        supports=None,
        material=MATERIAL.format(young, poisson),
        effects='[effects.pressure.inside]\nsurface = "left"',
        run=f'dt = 1.0\nduration = 1.0\n[[run.load]]\nactuator = "inside"\nforce = [{pressure}]',
        **{"outputs.inside": f"points = [[{a}, 0, 0], [0, {a}, 0]]"},
    ).replace("[effects]\n", "")
    expected = (1 + poisson) * pressure * a / (young * (b**2 - a**2)) * ((1 - 2 * poisson) * a**2 + b**2)
    for run in both(text, order=3):
        first, last = run.outputs["inside"][-1]
        np.testing.assert_allclose([first[0], last[1]], expected, rtol=0.01)


def test_bar_that_hits_a_wall_pushes_for_two_passages_of_its_wave(tmp_path):
    """St. Venant: the force is ρ c A v for 2 L/c, c = √(E/ρ), and then the bar leaves with v."""
    length, side, young, speed = 1.0, 0.05, 1e6, 0.1
    c = np.sqrt(young / 1000.0)
    passage = 2 * length / c
    text = scene_text(
        mapped_box(tmp_path / "bar.msh", (length, side, side), (60, 1, 1)),
        supports=None,
        material=MATERIAL.format(young, 0.0),
        effects="inertia = {}\ndamping = { beta = 2e-6 }",
        contacts='[contacts.end]\nsurface = "left"',
        run=f"dt = {passage / 400}\nduration = {1.5 * passage}\ninitial = {{ velocity = [-{speed}, 0, 0] }}",
        **{"effects.contact.obstacles.wall": 'shape = "half-space"\npoint = [0, 0, 0]\nnormal = [1, 0, 0]'},
    )
    (run,) = both(text)
    force, times = run.forces["wall"][:, 0], run.times
    pushing = times[force > 0]
    assert force[(times > 0.05 * passage) & (times < 0.9 * passage)].mean() == pytest.approx(
        1000.0 * c * side**2 * speed, rel=0.01
    )
    assert pushing.max() == pytest.approx(passage, rel=0.05)
    impulse = force.sum() * (times[1] - times[0])
    assert impulse == pytest.approx(2 * 1000.0 * length * side**2 * speed, rel=0.02)


def test_cantilever_swings_at_eulers_frequency(tmp_path):
    """ω = 1.8751² √(E I/ρ A)/L²; rotary inertia and shear take 0.2 % at L = 20 h."""
    length, side, young = 1.0, 0.05, 1e6
    text = scene_text(
        mapped_box(tmp_path / "beam.msh", (length, side, side), (20, 1, 1)),
        degree=2,
        material=MATERIAL.format(young, 0.0),
    )
    rom = fr.reduce(fr.assemble(parse_scene(text)), order=10)
    expected = 1.87510407**2 * np.sqrt(young * side**2 / 12 / 1000.0) / length**2
    assert np.sqrt(rom.contact_models["right"].eigenvalues.min()) == pytest.approx(expected, rel=5e-3)
