"""The page of a live body."""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.trajectory.elastic_part import elastic_part
from fenics_rom.trajectory.file import write_trajectory
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.contact_surface import divide_contact_triangles
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.drawing import DrawnBody, PickSurface, set_camera_and_light
from fenics_rom.visualization.viewer.live_body import LiveBody, free_name
from fenics_rom.visualization.viewer.live_loop import LiveLoop
from fenics_rom.visualization.viewer.mouse_spring import closest_point
from fenics_rom.visualization.viewer.surface import (
    CONTACT_PRESSURE,
    OFF_SURFACE,
    READING,
    UNITS,
    Surface,
    reading_fields,
    reading_words,
    surface_fields,
)

if TYPE_CHECKING:
    from fenics_rom.runtime.error_watch import StatedError


def error_words(stated: "Mapping[str, StatedError]") -> list[str]:
    """What a body states of its error, a line for each kind: in the energy norm, and the largest of each output.

    Of a sense of touch that of its force.
    """
    lines = []
    for kind, of in stated.items():
        parts = [] if of.norm is None else [f"{of.norm:.2g} J^½"]
        parts += [f"{name} {with_unit(float(np.abs(of.output(name)).max()), 'm')}" for name in of.names]
        felt = [name for name, reading in of.sensed.items() if reading.quantity == TOUCH]
        parts += [f"{name} {with_unit(float(np.linalg.norm(of.touch(name).force)), 'N')}" for name in felt]
        lines.append(f"error, {kind}: {' · '.join(parts)}")
    return lines


