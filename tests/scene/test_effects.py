"""The table of effects; what scenes may say of them, what every mistake is told; what files hold of them."""

import re
import warnings
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from bodies import acted_on, box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.compilation import compiled
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, FileError, MeshError, SceneError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.environment import Run
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.scene.contact import Contact
from fenics_rom.scene.effect_table import ACTUATORS, EFFECTS, LOADS
from fenics_rom.scene.effects import Dashpot, Effects, Gravity, Inertia, LargeDeformation, PrescribedForce
from fenics_rom.scene.file import parse_scene

RIGHT = '[contacts.right]\nsurface = "right"'
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -0.01]\nnormal = [0, 0, 1]\n'
INERTIA = "inertia = {}\n"
ALL = f"""
inertia = {{}}
gravity = {{ acceleration = [0, 0, -9.81] }}
[effects.damping]
alpha = 0.5
beta = 1e-3
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 0.3
[effects.springs.bed]
surface = "right"
stiffness = 20.0
[effects.base_motion.quake]
direction = [1, 0, 0]
table = "quake.csv"
[effects.prescribed.push]
surface = "right"
table = "push.csv"
[effects.prescribed.poke]
point = [1.0, 0.1, 0.1]
force = [0.0, 1.0, 0.0]
[effects.pressure.wind]
surface = "right"
[effects.tendon.rope]
points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
[effects.friction]
coefficient = 0.25
{FLOOR}
[effects.contact.obstacles.ball]
shape = "sphere"
center = [1.2, 0.2, 0.15]
radius = 0.1
table = "push.csv"
"""
TABLES = {
    "quake.csv": np.array([[0.0, 0.0], [0.1, 1.0]]),
    "push.csv": np.array([[0.0, 0.0, 0.0, 0.0], [0.1, -0.15, 0.0, 0.0]]),
}
RUN = {"run": "dt = 0.01\nduration = 0.1\nsnapshots = 2"}


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("effects") / "box.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1)))


def parse(effects, mesh="none.msh", **parts):
    text = scene_text(Path(mesh), **({"contacts": RIGHT} | parts), effects=effects)
    return parse_scene(text, tables=TABLES, source="scene.toml")


def reduced(system, **choices):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, **choices)


@pytest.fixture(scope="module")
def system(mesh):
    return fr.assemble(parse(ALL, mesh, **RUN))


@pytest.fixture(scope="module")
def rom(system):
    return reduced(system, order=12)


# --- the table -------------------------------------------------------------------------------------------------------


def test_table_of_effects_is_sound():
    assert set(LOADS) | set(ACTUATORS) <= set(EFFECTS)
    for name, effect in EFFECTS.items():
        law = effect.law
        assert law.force, name
        assert set(law.needs) <= set(EFFECTS), name
        assert set(law.changing) <= set(effect.parameters), name
        balance = (law.stores, law.dissipates, law.supplies)
        assert any(part != "nothing" for part in balance), name
    assert EFFECTS["gravity"].numbers == {"acceleration": ("m/s2", 3)}
    assert EFFECTS["friction"].numbers == {"coefficient": ("1", 1)}
    assert EFFECTS["viscoelasticity"].numbers == {"ratios": ("1", None), "times": ("s", None)}
    assert EFFECTS["tendon"].numbers == {}


def test_all_effects_are_read_with_their_defaults():
    knob = '[effects.point_masses.knob]\nsurface = "right"\nmass = 0.2\n'
    knob += '[effects.rigid_parts.nail]\nsurface = "right"\nmass = 0.2\ncenter = [1.1, 0, 0]\n'
    knob += '[effects.membranes.sheet]\nsurface = "right"\nstiffness = 10.0\npoisson = 0.3\n'
    knob += "[effects.cables.wire]\nstiffness = 1.0\npoints = [[0, 0, 0], [1, 0, 0]]"
    effects = parse(f"{ALL}\n{knob}\n[effects.large_deformation]").effects
    others = ("tendon_friction", "base_path", "viscoelasticity", "temperature", "driven_support")  # not with all
    assert effects.names == tuple(name for name in EFFECTS if name not in others)
    assert effects.large_deformation == LargeDeformation(material="st_venant_kirchhoff")
    assert effects.inertia == Inertia()
    assert effects.gravity == Gravity(acceleration=(0.0, 0.0, -9.81))
    contact = replace(effects.contact, obstacles={})
    assert contact == Contact(restitution=0.0, method="complementarity", switching="automatic", obstacles={})
    assert effects.damped.dashpots == {"oil": Dashpot(surface="right", coefficient=0.3)}
    assert effects.prescribed["poke"] == PrescribedForce(point=(1.0, 0.1, 0.1), force=(0.0, 1.0, 0.0))
    assert effects.prescribed["push"].signal(0.05).tolist() == [-0.075, 0.0, 0.0]
    only = Effects(gravity=Gravity(acceleration=(1.0, 0.0, 0.0)))
    assert parse("gravity = { acceleration = [1, 0, 0] }").effects == only


