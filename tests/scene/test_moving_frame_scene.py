"""What a scene says of a body that turns as far as it likes: free, or carried by a base along a path."""

from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from bodies import scene_text

import fenics_rom as fr
from fenics_rom.errors import FileError, SceneError, StepError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.rom.environment_file import put_environment, take_environment
from fenics_rom.scene.file import parse_scene

RUN = "dt = 0.01\nduration = 0.5"
HEADING = "time (ms), position.x (mm), position.y (mm), position.z (mm), rotation.w, rotation.x, rotation.y, rotation.z"
TWISTS = ", velocity.x, velocity.y, velocity.z" + "".join(f", angular_velocity.{k} (rad/s)" for k in "xyz")
POSES = np.array([[0.0, 0, 0, 0, 1, 0, 0, 0], [0.5, 0, 0, 1.0, 0.8, 0, 0.6, 0]])
CARRIED = 'inertia = {}\nbase_path = { table = "path.csv" }'
FREE = {"supports": None, "run": RUN}


def parse(effects="inertia = {}", head='frame = "moving"', tables=None, **parts):
    text = f"{head}\n{scene_text(Path('none.msh'), effects=effects, **({'run': RUN} | parts))}"
    return parse_scene(text, tables={"path.csv": POSES} if tables is None else tables, source="scene.toml")


def test_frame_is_fixed_where_nothing_is_said():
    scene = parse(head="")
    assert (scene.frame, scene.environment.is_moving, scene.run.detail) == ("fixed", False, "full")
    assert scene.environment.is_plain
    moving = parse(run=f'{RUN}\ndetail = "quasi-rigid"')
    assert (moving.frame, moving.environment.is_moving, moving.run.detail) == ("moving", True, "quasi-rigid")
    assert not moving.environment.is_plain


def test_base_follows_its_table_and_what_python_gives():
    carried = parse(CARRIED).environment
    base = ActiveEnvironment(carried)
    np.testing.assert_allclose(base.base_at(0.25).position, [0, 0, 0.5], atol=1e-15)
    assert base.base_at(0.25).velocity[2] == pytest.approx(1.5 / 0.5)  # of a cubic from rest to rest
    still = base.base_at(0.0)
    base.set_signal("base_path", lambda time: still._replace(position=np.full(3, time)))
    assert base.base_at(2.0).position.tolist() == [2.0, 2.0, 2.0]
    other = ActiveEnvironment(carried, signals={"base_path": still})
    assert other.base_at(9.0).position.tolist() == [0.0, 0.0, 0.0]
    assert ActiveEnvironment(parse().environment).base_at(0.0) is None
    with pytest.raises(StepError, match=r"base_path at 1 s = 3.0: use a BaseState"):
        ActiveEnvironment(carried, signals={"base_path": lambda time: 3.0}).base_at(1.0)
    with pytest.raises(SceneError, match="no load or obstacle 'base_path'"):
        ActiveEnvironment(parse(head="").environment, signals={"base_path": still})


def test_tables_of_poses_are_read_in_their_units(tmp_path):
    rows = {"poses": (HEADING, ""), "twists": (HEADING + TWISTS, ", 0, 0, 0.002, 0, 0.1, 0")}
    for name, (heading, twists) in rows.items():
        lines = [f"{t}, 0, 0, {t / 500}, {np.cos(t / 2e4)}, 0, {np.sin(t / 2e4)}, 0{twists}" for t in (0, 250, 500)]
        (tmp_path / f"{name}.csv").write_text("\n".join([heading, *lines]))
        text = 'frame = "moving"\n' + scene_text(tmp_path, effects=CARRIED.replace("path.csv", f"{name}.csv"))
        path = parse_scene(text, folder=tmp_path).environment.base_path
        assert path.times.tolist() == [0.0, 0.25, 0.5]
        assert path.positions[-1].tolist() == [0.0, 0.0, 1e-3]  # 1 mm
        assert (path.velocities is None) == (name == "poses")
        np.testing.assert_allclose(path(0.25).angular_velocity[1], 0.1 if twists else 0.15, rtol=1e-3)
    bad = tmp_path / "bad.csv"
    for heading, said in (
        (HEADING.replace(", rotation.z", ""), r"'rotation.y': is the last; rotation.z \(1\) is missing"),
        (HEADING.replace("rotation.w", "w"), r"'w': use here rotation.w \(1\)"),
        (HEADING.replace("(mm)", "(inch)", 1), r"unit 'inch'; use"),
    ):
        bad.write_text(f"{heading}\n" + ", ".join("0" * len(heading.split(","))))
        with pytest.raises(SceneError, match=rf"table .*bad.csv, line 1, column .*{said}"):
            parse_scene(
                'frame = "moving"\n' + scene_text(tmp_path, effects=CARRIED.replace("path.csv", "bad.csv")),
                folder=tmp_path,
            )


