"""The page of a live world."""

from collections.abc import Mapping
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics import obstacles
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.rom.rom import Rom
from fenics_rom.trajectory.elastic_part import elastic_part
from fenics_rom.trajectory.series import ReadingSeries, reading_series
from fenics_rom.visualization.contact_surface import divide_contact_triangles
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.viewer.coloured_body import hide_what_is_behind
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.drawing import (
    FLOOR_SIZES,
    OBSTACLE_COLOUR,
    Covers,
    DrawnBody,
    PickSurface,
    set_camera_and_light,
)
from fenics_rom.visualization.viewer.live_loop import LiveLoop
from fenics_rom.visualization.viewer.live_world import LiveWorld
from fenics_rom.visualization.viewer.mouse_spring import closest_point
from fenics_rom.visualization.viewer.surface import (
    CONTACT_PRESSURE,
    READING,
    UNITS,
    Surface,
    reading_fields,
    reading_words,
    surface_fields,
)
from fenics_rom.world.records import RigidBody
from fenics_rom.world.shapes import HalfSpace
from fenics_rom.world.world import World

FREE_COLOUR = (230, 159, 0)  # of rigid bodies that move freely
ROOM = 1.5  # that the camera sees, of the bodies: they move
MOST_FORCES = 6  # between bodies that are told, the largest


class WorldPage(LiveLoop):
    """Shows a live world on a viser server.

    Raises:
        SceneError: a soft body has no surface.
    """

    def __init__(self, viser: Any, server: Any, live: LiveWorld, name: str):
        places = _all_places(live.world)
        super().__init__(server, live, 1 / float(np.ptp(places, axis=0).max()))
        self.live = live
        self._soft = {name: _SoftBody(self, server.scene, name, rom) for name, rom in live.roms.items()}
        self._rigid = {
            name: self._add_rigid(server.scene, name, body)
            for name, body in live.world.bodies.items()
            if isinstance(body, RigidBody)
        }
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        set_camera_and_light(server, self.scale * (middle + ROOM * (places - middle)))
        self._covers = Covers(self._rigid.values())
        are_touched = any(body.is_touched for body in self._soft.values())
        readings = {what: of.unit for body in self._soft.values() for what, (_, of) in body.readings.items()}
        self._units = {**UNITS, **readings}
        fields = [*list(UNITS)[:3], *([CONTACT_PRESSURE] if are_touched else []), *readings] if self._soft else []
        self._add_widgets(viser, server.gui, name, {}, fields)

    def _add_rigid(self, scene: Any, name: str, body: RigidBody) -> Any:
        """Its mesh, in axes of its own."""
        options: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False, "flat_shading": True}
        if isinstance(body.shape, HalfSpace):
            options |= {"opacity": 0.6, "side": "double"}
            flat = obstacles.HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
            vertices, triangles = obstacle_mesh(flat, np.zeros(3), FLOOR_SIZES / self.scale / 2)
        else:
            vertices, triangles = body.surface()
        colour = OBSTACLE_COLOUR if body.is_driven else FREE_COLOUR
        mesh = scene.add_mesh_simple(f"/{name}", self.scale * vertices, triangles, color=colour, **options)
        if not body.is_driven:
            self.let_drag(mesh, partial(self.live.grab_rigid, name))
        else:
            hide_what_is_behind(mesh)
        return mesh

    def _shapes(self) -> Mapping[str, Array]:
        """Displacements of all nodes of soft bodies from where their ROMs have them, (N, 3), m; poses of rigid ones."""
        poses = {name: self.live.world.pose(name) for name in self._rigid}
        rigid = {name: np.concatenate([pose.position, pose.rotation]) for name, pose in poses.items()}
        return rigid | {name: body.whole() for name, body in self._soft.items()}

    def _draw(self, shapes: Mapping[str, Array]) -> None:
        for name, mesh in self._rigid.items():
            position, rotation = shapes[name][:3], shapes[name][3:]
            self.next_picture.place(mesh, self.scale * position, rotation / np.linalg.norm(rotation))
        if not self._soft:
            return
        what = self._field.value
        self._covers.see_through(what == CONTACT_PRESSURE or what.startswith(READING))
        fields = {name: body.field(what) for name, body in self._soft.items()}
        largest = self._colours.cover(max(float(values.max()) for values in fields.values()), self._units[what])
        for name, body in self._soft.items():
            body.draw(shapes[name], fields[name], largest, with_traction=what == CONTACT_PRESSURE)

    def _words(self) -> list[str]:
        world = self.live.world
        sizes = {pair: float(np.linalg.norm(world.force_between(*pair))) for pair in combinations(world.names, 2)}
        most = sorted((pair for pair in sizes if sizes[pair]), key=lambda pair: -sizes[pair])[:MOST_FORCES]
        held = [f"held: **{self.live.held}**"] if self.live.held else []
        return [
            f"{world.touching} points push",
            *(f"{first} - {second}: {with_unit(sizes[first, second], 'N')}" for first, second in most),
            *(text for name in self._soft for text in self._felt(name)),
            *held,
        ]

    def _felt(self, name: str) -> list[str]:
        """What a body feels, in words."""
        senses = [own for own, of in self.live.roms[name].readings.items() if of.quantity == TOUCH]
        return reading_words({f"{name} - {own}": self._soft[name].reading(own) for own in senses}, 0)