def test_what_a_model_has_built_in_is_told_whatever_the_order_of_the_keys():
    damping = "[effects.damping]\n{}\n[effects.damping.dashpots.oil]\n{}\n"
    one = damping.format("alpha = 1\nbeta = 2e-3", 'surface = "right"\ncoefficient = 3')
    other = damping.format("beta = 0.002\nalpha = 1.0", 'coefficient = 3.0\nsurface = "right"')
    texts = {parse(f"{INERTIA}{text}").environment.built_in["effects.damping"] for text in (one, other)}
    assert len(texts) == 1
    more = parse(f"{INERTIA}{one.replace('= 3', '= 4')}").environment.built_in["effects.damping"]
    assert more not in texts
    rough = parse(ALL).environment.built_in
    assert rough["effects.contact"] == rough["effects.friction"] == "{}"  # what a reduced run may have otherwise


def test_loads_have_columns_in_one_order():
    columns = {name: load.columns for name, load in parse(ALL).environment.loads.items()}
    assert columns == {"gravity": 1, "quake": 1, "push": 3, "poke": 3}
    assert parse(INERTIA).environment.loads == {}


@pytest.mark.parametrize(
    ("shape", "said", "made"),
    [
        ("half-space", "point = [1, 2, 3]\nnormal = [0, 0, 2]", HalfSpace((1, 2, 3), (0, 0, 2))),
        ("sphere", "center = [1, 2, 3]\nradius = 0.5", Sphere((1, 2, 3), 0.5)),
        ("capsule", "start = [1, 2, 3]\nend = [1, 2, 4]\nradius = 0.5", Capsule((1, 2, 3), (1, 2, 4), 0.5)),
        ("box", "center = [1, 2, 3]\nsize = [1, 1, 2]", Box((1, 2, 3), (1, 1, 2))),
        ("box", "center = [1, 2, 3]\nsize = [1, 1, 2]\nrotation = [0, 1, 0]", Box((1, 2, 3), (1, 1, 2), (0, 1, 0))),
    ],
)
def test_obstacles_are_what_the_scene_says(shape, said, made):
    scene = parse(f'{INERTIA}[effects.contact.obstacles.it]\nshape = "{shape}"\n{said}')
    around = ActiveEnvironment(scene.environment)
    assert around.obstacles == {"it": made}
    np.testing.assert_array_equal(around.state.offsets, [[0.0, 0.0, 0.0]])