TRAINING = "[effects.large_deformation.training]\naccelerations = [1.0, 0.0, 0.0]"
ROPE = "[effects.tendon.rope]\npoints = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.05], [1.0, 0.0, 0.0]]"
FAST = np.hstack([POSES, [[0, 0, 2, 0, 2.574, 0], [0, 0, 2, 0, 2.574, 0]]])
MISTAKES = {
    "effects.base_path: carries a body whose frame moves; use it with frame = 'moving'": {
        "effects": CARRIED,
        "head": "",
    },
    "effects.base_path: carries what is clamped, and nothing is": {"effects": CARRIED, **FREE},
    "effects.point_masses.hung.direction: a weight on a thread pulls along it alone only while": {
        "effects": 'inertia = {}\n[effects.point_masses.hung]\nsurface = "right"\nmass = 1.0\ndirection = [0, 0, 1]'
    },
    "effects.base_motion: shakes what is clamped, and nothing is; name supports, or leave it out": {
        "effects": "inertia = {}\n[effects.base_motion.quake]\ndirection = [1, 0, 0]",
        **FREE,
    },
    "frame = 'moving': a body without inertia that nothing holds has no equilibrium; name effects.inertia, or": {
        "effects": "gravity = { acceleration = [0, 0, -9.81] }",
        **FREE,
    },
    "effects.large_deformation.training: is of a frame that moves; use it with frame = 'moving'": {
        "effects": f"inertia = {{}}\n{TRAINING}",
        "head": "",
    },
    "effects.large_deformation.training.accelerations: are those of a base, and nothing is clamped; use spins": {
        "effects": f"inertia = {{}}\n{TRAINING}",
        **FREE,
    },
    "effects.large_deformation.training: means nothing without inertia": {"effects": TRAINING},
    "run.initial.rotation[1] = -100: use a finite number >= -6.2832 and <= 6.2832, in rad, not degrees": {
        **FREE,
        "run": f"{RUN}\ninitial = {{ rotation = [0, -100, 0] }}",
    },
    "frame: no choice 'turning'; there is fixed, moving": {"head": 'frame = "turning"'},
    "run.detail = 'quasi-rigid': use 'full', or any with": {"head": "", "run": f'{RUN}\ndetail = "quasi-rigid"'},
    "run.initial.rotation[1] = -2: use at most 0.1 rad, or any with frame = 'moving'": {
        "head": "",
        **FREE,
        "run": f"{RUN}\ninitial = {{ rotation = [0, -2, 0] }}",
    },
    "table path.csv: use finite numbers and strictly increasing": {
        "effects": CARRIED,
        "tables": {"path.csv": POSES[::-1]},
    },
    "table path.csv: use 13 columns beside the time (got 8)": {"effects": CARRIED, "tables": {"path.csv": FAST[:, :9]}},
    "base_path.table: the rotation at 0 s has length 2: use": {
        "effects": CARRIED,
        "tables": {"path.csv": POSES * [1, 1, 1, 1, 2, 1, 1, 1]},
    },
    "base_path.table: velocity and position do not fit each other": {
        "effects": CARRIED,
        "tables": {"path.csv": FAST * ([1] * 10 + [2] + [1] * 3)},
    },
    "base_path.table: the base jumps at 0.5 s": {
        "effects": CARRIED,
        "tables": {"path.csv": FAST},
        "run": RUN.replace("0.5", "0.6"),
    },
}