class _SoftBody:
    """A soft body on the page, whose surface is moved in the world.

    Attributes:
        readings: names and fields of those that are on the surface, by what they are called among the fields: with
            their unit, so that those of several bodies that are called the same are shown at once.
    """

    def __init__(self, page: WorldPage, scene: Any, name: str, rom: Rom):
        if not len(rom.triangles):
            raise SceneError(f"body {name!r}: ROM {rom.name!r} has no surface triangles, so there is nothing to draw")
        self._live, self._name, self._rom = page.live, name, rom
        self._surface = Surface(rom.nodes, rom.triangles)
        self._fields = surface_fields(self._surface, None)
        fields = reading_fields(self._surface, {own: self.reading(own) for own in rom.readings})
        self.readings = {
            f"{what} ({field.unit})": (what.removeprefix(READING), field) for what, field in fields.items()
        }
        self._next_picture, scale = page.next_picture, page.scale
        not_seen_through: dict[str, Array] = {}
        self._picture = DrawnBody(
            scene, f"/{name}", rom.nodes, self._surface, not_seen_through, {}, page.next_picture, scale
        )
        self._triangles = divide_contact_triangles(rom)
        self.is_touched = self._live.world.simulator(name).nodal_contact is not None
        self._pick_surfaces = {}
        for contact, triangles in self._triangles.items():
            if len(triangles):
                pick = PickSurface(scene, f"/contact/{name}/{contact}", self._surface, triangles, scale)
                self._pick_surfaces[contact] = pick
                page.let_drag(pick.mesh, partial(self._take_hold, contact))

    def whole(self) -> Array:
        """The displacement of all nodes from where the ROM has them, (N, 3), m."""
        return self._live.world.simulator(self._name).node_places() - self._rom.nodes

    def reading(self, name: str) -> ReadingSeries:
        """One of its own, as it is now."""
        return reading_series(self._rom.readings[name], self._live.world.simulator(self._name).reading(name)[None])

    def _take_hold(self, contact: str, place: Array) -> bool:
        """Of the point of a contact surface that is nearest to a place."""
        nodes, triangles = self._surface.nodes, self._pick_surfaces[contact].triangles
        moved = self._surface.places + self.whole()[nodes]
        nearest, weights = closest_point(moved[triangles], place)
        return self._live.grab_soft(self._name, contact, nodes[triangles[nearest]], weights)

    def field(self, what: str) -> Array:
        """What colours show, at all vertices: of what strains it, and not of where it is."""
        if what.startswith(READING):
            if what not in self.readings:
                return np.zeros(len(self._surface.node_of))
            name, field = self.readings[what]
            return field(self.reading(name).on_surface[0])
        if what == CONTACT_PRESSURE:
            simulator = self._live.world.simulator(self._name)
            if not self.is_touched:
                return np.zeros(len(self._surface.node_of))
            pressure = simulator.contact_pressure()[self._surface.nodes]
            return self._surface.of_nodes(pressure, simulator.contact_surface.touchable)
        body, on = self._live.world.simulator(self._name), self._surface.nodes
        strained = body.displacement()
        if self._rom.environment.is_moving:
            strained = elastic_part(strained, self._rom.nodes, self._rom.node_mass)
        return self._fields[what](strained[on], body.velocity()[on] if what == "speed" else strained[on])

    def draw(self, whole: Array, values: Array, largest: float, *, with_traction: bool) -> None:
        """Draws it as displaced, (N, 3), m, in these colours."""
        traction = None
        if with_traction and self.is_touched:
            traction = self._live.world.simulator(self._name).contact_traction()
        contact = self._live.contact if self._live.held == self._name else None
        highlighted = None if contact is None else self._triangles[contact]
        if not self._picture.draw(whole, values, largest, {}, highlighted, traction):
            return
        for pick in self._pick_surfaces.values():
            self._next_picture.add(partial(pick.draw, self._surface.places + whole[self._surface.nodes]))


def _all_places(world: World) -> Array:
    """Of all bodies but half-spaces, (any, 3), m."""
    places = []
    for name, body in world.bodies.items():
        if not isinstance(body, RigidBody):
            places.append(world.simulator(name).node_places())
        elif not isinstance(body.shape, HalfSpace):
            pose = world.pose(name)
            places.append(pose.position + body.surface()[0] @ rotation_matrix(pose.rotation).T)
    if not places:
        raise SceneError("world: it has half-spaces alone, so there is nothing to draw")
    return np.concatenate(places)