class LivePage(LiveLoop):
    """Shows a live body on a viser server.

    Recordings are written into a folder, by names that begin with a stem; `notify` is told of them, for the terminal.
    """

    def __init__(self, viser: Any, server: Any, body: LiveBody, folder: Path, stem: str, notify: Callable[[str], None]):
        rom = body.rom
        self._surface = Surface(rom.nodes, rom.triangles)
        super().__init__(server, body, 1 / float(np.ptp(self._surface.places, axis=0).max()))
        self.body, self._folder, self._stem, self._notify = body, folder, stem, notify
        self._writing: list[threading.Thread] = []
        self._fields = surface_fields(self._surface, rom.environment)
        self._readings = reading_fields(self._surface, {name: body.reading(name) for name in rom.readings})
        self._triangles = divide_contact_triangles(rom)
        set_camera_and_light(server, self.scale * self._surface.places)
        around = body.simulator.environment
        obstacles = around.obstacles if around else {}
        tendons = rom.environment.tendons
        self._picture = DrawnBody(
            server.scene, "/body", rom.nodes, self._surface, tendons, obstacles, self.next_picture, self.scale
        )
        self._pick_surfaces = {
            name: self._add_pick_surface(name, triangles)
            for name, triangles in self._triangles.items()
            if len(triangles)
        }
        touched = [] if body.simulator.nodal_contact is None else [CONTACT_PRESSURE]
        fields = (*self._fields, *touched, *self._readings)
        self._add_widgets(viser, server.gui, rom.name, {"record": self._toggle_record}, fields)
        if body.largest_order is not None and body.largest_order > 1:
            hint = "displacements of each contact mode; another order begins anew"
            with self._settings:
                self._slider(server.gui, "order", 1, body.largest_order, 1, body.order, self._set_order, hint)

    def _add_pick_surface(self, contact: str, triangles: Array) -> PickSurface:
        pick_surface = PickSurface(self._server.scene, f"/contact/{contact}", self._surface, triangles, self.scale)

        @pick_surface.mesh.on_click
        async def _(_: Any) -> None:
            self._todo.put(lambda: self.body.simulator.switch(contact))

        self.let_drag(pick_surface.mesh, partial(self._take_hold, contact))
        return pick_surface

    def _take_hold(self, contact: str, place: Array) -> bool:
        """Of the point of a contact surface that is nearest to a place."""
        triangles = self._pick_surfaces[contact].triangles
        nearest, weights = closest_point(self._moved()[triangles], place)
        return self.body.grab(contact, self._surface.nodes[triangles[nearest]], weights)

    def _reset(self) -> None:
        self._end_recording()
        super()._reset()

    def _set_dt(self, milliseconds: float) -> None:
        self._end_recording()
        super()._set_dt(milliseconds)

    def _set_order(self, order: float) -> None:
        if order != self.body.order:
            self._end_recording()
            self.body.order = int(order)
            self._begin()

    def _toggle_record(self) -> None:
        if self.body.records:
            self._end_recording()
        else:
            self.body.record()

    def _end_recording(self) -> None:
        """Makes the run and writes it, beside the live body."""
        if not self.body.records:
            return
        make = self.body.finish()
        if make is None:
            return
        file = free_name(self._folder, self._stem)
        file.touch()  # the name is taken
        writer = threading.Thread(target=self._write, args=(make, file))
        self._writing.append(writer)
        writer.start()

    def _write(self, make: Callable[[], Trajectory], file: Path) -> None:
        try:
            write_trajectory(file, make())
            message = f"recorded: {file}"
        except (FenicsRomError, OSError) as error:
            file.unlink(missing_ok=True)
            message = f"not recorded: {error}"
        self._notify(message)
        for client in self._server.get_clients().values():
            client.add_notification("Recording", message, with_close_button=True)

    def _end(self) -> None:
        """What was being recorded is written, too."""
        super()._end()
        self._end_recording()
        for writer in self._writing:
            writer.join()

    def _moved(self) -> Array:
        return self._surface.places + self.body.simulator.displacement()[self._surface.nodes]

    def _straining(self, whole: Array) -> Array:
        """What colours show of the displacement of all nodes: of a moving frame what strains the body."""
        rom = self.body.rom
        strained = elastic_part(whole, rom.nodes, rom.node_mass) if rom.environment.is_moving else whole
        return strained[self._surface.nodes]

    def _shapes(self) -> Mapping[str, Array]:
        """The displacement of all nodes, (N, 3), m, and of all obstacles."""
        simulator = self.body.simulator
        around = simulator.environment
        obstacles = zip(around.obstacles, around.state.offsets.copy(), strict=True) if around else ()
        return {"": simulator.displacement(), **dict(obstacles)}

    def _draw(self, shapes: Mapping[str, Array]) -> None:
        simulator, name, whole = self.body.simulator, self._field.value, shapes[""]
        displacement = whole[self._surface.nodes]
        velocity = simulator.velocity()[self._surface.nodes] if name == "speed" else displacement
        moved, traction = self._surface.places + displacement, None
        if name == CONTACT_PRESSURE:
            traction, unit = simulator.contact_traction(), UNITS[name]
            pressure = simulator.contact_pressure()[self._surface.nodes]
            values = self._surface.of_nodes(pressure, simulator.contact_surface.touchable)
        elif name in self._readings:
            field = self._readings[name]
            values, unit = field(self.body.reading(name.removeprefix(READING)).on_surface[0]), field.unit
        else:
            values, unit = self._fields[name](self._straining(whole), velocity), UNITS[name]
        largest = self._colours.cover(float(values.max()), unit)
        spring = self.body.spring
        held = self._triangles[spring.contact] if spring and self._holder is not None else None
        if not self._picture.draw(whole, values, largest, shapes, held, traction):
            return
        for pick_surface in self._pick_surfaces.values():
            self.next_picture.add(partial(pick_surface.draw, moved))

    def _words(self) -> list[str]:
        body = self.body
        ratio, frequency = body.damping_ratio
        lines = [
            f"contact mode: **{body.simulator.contact}** · order {body.order}",
            f"damping: {100 * ratio:.2g} % of critical at {frequency:.3g} Hz",
        ]
        lines += error_words(body.simulator.stated_errors)
        if exceeded := body.simulator.exceeded:
            lines.append(f"**beyond its error tolerance** since {exceeded.time:.3g} s")
        told = (*OFF_SURFACE, TOUCH)
        numbers = [name for name, reading in body.rom.readings.items() if reading.quantity in told]
        lines += reading_words({name: body.reading(name) for name in numbers}, 0)
        units = body.rom.environment.force_units
        return lines + [
            f"{name}: {with_unit(force, units.get(name, 'N'))}" for name, force in body.simulator.reactions.items()
        ]

    def _states(self) -> list[str]:
        return super()._states() + ["recording"] * self.body.records