def test_tables_are_histories():
    around = ActiveEnvironment(parse(ALL).environment)
    np.testing.assert_allclose(around.loads_at(0.05), [1.0, 0.5, -0.075, 0, 0, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(around.loads_at(7.0), [1.0, 1.0, -0.15, 0, 0, 0, 1, 0])  # the last value stays
    np.testing.assert_allclose(around.offsets_at(0.05), [[0, 0, 0], [-0.075, 0, 0]], atol=1e-15)
    assert around.environment.contact_law.friction == 0.25


# --- mistakes --------------------------------------------------------------------------------------------------------

QUAKE = 'table = "quake.csv"'
PUSH = "[effects.prescribed.push]\n"
SPHERE = '[effects.contact.obstacles.ball]\nshape = "sphere"\n'
MISTAKES = {
    "wind = {}": "effects: no key 'wind'; there is base_motion, base_path, cables, contact, damping",
    f"{INERTIA}friction = {{ coefficient = 0.5 }}": (
        "effects.friction: means nothing without contact; name effects.contact as well"
    ),
    "damping = { alpha = 1.0 }": "effects.damping: means nothing without inertia; name effects.inertia as well",
    "[effects.base_motion.quake]\ndirection = [1, 0, 0]": "effects.base_motion: means nothing without inertia",
    f"{FLOOR}[effects.friction]\ncoefficient = -0.5": "coefficient = -0.5: use a finite number >= 0",
    f"{FLOOR}[effects.friction]\n": "effects.friction: coefficient is missing",
    f"{FLOOR}[effects.friction]\ncoefficient = 0.5\nmu = 1": "effects.friction: no key 'mu'; there is coefficient",
    "gravity = { acceleration = [0, -9.81] }": "gravity.acceleration is a list of 2: use a list of 3",
    "gravity = { acceleration = [0, 0, inf] }": "gravity.acceleration[2] = inf: use a finite number, in m/s2",
    "gravity = {}": "effects.gravity: acceleration is missing",
    f"{INERTIA}damping = {{ materials.foam = {{ gamma = 1 }} }}": "foam: no key 'gamma'; there is alpha, beta",
    f"{INERTIA}damping = {{ materials.foam = {{ alpha = -1.0 }} }}": "foam.alpha = -1.0: use a finite number",
    f'{INERTIA}[effects.damping.dashpots.oil]\nsurface = "right"': "dashpots.oil: coefficient is missing",
    f'{INERTIA}[effects.damping.dashpots.oil]\nsurface = "right"\ncoefficient = 0': (
        "dashpots.oil.coefficient = 0: use a finite number > 0, in N s/m"
    ),
    f"{INERTIA}[effects.damping.dashpots.oil]\ncoefficient = 1": (
        "dashpots.oil: give exactly one of surface, near, plane, facing, box, along, inner, all, any, none (got none)"
    ),
    '[effects.springs.bed]\nsurface = "right"\nstiffness = -1': "bed.stiffness = -1: use a finite number",
    "[effects.springs.bed]\nstiffness = 1": "springs.bed: give exactly one of surface, near, plane, facing",
    f"{PUSH}force = [1, 0, 0]": "prescribed.push: give exactly one of surface, near, plane",
    f'{PUSH}surface = "right"\npoint = [1, 0, 0]': "none, point (got surface, point)",
    f'{PUSH}surface = "right"\nforce = [1, 0, 0]\ntable = "push.csv"': (
        "effects.prescribed.push: give force or table, not both"
    ),
    f'{PUSH}surface = "right"\nforce = [1, 0]': "push.force is a list of 2: use a list of 3",
    f'{PUSH}surface = "right"\ntable = "quake.csv"': "table quake.csv: use 3 columns beside the time (got 1)",
    f'{PUSH}surface = "right"\ntable = "none.csv"': "table none.csv: did not come with the scene",
    f'{INERTIA}[effects.base_motion.q]\ndirection = [1, 0, 0]\ntable = "push.csv"': (
        "table push.csv: use 1 column beside the time (got 3)"
    ),
    f"{INERTIA}[effects.base_motion.q]\ndirection = [1, 0, 0]\n{QUAKE}\n{PUSH}point = [0, 0, 0]\n{QUAKE}": (
        "table quake.csv: use 3 columns beside the time (got 1)"
    ),
    f'{INERTIA}[effects.base_motion.q]\ndirection = [1, 0, 0]\nacceleration = 1\ntable = "quake.csv"': (
        "effects.base_motion.q: give acceleration or table, not both"
    ),
    f'{INERTIA}[effects.point_masses.q]\nsurface = "right"\nmass = 1\ndirection = [0, 0, 0]': "q.direction: use",
    f'{INERTIA}[effects.rigid_parts.q]\nsurface = "right"\nmass = 1\ncenter = [0, 0, 0]\ninertia = [1, 3, 1.5]': (
        "q.inertia = [1.0, 3.0, 1.5]: no body has such moments; use the largest, 3, at most the sum"
    ),
    f'{INERTIA}[effects.rigid_parts.q]\nsurface = "right"\nmass = 1': "rigid_parts.q: center is missing",
    f"{INERTIA}[effects.base_motion.q]\ndirection = [0, 0, 0]": "base_motion.q.direction: use any direction but zero",
    "[effects.tendon.rope]\npoints = [[0, 0, 0]]": "rope.points is a list of 1: use a list of at least 2",
    "[effects.pressure.wind]": "effects.pressure.wind: give exactly one of surface, near",
    f'{PUSH}surface = "right"\n[effects.tendon.push]\npoints = [[0, 0, 0], [1, 0, 0]]': (
        "effects.tendon.push: the name is taken by effects.prescribed.push"
    ),
    '[effects.prescribed.gravity]\nsurface = "right"': "prescribed.gravity: the name is taken by effects.gravity",
    f"{INERTIA}contact = {{}}": "effects.contact.obstacles: at least one is needed, as [effects",
    f"{INERTIA}contact = {{ obstacles = {{}} }}": "effects.contact.obstacles: at least one is needed",
    f"[effects.contact]\nbounce = 1\n{FLOOR}": "effects.contact: no key 'bounce'; there is damping, method, obstacles",
    f'[effects.contact]\nmethod = "penalty"\n{FLOOR}': "effects.contact.stiffness is missing: the spring of method",
    '[effects.contact.obstacles.b]\nshape = "box"\ncenter = [0, 0, 9]\nsize = [1, 1, 1]\nrotation = [0, 45, 0]': (
        "obstacles.b.rotation[1] = 45: use a finite number >= -6.2832 and <= 6.2832, in rad, not degrees"
    ),
    f'[effects.contact]\nmethod = "penalti"\n{FLOOR}': "no choice 'penalti'; there is complementarity, penalty",
    f"[effects.contact]\nstiffness = 1.0\n{FLOOR}": "effects.contact.stiffness: goes with method = 'penalty'",
    f"[effects.contact]\ndamping = 1.0\n{FLOOR}": "effects.contact.damping: goes with method = 'penalty'",
    f'{INERTIA}[effects.contact]\nmethod = "penalty"\nstiffness = 1\nrestitution = 0.5\n{FLOOR}': (
        "effects.contact.restitution: goes with inertia and method = 'complementarity'"
    ),
    f"[effects.contact]\nrestitution = 0.5\n{FLOOR}": "effects.contact.restitution: goes with inertia and method",
    f"{INERTIA}[effects.contact]\nrestitution = 1.5\n{FLOOR}": "restitution = 1.5: use a finite number >= 0",
    f'[effects.contact]\nswitching = "manual"\n{FLOOR}': "no choice 'manual'; there is automatic, scene",
    f"{SPHERE}center = [0, 0, 0]": "effects.contact.obstacles.ball: radius is missing",
    f"{SPHERE}radius = 1.0": "effects.contact.obstacles.ball: center is missing",
    f"{SPHERE}center = [0, 0, 0]\nradius = -1.0": "ball.radius = -1.0: use a finite number > 0, in m",
    f"{SPHERE}center = [0, 0, 0]\nradius = 1\nnormal = [1, 0, 0]": "a sphere has center, radius, but no normal",
    f"{SPHERE}center = [0, 0, 0]\nradius = 1\ncolor = 1": "obstacles.ball: no key 'color'; there is center, end,",
    SPHERE.replace("sphere", "cone"): "no choice 'cone'; there is box, capsule, half-space, mesh, sphere",
    SPHERE.replace("sphere", "capsule") + "start = [0, 0, 0]\nend = [0, 0, 0]\nradius = 1": "or a sphere",
    SPHERE.replace("sphere", "half-space") + "point = [0, 0, 0]\nnormal = [0, 0, 0]": "normal: use a vector",
    SPHERE.replace("sphere", "box") + "center = [0, 0, 0]\nsize = [1, 0, 1]": "ball.size[1] = 0: use",
    f'{SPHERE}center = [0, 0, 0]\nradius = 1\ntable = "quake.csv"': "use 3 columns beside the time (got 1)",
}


@pytest.mark.parametrize(("effects", "said"), MISTAKES.items(), ids=range(len(MISTAKES)))
def test_mistake_is_told_with_what_is_allowed(effects, said):
    with pytest.raises(SceneError) as caught:
        parse(effects)
    message = str(caught.value)
    assert message.startswith("scene.toml: ")
    assert said in message
    assert "\n" not in message
    assert len(message) < 300


def test_name_of_an_actuator_is_taken():
    wind = '[effects.pressure.wind]\nsurface = "right"'
    with pytest.raises(SceneError, match=r"effects.pressure.wind: the name is taken by actuators.wind"):
        parse(wind, **{"actuators.wind": 'surface = "right"'})


def test_contact_mode_follows_obstacles_or_is_pushed(mesh):
    push = {"run": 'dt = 0.01\nduration = 0.1\nload = [{ contact = "right", force = [1.0, 0, 0] }]'}
    with pytest.raises(SceneError, match=r"switching = 'automatic'.*run.load can push with actuators only; .*'scene'"):
        parse(INERTIA + FLOOR, **push)
    scene = parse(f'{INERTIA}[effects.contact]\nswitching = "scene"\n{FLOOR}', mesh, **push)
    assert fr.simulate(scene).supplied[-1] > 0


BODILY = {
    "[effects.tendon.rope]\npoints = [[0, 0, 0], [2, 0, 0]]": "effects.tendon.rope.points: point [2.0, 0.0, 0.0] is",
    "[effects.tendon.rope]\npoints = [[0, 0, 0], [0, 0, 0], [1, 0, 0]]": (
        "effects.tendon.rope.points: two that follow one another are the same point"
    ),
    "[effects.tendon.rope]\npoints = [[0, 0, 0], [0, 0.4, 0]]": "effects.tendon.rope: acts on nothing that can move",
    f"{PUSH}point = [0.5, 0.2, 3.0]": "effects.prescribed.push: point [0.5, 0.2, 3.0] is",
    f"{PUSH}point = [0.0, 0.2, 0.1]": "effects.prescribed.push: acts on nothing that can move",
    f'{PUSH}surface = "rigth"': "no surface 'rigth'; there is",
    f'{PUSH}surface = "left"': "effects.prescribed.push: the whole patch is clamped",
    '[effects.pressure.wind]\nsurface = "non"': "no surface 'non'; there is",
    '[effects.springs.bed]\nsurface = "non"\nstiffness = 1.0': "no surface 'non'; there is",
    "[effects.springs.bed]\nnear = { point = [9, 9, 9], radius = 0.1 }\nstiffness = 1.0": "effects.springs.bed",
    f'{INERTIA}[effects.damping.dashpots.oil]\nsurface = "non"\ncoefficient = 1.0': "no surface 'non'; there is",
    "gravity = { acceleration = [0, 0, 0] }": "effects.gravity.acceleration is zero; leave gravity out instead",
    f"{INERTIA}damping = {{ materials.foam = {{ alpha = 1 }} }}": "materials: no material 'foam'; there is material",
}


@pytest.mark.parametrize(("effects", "said"), BODILY.items(), ids=range(len(BODILY)))
def test_what_the_body_does_not_have_is_told(mesh, effects, said):
    with pytest.raises((SceneError, MeshError)) as caught:
        fr.assemble(parse(effects, mesh))
    assert said in str(caught.value)


def test_load_without_a_history_is_told_on_the_command_line(mesh, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = scene_text(mesh, contacts=RIGHT, effects=f'{INERTIA}damping.beta = 1e-3\n{PUSH}surface = "right"', **RUN)
    Path("scene.toml").write_text(text)

    def say(*arguments):
        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        return end.value.code, *capfd.readouterr()

    assert say("reduce", "scene.toml", "-o", "rom.h5", "--order", "4")[0] == 0
    for command in (("simulate", "scene.toml"), ("simulate", "rom.h5")):
        status, _, err = say(*command, "-o", "run.h5")
        assert status == 1
        assert re.fullmatch(
            r"fenics-rom: error: .*'push' has neither a value nor a table; give a function of time in Python: [^\n]*\n",
            err,
        )
    assert not Path("run.h5").exists()


# --- files -----------------------------------------------------------------------------------------------------------


def same(one, other):
    """Whether two records, or ROMs, are the same to the last bit."""
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return one == other


def test_rom_with_all_effects_is_read_to_the_last_bit(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)
    back = fr.read_rom(tmp_path / "rom.h5")
    assert same(back, rom)
    assert back.loads == {"gravity": 1, "quake": 1, "push": 3, "poke": 3}
    assert back.actuators == {"wind": 1, "rope": 1}
    assert back.environment.effects["gravity"] == "acceleration (0, 0, -9.81) m/s2"
    assert back.environment.contact_law.friction == 0.25
    right = np.flatnonzero(np.isclose(back.nodes[:, 0], 1.0))
    np.testing.assert_array_equal(back.contact_models["right"].contact_points, right)
    assert back.environment.loads["push"].signal.times is not None


def test_run_among_obstacles_is_read_to_the_last_bit(rom, tmp_path):
    run = fr.simulate(rom, profile=True)
    fr.write_trajectory(tmp_path / "run.h5", run)
    back = fr.read_trajectory(tmp_path / "run.h5")
    assert same(back, run)
    others = {"base_path", "large_deformation", "tendon_friction", "point_masses", "rigid_parts", "viscoelasticity"}
    others |= {"driven_support", "membranes", "cables", "temperature"}
    assert set(back.effects) == set(EFFECTS) - others
    assert list(back.forces) == ["floor", "ball"]
    assert list(back.contact_account) == ["obstacles", "contact", "friction"]
    parts = ["contact, friction", "inertia, damping, elasticity"]
    parts = [", ".join(parts)] if compiled() else parts  # loops take both at once
    assert {"gravity", *parts} <= set(back.profile)
    assert all(seconds >= 0 for seconds in back.profile.values())
    assert back.balance_error <= 1e-12


def groups_of(file):
    content = file.read_bytes()
    with h5py.File(file, "r") as h5:
        found = []
        h5.visit(found.append)
    return set(found), len(content)


def test_what_is_not_named_takes_no_room(mesh, rom, tmp_path):
    plain = reduced(fr.assemble(parse("inertia = {}\ndamping = { alpha = 0.5, beta = 1e-3 }", mesh, **RUN)), order=12)
    with_order = {name: mode.order for name, mode in plain.contact_models.items()}
    assert with_order == {name: mode.order for name, mode in rom.contact_models.items()}
    sizes = {}
    for name, one in (("plain", plain), ("all", rom)):
        fr.write_rom(tmp_path / f"{name}.h5", one)
        fr.write_trajectory(tmp_path / f"{name}-run.h5", fr.simulate(one))
        sizes[name] = groups_of(tmp_path / f"{name}.h5"), groups_of(tmp_path / f"{name}-run.h5")
    (of_rom, rom_bytes), (of_run, run_bytes) = sizes["plain"]
    assert not {"loads", "environment/contact_law", "contact_models/right/contact_points"} & of_rom
    assert not {"forces", "contact_account", "profile"} & of_run
    (of_rom, all_bytes), (of_run, all_run_bytes) = sizes["all"]
    assert {"loads/gravity", "environment/contact_law", "contact_models/right/contact_points"} <= of_rom
    assert {"forces/floor", "contact_account/friction"} <= of_run
    assert rom_bytes < all_bytes
    assert run_bytes < all_run_bytes


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda rom: replace(rom, loads={"gravity": -1}), "an actuator or a load has a negative number of columns"),
        (lambda rom: replace(rom, loads={"gravity": 99}), "has fewer input columns than the actuators and loads"),
        (lambda rom: replace(rom, loads={"a/b": 1}), "name 'a/b': use letters"),
        (
            lambda rom: replace(
                rom, contact_models={"right": replace(rom.contact_models["right"], contact_points=np.array([99]))}
            ),
            "contact mode 'right': contact_points name nodes beyond 12",
        ),
        (
            lambda rom: replace(
                rom, contact_models={"right": replace(rom.contact_models["right"], contact_points=np.array([-1]))}
            ),
            "contact mode 'right': contact_points name nodes beyond 12",
        ),
        (
            lambda rom: replace(rom, environment=replace(rom.environment, run=Run(np.nan, 1.0))),
            "/environment/run/dt holds numbers that are not finite",
        ),
    ],
)
def test_rom_that_would_not_be_read_is_not_written(rom, tmp_path, spoil, message):
    with pytest.raises(FenicsRomError, match=re.escape(message)):
        fr.write_rom(tmp_path / "rom.h5", spoil(rom))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"forces": {"floor": np.ones((3, 3))}}, "/forces/floor has shape (3, 3)"),
        ({"forces": {"flo/or": np.ones((11, 3))}}, "name 'flo/or': use letters"),
        ({"contact_account": {"friction": np.ones(3)}}, "/contact_account/friction has shape (3,)"),
        ({"profile": {"gravity": np.inf}}, "holds numbers that are not finite"),
    ],
)
def test_run_that_would_not_be_read_is_not_written(rom, tmp_path, changes, message):
    run = fr.simulate(rom)
    with pytest.raises(FileError, match=re.escape(message)):
        fr.write_trajectory(tmp_path / "run.h5", replace(run, **changes))
    assert not any(tmp_path.iterdir())


def test_lower_order_keeps_loads_and_contact(rom):
    lower = fr.truncate(rom, 6)
    assert lower.loads == rom.loads
    np.testing.assert_array_equal(
        lower.contact_models["right"].contact_points, rom.contact_models["right"].contact_points
    )
    run = fr.simulate(lower)
    assert run.balance_error <= 1e-12
    assert list(run.forces) == ["floor", "ball"]


def test_scene_of_a_mesh_alone_stays_as_it_was(mesh):
    """One that names no more than inertia and damping has neither loads nor contact points."""
    system = fr.assemble(acted_on(mesh, "inertia = {}", contacts=RIGHT))
    assert (system.loads, system.units, system.contact_points) == ({}, {}, {})
    assert system.input_matrix("right").shape[1] == system.forces("right").shape[1] == 3
