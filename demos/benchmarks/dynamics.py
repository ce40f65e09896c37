"""Bodies that swing at full order: published amplitudes and periods, and energy that is not lost."""

from collections.abc import Iterator

import numpy as np
from solids import LARGE, PLANE_STRAIN, Row, bar, mesh_of

from fenics_rom.mechanics.step import StepInput

Array = np.ndarray


def flag_that_falls(_quick: bool) -> Iterator[Row]:
    """Turek & Hron (2006), CSM3: CSM1's flag is let go."""

    def place(p: Array) -> Array:
        y = 0.02 * (p[:, 1] - 0.5)
        pole = 0.2 + np.sqrt(0.05**2 - y**2)
        return np.column_stack([pole + p[:, 0] * (0.6 - pole), y, 0.01 * p[:, 2]])

    bricks, h = (25, 2, 1), 0.01
    effects = f"inertia = {{}}\n{LARGE}gravity = {{ acceleration = [0.0, -2.0, 0.0] }}\n"
    system = bar(bricks, place, 1.4e6, 0.4, 1000.0, effects, PLANE_STRAIN)
    body, ends = system.deformation.stepper(h), [np.zeros(3)]
    for _ in range(300):
        body.step(StepInput(np.array([0.0, 0.0, 0.0, 1.0])))
        ends.append(body.displacement("tip").mean(axis=0))
    body.close()
    x, y, _ = np.array(ends).T
    case, mesh = "Turek-Hron CSM3", mesh_of(system, bricks)
    for axis, values, middle, amplitude in (("x", x, -14.305e-3, 14.305e-3), ("y", y, -63.607e-3, 65.160e-3)):
        high, low = float(values.max()), float(values.min())
        yield Row(case, mesh, f"middle of its end in {axis}, m", middle, (high + low) / 2, 0.01)
        yield Row(case, mesh, f"amplitude in {axis}, m", amplitude, (high - low) / 2, 0.01)
    above = y - (y.max() + y.min()) / 2
    falls = np.flatnonzero((above[:-1] > 0) & (above[1:] <= 0))
    times = h * (falls + above[falls] / (above[falls] - above[falls + 1]))
    yield Row(case, mesh, "period, s", 0.9095, float(np.diff(times).mean()), 0.01)


def twisted_column(_quick: bool) -> Iterator[Row]:
    """A column of 1 x 1 x 6 m that turns about its axis at first (Bonet, Gil & Ortigosa, 2015): no energy goes."""
    bricks, h, steps = (6, 1, 1), 2e-3, 40
    for law, poisson, integration in (("st_venant_kirchhoff", 0.3, "full"), ("neo_hookean", 0.495, "selective")):
        effects = f'inertia = {{}}\nlarge_deformation = {{ material = "{law}" }}\n'
        system = bar(bricks, lambda p: (p - [0, 0.5, 0.5]) * [6, 1, 1], 17e6, poisson, 1100.0, effects,
                     integration=integration)  # fmt: skip
        X = system.body.nodes
        spin = 30.0 * np.sin(np.pi * X[:, 0] / 12)
        v = np.column_stack([0 * spin, -spin * X[:, 2], spin * X[:, 1]])
        body = system.deformation.stepper(h)
        rows = system.deformation.model.local_rows(v)
        body.set_state(0 * rows, rows)
        begun, least = body.energy, 1.0
        for _ in range(steps):
            body.step(StepInput(np.zeros(3)))
            least = min(least, system.deformation.model.dot(body.v, system.mass @ body.v) / 2 / begun)
        what = f"energy after {h * steps:g} s, of {begun:.4g} J"
        assert least < 0.6  # much of it was strain on the way
        yield Row(f"twisted column, {law}", mesh_of(system, bricks), what, 1.0, body.energy / begun, 1e-9)
        body.close()
