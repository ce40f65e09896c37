"""Equilibrium paths by their arc length: a closed form, a beam that snaps through, and what is told on the way."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, scene_text, write_arrays
from ranks import run_ranks
from scipy.optimize import minimize_scalar
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import SceneError, SolverError
from fenics_rom.fem.finite_strain import arc_length
from fenics_rom.fem.finite_strain.arc_length import ArcLength
from fenics_rom.fem.finite_strain.newton import NotConvergedError
from fenics_rom.mechanics.step import StepInput

sys.path.append(str(Path(__file__).parents[2] / "demos" / "benchmarks"))
from toggle import RISE, SPAN, THICK, WIDE, load_of_beams
from toggle import YOUNG as STEEL

LARGE = "large_deformation = {}\n"
RIGHT = '[contacts.right]\nsurface = "right"'
TIP = {"outputs.tip": 'surface = "right"'}
SOFT = "young = 1e6\npoisson = 0.35\ndensity = 1000.0"
YOUNG = 1e6

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


def pushed(steps, *force):
    return f"dt = {1 / steps}\nduration = 1.0\nload = [{{ contact = 'right', force = {list(map(float, force))} }}]"


def parts_of(**parts):
    return {"contacts": RIGHT, "material": SOFT} | TIP | parts


def limits(run):
    """Largest and smallest load factors that a run tells of."""
    told = re.findall(r"limit point: the load has a (\w+) value, (\S+) of", "\n".join(run.warnings))
    return {which: float(value) for which, value in told}


# --- a bar between rollers: P = E A λ(λ² - 1)/2 ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """2 m long; of its largest load, where λ² = 1/3, 1.2 times is asked for."""
    mesh = write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays((2.0, 1.0, 1.0), (2, 1, 1)))
    sides = {"front": [0.0, 1.0, 0.0], "back": [0.0, 1.0, 0.0], "bottom": [0.0, 0.0, 1.0], "top": [0.0, 0.0, 1.0]}
    rollers = "".join(f'\n[[supports.held]]\nsurface = "{side}"\nnormal = {normal}' for side, normal in sides.items())
    material = f"young = {YOUNG}\npoisson = 0.0\ndensity = 1.0"
    run = pushed(20, -1.2 * YOUNG / 27**0.5, 0.0, 0.0)
    parts = parts_of(material=material, supports=f'clamped = ["left"]{rollers}', run=run)
    return fr.assemble(acted_on(mesh, LARGE, **parts))


def test_bar_is_followed_along_its_closed_form_until_it_is_inside_out(bar):
    """Its load grows, falls, pulls and grows again; the last step ends at the whole load."""
    told = []
    run = fr.simulate(bar, arc_length=True, report=lambda *progress: told.append(progress))
    load, λ = run.inputs["right"].values[:, 0], 1 + run.outputs["tip"][:, :, 0].mean(axis=1) / 2
    most = YOUNG / 27**0.5
    np.testing.assert_allclose(load, YOUNG * λ * (λ**2 - 1) / 2, atol=1e-9 * most)
    assert load[-1] == pytest.approx(-1.2 * most, rel=1e-12)
    assert λ[-1] < -1
    assert load.max() > 0.5 * most
    found = limits(run)
    assert found["largest"] == pytest.approx(1 / 1.2, rel=2e-3)
    assert found["smallest"] == pytest.approx(-1 / 1.2, rel=2e-2)
    assert run.balance_error < 1e-9
    assert np.ptp(run.numerical) > 0  # what a path of long chords misses
    assert any("negative pivots, where it had 0" in text for text in run.warnings)
    assert run.stepping.startswith("arc-length")
    steps = [text for text, *_ in told if text.startswith("arc length: load ")]
    assert len(steps) > 5
    assert "residual" in steps[0]


def test_limits_are_found_to_high_order(bar):
    """The cubic between two steps: halves of the first load factor bring it nearer by far more than half."""
    errors = []
    for steps in (10, 40):
        found = limits(fr.simulate(bar, dt=1 / steps, arc_length=True))["largest"]
        errors.append(abs(1.2 * found - 1))
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] / 8 or errors[0] < 1e-4


def test_path_that_is_not_at_its_end_is_told(bar):
    run = fr.simulate(bar, dt=0.25, arc_length=True)
    assert any(re.search(r"the path ends at \S+ of the load, after all of the 4 steps", text) for text in run.warnings)


def test_step_that_does_not_converge_is_taken_shorter_and_at_last_refused(bar, monkeypatch):
    path, body = ArcLength(0.2), bar.deformation.stepper(1.0)
    tried, lengths = ArcLength._tried, []

    def fails_if_long(path, at):
        found = tried(path, at)
        lengths.append(path._length)
        if lengths[-1] > most[0] * lengths[0]:
            raise NotConvergedError
        return found

    monkeypatch.setattr(ArcLength, "_tried", fails_if_long)
    most = [0.3]

    def inputs_at(factor):
        return StepInput(np.array([-1e4 * factor, 0.0, 0.0]))

    body.step_along(path, inputs_at)
    assert [length / lengths[0] for length in lengths] == [1.0, 0.5, 0.25]
    assert path.steps == 1
    most[0], before = 0.0, body.x.copy()
    with pytest.raises(SolverError, match=r"no equilibrium was found beyond 0\.0"):
        body.step_along(path, inputs_at)
    np.testing.assert_array_equal(body.x, before)
    body.close()


# --- paths without limits --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    mesh = box_arrays((0.5, 0.05, 0.05), (5, 1, 1), shake=0.2)
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *mesh)


def test_path_ends_where_the_whole_load_at_once_leads(beam):
    """Of forces that turn with the body, too, beside a weight that is always there."""
    effects = (
        f"{LARGE}gravity = {{ acceleration = [0, 0, -3.0] }}\n[effects.pressure.air]\nsurface = 'top'\n"
        "[effects.tendon.cable]\npoints = [[0.01, 0.025, 0.045], [0.25, 0.025, 0.045], [0.49, 0.025, 0.045]]\n"
    )
    run = (
        "dt = 0.1\nduration = 1.0\nload = [{ contact = 'right', force = [0.0, 0.5, 0.5] }, "
        "{ actuator = 'air', force = [-500.0] }, { actuator = 'cable', force = [6.0] }]"
    )
    system = fr.assemble(acted_on(beam, effects, **parts_of(run=run, degree=2)))
    path, plain = fr.simulate(system, arc_length=True), fr.simulate(system, dt=1.0)
    tip = plain.outputs["tip"][-1]
    assert np.abs(tip).max() > 0.1
    np.testing.assert_allclose(path.outputs["tip"][-1], tip, atol=1e-8 * np.abs(tip).max())
    assert path.inputs["cable"].values[-1, 0] == 6.0
    assert not limits(path)
    assert path.balance_error < 1e-9


def test_step_on_which_the_path_bends_too_much_is_taken_shorter(beam, monkeypatch):
    system = fr.assemble(acted_on(beam, LARGE, **parts_of(run=pushed(1, 0.0, 0.0, 10.0), degree=2)))
    tips = []
    for bend in (0.3, 0.1):
        monkeypatch.setattr(arc_length, "MAX_BEND", bend)
        tips.append(np.abs(fr.simulate(system, arc_length=True).outputs["tip"][-1]).max())
    assert 0.01 < tips[1] < 0.7 * tips[0]


# --- Williams' toggle ------------------------------------------------------------------------------------------------


def toggle_scene(folder, bricks, steps=30):
    """Half of two bars that lean on each other, both ends clamped, under a force in its middle (Williams, 1964)."""
    p, cells = box_arrays((1.0, 1.0, 1.0), bricks)
    tall = THICK * np.hypot(SPAN, RISE) / SPAN
    placed = np.column_stack([p[:, 0] * SPAN, p[:, 0] * RISE + (p[:, 1] - 0.5) * tall, p[:, 2] * WIDE / 2])
    mesh = write_arrays(folder / "toggle.msh", placed, cells, box_surfaces(p, cells))
    held = {"right": [1.0, 0.0, 0.0], "bottom": [0.0, 0.0, 1.0]}
    rollers = "".join(f'\n[[supports.held]]\nsurface = "{side}"\nnormal = {normal}' for side, normal in held.items())
    return scene_text(
        mesh,
        effects=LARGE,
        degree=2,
        **parts_of(
            material=f"young = {STEEL}\npoisson = 0.0\ndensity = 7850.0",
            supports=f'clamped = ["left"]{rollers}',
            run=pushed(steps, 0.0, -200.0 / 4, 0.0),
        ),
    )


def test_toggle_snaps_through_at_the_loads_of_beam_theory(tmp_path):
    """Both limits, 150.6 N and 139.0 N, and the load on its way between and beyond them."""
    (tmp_path / "toggle.toml").write_text(toggle_scene(tmp_path, (12, 1, 1)))
    run = fr.simulate(fr.read_scene(tmp_path / "toggle.toml"), arc_length=True)
    most = -minimize_scalar(lambda w: -load_of_beams(w), bounds=(4e-3, 8e-3), method="bounded").fun
    least = minimize_scalar(load_of_beams, bounds=(8e-3, 12e-3), method="bounded").fun
    found = limits(run)
    assert 200 * found["largest"] == pytest.approx(most, rel=0.01)
    assert 200 * found["smallest"] == pytest.approx(least, rel=0.01)
    force, w = -4 * run.inputs["right"].values[:, 1], -run.outputs["tip"].mean(axis=1)[:, 1]
    for instant in np.flatnonzero((w > 1e-3) & (w < 14e-3))[::3]:
        assert force[instant] == pytest.approx(load_of_beams(w[instant]), rel=0.02)
    unstable = [text for text in run.warnings if "gets 1 negative pivots, where it had 0" in text]
    assert len(unstable) == 1
    assert w[-1] > RISE


@pytest.mark.slow
@pytest.mark.ranks
def test_path_does_not_depend_on_the_number_of_ranks(tmp_path):
    (tmp_path / "toggle.toml").write_text(toggle_scene(tmp_path, (4, 1, 1), 10))
    words = ["simulate", "toggle.toml", "--arc-length", "-o", "two.h5"]
    done = run_ranks(2, "-c", f"from fenics_rom.cli.main import main; main({words})", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    two, one = fr.read_trajectory(tmp_path / "two.h5"), fr.simulate(tmp_path / "toggle.toml", arc_length=True)
    np.testing.assert_allclose(two.outputs["tip"], one.outputs["tip"], atol=1e-6 * np.abs(one.outputs["tip"]).max())
    assert limits(two) == limits(one)
    assert limits(two)


# --- what has no path ------------------------------------------------------------------------------------------------

FLOOR = """[effects.contact]
switching = "scene"
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1.0]
normal = [0, 0, 1]
"""


@pytest.mark.parametrize(
    ("effects", "run", "says"),
    [
        ("", pushed(4, 0, 0, 1), "has no effects.large_deformation"),
        (f"inertia = {{}}\n{LARGE}", pushed(4, 0, 0, 1), "has effects.inertia"),
        (LARGE + FLOOR, pushed(4, 0, 0, 1), "has effects.contact"),
        (LARGE, "dt = 0.5\nduration = 1.0", r"has no run.load that could grow"),
        (
            f'{LARGE}[effects.pressure.air]\nsurface = "top"\ncontrol = "volume"\n',
            pushed(4, 0, 0, 1),
            "actuators by stroke",
        ),
    ],
)
def test_scenes_without_a_path_are_refused(beam, effects, run, says):
    system = fr.assemble(acted_on(beam, effects, **parts_of(run=run)))
    with pytest.raises(SceneError, match=says):
        fr.simulate(system, arc_length=True)


def test_a_rom_has_no_path(tmp_path, capsys):
    with pytest.raises(SceneError, match="arc_length cannot be used with a Rom"):
        fr.simulate(soft_rom(), arc_length=True)
    fr.write_rom(tmp_path / "soft.h5", soft_rom())
    with pytest.raises(SystemExit):
        main(["simulate", str(tmp_path / "soft.h5"), "--arc-length", "-o", str(tmp_path / "run.h5")])
    assert "--arc-length: for a scene, run at full order" in capsys.readouterr().err