@pytest.mark.parametrize(("said", "given"), MISTAKES.items(), ids=range(len(MISTAKES)))
def test_what_a_moving_frame_cannot_have_is_told(said, given):
    with pytest.raises(SceneError) as caught:
        parse(**given)
    assert str(caught.value).startswith("scene.toml: ")
    assert said in str(caught.value)


TAKEN = {
    "large deformation": f"inertia = {{}}\n{TRAINING}",
    "relaxing": "inertia = {}\n[effects.viscoelasticity]\nratios = [0.5]\ntimes = [1.0]",
    "rubbing": f"inertia = {{}}\ntendon_friction = {{ coefficient = 0.3 }}\n{ROPE}",
    "pulled by length": f'inertia = {{}}\n{ROPE}\ncontrol = "length"',
    "filled by volume": 'inertia = {}\n[effects.pressure.air]\nsurface = "right"\ncontrol = "volume"',
    "shaken": "inertia = {}\n[effects.base_motion.quake]\ndirection = [0, 2, 0]\nacceleration = 1.0",
    "at rest": 'gravity = { acceleration = [0, 0, -9.81] }\nbase_path = { table = "path.csv" }',
}


@pytest.mark.parametrize("effects", TAKEN.values(), ids=TAKEN)
def test_what_a_base_can_carry_is_taken(effects):
    assert parse(effects).environment.is_moving


def test_a_base_that_is_shaken_pulls_all_mass_the_other_way():
    """Per unit of its load, as gravity does; both are what a moving frame turns into its axes."""
    acting = parse(TAKEN["shaken"] + "\n[effects.gravity]\nacceleration = [0, 0, -9.81]").environment
    fields = {name: field.tolist() for name, field in acting.uniform_fields.items()}
    assert fields == {"gravity": [0.0, 0.0, -9.81], "quake": [0.0, -1.0, 0.0]}


def test_moving_frame_is_kept_in_files_as_data(tmp_path):
    free = parse(**FREE | {"run": f"{RUN}\ninitial = {{ rotation = [0, -2, 0], spin = [1, 2, 3] }}"})
    assert free.run.initial.rotation == (0.0, -2.0, 0.0)
    twisted = FAST * [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0]
    twisted[:, 3:8] = [0, 1, 0, 0, 0]
    both = {"path.csv": POSES}, {"path.csv": twisted}
    for scene in (free, *(parse(CARRIED, tables=t, run=f'{RUN}\ndetail = "quasi-rigid"') for t in both)):
        with h5py.File(tmp_path / "file.h5", "w") as h5:
            put_environment(h5, scene.environment)
            again = take_environment(h5)
            assert replace(again, base_path=None) == replace(scene.environment, base_path=None)
            if scene.environment.base_path is not None:
                path = scene.environment.base_path
                for key, array in {entry.name: getattr(path, entry.name) for entry in fields(path)}.items():
                    np.testing.assert_array_equal(getattr(again.base_path, key), array, err_msg=key)
                h5["environment/base_path/rotations"][:] *= 2
                with pytest.raises(FileError, match="/environment/base_path: the rotation at 0 s has length 2"):
                    take_environment(h5)


def test_rom_of_another_frame_is_refused(box_system):
    rom = fr.reduce(box_system, order=4)
    moving = replace(rom.environment, frame="moving", source="scene.toml")
    with pytest.raises(SceneError, match=r"frame = 'moving', and ROM .* was made with 'fixed'; to have it, make a ROM"):
        fr.Simulator(rom, dt=1e-3, scene=moving)
