"""What is kept of a run of a world: a trajectory of all its bodies."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics import obstacles
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.nodal_contact import NodalContact
from fenics_rom.mechanics.touch import TOUCH, TouchReading
from fenics_rom.trajectory.bodies import BodyTrack
from fenics_rom.trajectory.contact_snapshots import ContactSnapshots
from fenics_rom.trajectory.series import ReadingSeries
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.world.records import RigidBody
from fenics_rom.world.shapes import HalfSpace
from fenics_rom.world.world import World

TRACK = {"pose": (7,), "velocity": (6,), "energy": (), "supplied": (), "dissipated": (), "exchanged": ()}


class WorldRecorder:
    """Fills the arrays of a trajectory, step by step.

    Args:
        world: before its first step.
        steps: number of steps of the run.
        snapshots: how many shapes to keep, evenly spread, the last step among them.
        every: all else is kept after every so many steps, and at the end.

    Raises:
        SceneError: a name with a hyphen, which is to stand between the names of a pair.
    """

    def __init__(self, world: World, steps: int, *, snapshots: int = 100, every: int = 1):
        for name in world.names:
            if "-" in name:
                raise SceneError(f"body {name!r}: use a name without a hyphen in a run that is kept")
        self._world, self._every = world, every
        self._kept = np.union1d(np.arange(0, steps + 1, every), steps)
        self._snapshot_steps = np.unique(np.round(np.linspace(0, steps, min(snapshots, steps) + 1)).astype(int))[1:]
        self._rows = {step: row for row, step in enumerate(self._kept.tolist())}
        self._snapshot_rows = {step: row for row, step in enumerate(self._snapshot_steps.tolist())}
        self._due = np.union1d(self._kept, self._snapshot_steps)
        S = len(self._kept)
        self._account = np.zeros((8, S))  # energy, and the sums of the ledger
        self._tracks = {name: {key: np.zeros((S, *of)) for key, of in TRACK.items()} for name in world.names}
        self._forces: dict[str, Array] = {}
        self._surfaces = {name: _surface(world, name) for name in world.names}
        self._nodes = self._places()
        self._snapshots = np.zeros((len(self._snapshot_steps), *self._nodes.shape))
        self._touched = ContactSnapshots(len(self._snapshot_steps))
        self._senses = {name: _senses(world, name) for name in world.names}
        self._felt = {
            f"{body}-{name}": np.zeros((S, reading.size))
            for body, senses in self._senses.items()
            for name, reading in senses.items()
        }
        poses = {name: world.pose(name) for name, body in world.bodies.items() if _is_half_space(body)}
        planes = {name: (pose.position, rotation_matrix(pose.rotation)[:, 2]) for name, pose in poses.items()}
        self._grounds = {name: obstacles.HalfSpace(tuple(at), tuple(normal)) for name, (at, normal) in planes.items()}
        self._moved = {name: np.zeros((len(self._snapshot_steps), 3)) for name in poses}
        self.sample(0)

    def steps_to_sample(self, step: int) -> int:
        """In how many steps something is to be kept next; so many were taken, and the last one was not."""
        return int(self._due[self._due.searchsorted(step, "right")]) - step

    def sample(self, step: int) -> None:
        """Keeps what is to be kept after so many steps."""
        row = self._rows.get(step)
        if row is not None:
            self._sample_numbers(row)
        row = self._snapshot_rows.get(step)
        if row is not None:
            self._snapshots[row] = self._places() - self._nodes
            self._touched.sample(row, self._contact())
            for name, ground in self._grounds.items():
                self._moved[name][row] = self._world.pose(name).position - np.array(ground.point)

    def _sample_numbers(self, row: int) -> None:
        world = self._world
        self._account[:, row] = world.energy, *(total for total, _ in world.ledger.sums)
        for name, track in self._tracks.items():
            pose, account = world.pose(name), world.account(name)
            track["pose"][row] = *pose.position, *pose.rotation
            track["velocity"][row] = *pose.velocity, *pose.angular_velocity
            track["energy"][row] = world.energy_of(name)
            track["supplied"][row] = account.supplied - account.obstacles
            track["dissipated"][row], track["exchanged"][row] = account.dissipated, account.obstacles
        for body, senses in self._senses.items():
            for name in senses:
                self._felt[f"{body}-{name}"][row] = world.simulator(body).reading(name)
        for first, second in combinations(world.names, 2):
            force = world.force_between(first, second)
            if force.any():
                zeros = np.zeros((len(self._kept), 3))
                self._forces.setdefault(f"{first}-{second}", zeros)[row] = force

    def _places(self) -> Array:
        """Of the surfaces of all bodies now, (N, 3), m."""
        places = []
        for name, (vertices, _, _) in self._surfaces.items():
            if isinstance(self._world.bodies[name], RigidBody):
                pose = self._world.pose(name)
                places.append(pose.position + vertices @ rotation_matrix(pose.rotation).T)
            else:
                places.append(self._world.simulator(name).node_places())
        return np.concatenate(places)

    def _contact(self) -> NodalContact | None:
        """Of all soft bodies that can be touched, on the nodes of the run; None where there are none."""
        found, first = list[NodalContact](), 0
        for name, (vertices, _, _) in self._surfaces.items():
            if not isinstance(self._world.bodies[name], RigidBody):
                contact = self._world.simulator(name).nodal_contact
                found += [] if contact is None else [contact._replace(nodes=contact.nodes + first)]
            first += len(vertices)
        return NodalContact(*map(np.concatenate, zip(*found, strict=True))) if found else None

    def record(self, name: str, settings: Mapping[str, float] | None = None) -> Trajectory:
        """The finished run; settings: more than the step and the number of coordinates."""
        world, tracks, triangles, end = self._world, dict[str, BodyTrack](), list[Array](), 0
        readings, faces = dict[str, ReadingSeries](), 0
        for body, (vertices, of, _) in self._surfaces.items():
            for sense, reading in self._senses[body].items():
                taxels = reading.map._replace(triangles=reading.map.triangles + faces)
                readings[f"{body}-{sense}"] = ReadingSeries(TOUCH, self._felt[f"{body}-{sense}"], taxels=taxels)
            faces += len(of)
            triangles.append(of + end)
            rows = np.array([end, end := end + len(vertices)])
            kind = "rigid" if isinstance(world.bodies[body], RigidBody) else "soft"
            tracks[body] = BodyTrack(rows=rows, kind=kind, **self._tracks[body])
        own = {"every": self._every} if self._every > 1 else {}
        energy, supplied, dissipated, lost, numerical, *of_contact = self._account
        return Trajectory(
            name=name,
            model="reduced",
            settings={"dt": world.dt, "order": float(_coordinates(world)), **own, **(settings or {})},
            times=world.dt * self._kept,
            contacts=("world",),
            contact=np.zeros(len(self._kept), dtype=np.int64),
            outputs={},
            energy=energy,
            supplied=supplied,
            dissipated=dissipated,
            lost_in_switching=lost,
            numerical=numerical,
            snapshot_times=world.dt * self._snapshot_steps,
            snapshots=self._snapshots,
            nodes=self._nodes,
            triangles=np.concatenate(triangles),
            node_mass=np.concatenate([mass for _, _, mass in self._surfaces.values()]),
            warnings=world.warnings,
            effects=("contact", "friction"),
            forces=self._forces,
            contact_account=dict(zip(("obstacles", "contact", "friction"), of_contact, strict=True)),
            obstacles=self._grounds,
            obstacle_motion=self._moved,
            bodies=tracks,
            readings=readings,
            touched=self._touched.kept,
        )


def _surface(world: World, name: str) -> tuple[Array, Array, Array]:
    """Nodes of a body in its axes, triangles, and the mass of each node."""
    body = world.bodies[name]
    if not isinstance(body, RigidBody):
        rom = world.simulator(name).rom
        return rom.nodes, rom.triangles, rom.node_mass
    if _is_half_space(body):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros(0)
    vertices, triangles = body.surface()
    mass = 0.0 if body.is_driven else body.mass_and_inertia()[0]
    return vertices, triangles, np.full(len(vertices), mass / max(len(vertices), 1))


def _senses(world: World, name: str) -> dict[str, TouchReading]:
    """Senses of touch of a body, by name."""
    if isinstance(world.bodies[name], RigidBody):
        return {}
    readings = world.simulator(name).rom.readings
    return {own: reading for own, reading in readings.items() if isinstance(reading, TouchReading)}


def _is_half_space(body: object) -> bool:
    return isinstance(body, RigidBody) and isinstance(body.shape, HalfSpace)


def _coordinates(world: World) -> int:
    """Number of coordinates of all bodies that move freely."""
    soft = [world.simulator(name) for name, body in world.bodies.items() if not isinstance(body, RigidBody)]
    rigid = [body for body in world.bodies.values() if isinstance(body, RigidBody) and not body.is_driven]
    return 6 * len(rigid) + sum(body.rom.contact_models[body.contact].order for body in soft)
