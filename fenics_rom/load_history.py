"""What acts when: the contact mode and the input of every step of a run, the same for full and reduced models."""

from collections.abc import Iterator, Mapping

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.scene import Load, Scene


class LoadHistory:
    """The inputs of a scene's run, sampled at the middle of each step (as the midpoint rule wants them).

    Args:
        scene: a scene with a run.
        contact_columns: number of contact columns of each contact mode.
        actuator_columns: number of columns of each actuator, in the order of the input.
        dt: time step instead of the scene's, s.

    Raises:
        SceneError: no run in the scene, or a force that does not fit the columns.
    """

    def __init__(
        self,
        scene: Scene,
        contact_columns: Mapping[str, int],
        actuator_columns: Mapping[str, int],
        dt: float | None = None,
    ):
        if scene.run is None:
            raise SceneError(f"{scene.source}: has no [run], so there is no load history to simulate")
        run = scene.run
        self.dt = run.dt if dt is None else dt
        if not (np.isfinite(self.dt) and 0 < self.dt <= run.duration):
            raise SceneError(f"dt = {self.dt!r}: allowed is more than 0 and at most the duration, {run.duration:g} s")
        self.steps = max(1, round(run.duration / self.dt))
        self._loads = run.loads
        self._tables = scene.tables
        self._contact_columns = dict(contact_columns)
        ends = np.cumsum([0, *actuator_columns.values()])
        self._actuator_slice = {
            name: slice(a, b) for name, a, b in zip(actuator_columns, ends[:-1], ends[1:], strict=True)
        }
        self._actuator_total = int(ends[-1])
        for load in self._loads:
            self._check_columns(load, scene)

    def _check_columns(self, load: Load, scene: Scene) -> None:
        if load.contact is not None:
            name, columns = f"contact mode {load.contact!r}", self._contact_columns[load.contact]
        else:
            part = self._actuator_slice[str(load.actuator)]
            name, columns = f"actuator {load.actuator!r}", part.stop - part.start
        given = len(load.force) if load.force is not None else self._tables[str(load.table)].shape[1] - 1
        if given != columns:
            raise SceneError(f"{scene.source}: run.load: {name} takes {columns} numbers as its force, given: {given}")

    def _force(self, load: Load, time: float) -> np.ndarray:
        if load.force is not None:
            return np.array(load.force)
        table = self._tables[str(load.table)]
        return np.array([np.interp(time, table[:, 0], column) for column in table[:, 1:].T])

    def first_contact(self) -> str:
        """Contact mode that the run begins in."""
        pushes = (load.contact for load in self._loads if load.contact is not None)
        return next(pushes, next(iter(self._contact_columns)))

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        """Contact mode and input (contact columns, then actuator columns; N) of each step.

        A contact mode stays until another one's force begins, so a body is released in the mode it was pushed in.
        """
        contact = self.first_contact()
        for step in range(self.steps):
            time = (step + 0.5) * self.dt
            active = [load for load in self._loads if load.start <= time < load.stop]
            contact = next((load.contact for load in active if load.contact is not None), contact)
            columns = self._contact_columns[contact]
            u = np.zeros(columns + self._actuator_total)
            for load in active:
                if load.contact is not None:
                    u[:columns] += self._force(load, time)
                else:
                    u[columns:][self._actuator_slice[str(load.actuator)]] += self._force(load, time)
            yield contact, u
