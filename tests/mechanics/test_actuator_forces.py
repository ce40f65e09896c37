"""Forces at the guides of cables, of many of them at once, beside a contact point and alone."""

import numpy as np
import pytest

from fenics_rom.errors import StepError
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.compiled import actuator_forces as loops
from fenics_rom.mechanics.compiled import searched_forces
from fenics_rom.mechanics.complementarity.pivoting import solve_by_pivots
from fenics_rom.mechanics.environment import Guide
from fenics_rom.mechanics.gas import Targets
from fenics_rom.mechanics.points_held_back import PointsHeldBack

MODES = 20
BOTH = pytest.mark.parametrize("control", [{}, {"cable": "length"}], ids=["tension", "length"])


class Cable:
    """A cable through so many guides of a body of smooth modes, as random numbers have it."""

    def __init__(self, guides, control, seed):
        random, k = np.random.default_rng(seed), len(control)
        self.friction = random.choice([0.1, 0.3, 1.0])
        names = [f"guide-{i}" for i in range(guides)]
        widths = {"cable": 1, **dict.fromkeys(names, 1)}
        self.actuators = ActuatorForces(control, {name: Guide("cable", self.friction, 0.1) for name in names}, widths)
        sizes, ends = np.exp(-0.3 * np.arange(MODES)), np.arange(guides + 1) + 0.5
        pieces = np.cos(np.multiply.outer(np.arange(1, MODES + 1), ends) * np.pi / (2 * guides + 2)) * sizes[:, None]
        pieces += 0.01 * random.standard_normal(pieces.shape) * sizes[:, None]
        strokes = pieces.cumsum(axis=1)  # from the anchor on
        self.columns, self.cable = np.hstack([strokes[:, -1:], strokes[:, :-1]])[:, 1 - k :], strokes[:, -1]
        self.W = self.actuators.compliance(self.columns.T @ self.columns)
        self.free, started = random.standard_normal((2, MODES)) * sizes
        self.rates, self.targets = self.columns.T @ self.free, self.columns.T @ started / 2
        self.targets[:k] = 3 * random.standard_normal(k)
        self.angles = np.abs(random.standard_normal(k + guides)) * random.choice([1e-5, 0.1, 0.5])
        self.angles[:k] = 0.0
        self.u = np.array([0.0 if control else 10 * abs(random.standard_normal()), *np.zeros(guides)])
        self.k, self.point = k, random.standard_normal(MODES) * sizes

    def solve(self, before=None, touch=None):
        before = np.zeros(len(self.W)) if before is None else before
        return self.actuators.solve(self.u, self.rates, self.W, Targets(self.targets), before, touch, self.angles)

    def missed(self, z, rates):
        """By how much the laws of a slack cable and of the capstan are missed, as a share of forces or rates."""
        bends, missed, k = self.friction * self.angles, rates - self.targets, self.k
        force, rate = np.abs(z).max() or 1.0, max(np.abs(part).max() for part in (rates, self.rates, self.targets))
        T, wrong = z[0] if k else self.u[0], []
        if k:
            wrong += [-T / force, -missed[0] / rate, min(T / force, missed[0] / rate)]
        for i in range(len(z) - 1, k - 1, -1):
            over, under = (z[i] - T * np.expm1(-bends[i])) / force, (T * np.expm1(bends[i]) - z[i]) / force
            slips = [(missed[i] + start) / rate for start in (0.0, self.targets[i])]
            wrong += [-over, -under, min(max(min(max(s, 0), over), min(max(-s, 0), under)) for s in slips)]
            T += z[i]
        return max(wrong)


@BOTH
@pytest.mark.parametrize("guides", [3, 13, 25])
def test_any_number_of_guides_obeys_the_capstan(guides, control):
    """Within bounds, and sliding where at one, from wherever the search begins: smooth modes all but tie guides."""
    for seed in range(15):
        cable = Cable(guides, control, seed)
        z, _ = cable.solve()
        assert cable.missed(z, cable.rates + cable.W @ z) <= 1e-8
        again, _ = cable.solve(before=z)
        other, _ = cable.solve(before=np.random.default_rng(seed).standard_normal(len(z)))
        for found in (again, other):
            np.testing.assert_allclose(found, z, rtol=0, atol=1e-6 * np.abs(z).max())


@BOTH
def test_a_cable_that_slides_through_13_guides_loses_what_the_capstan_says(control):
    """Pulled, T exp(-μ Σα) is left behind each guide."""
    cable = Cable(13, control, 1)
    cable.angles[cable.k :] = np.linspace(0.02, 0.2, 13)
    pull = 0.0 if control else 7.0
    cable.rates, cable.targets, cable.u[0] = pull * cable.cable @ cable.columns, 0 * cable.targets, pull
    cable.targets[: cable.k] = 0.5
    z, _ = cable.solve()
    T = z[0] if control else pull
    expected = T * np.exp(-cable.friction * cable.angles[cable.k :][::-1].cumsum())
    np.testing.assert_allclose(T + z[cable.k :][::-1].cumsum(), expected, rtol=1e-10)
    assert (cable.rates + cable.W @ z)[cable.k :].min() > 0


@BOTH
@pytest.mark.parametrize("guides", [3, 13])
def test_guides_obey_the_capstan_beside_a_contact(guides, control):
    """And the point of contact is pushed where it would come too near under the forces found, not under others."""
    touched = 0
    for seed in range(15):
        cable = Cable(guides, control, seed)
        X, compliance, asked = (cable.point @ cable.columns)[None], np.array([[cable.point @ cable.point]]), -0.1
        held = PointsHeldBack(compliance, X, cable.W)

        def touch(z, holding, gives=None, cable=cable, X=X, held=held, asked=asked):
            short = asked - cable.point @ cable.free - X[0] @ z
            force = short / held.delassus(holding)[0, 0]
            return (force, X[0] * force) if short > 0 else (None, 0 * z)

        z, contact = cable.solve(touch=touch)
        force = contact or 0.0
        gap, size = cable.point @ cable.free + X[0] @ z + compliance[0, 0] * force - asked, np.abs(z).max() or 1.0
        assert force >= 0
        assert gap >= -1e-6
        assert min(gap, force / size) <= 1e-6
        assert cable.missed(z, cable.rates + cable.W @ z + X[0] * force) <= 1e-6
        touched += force > 0
    assert 3 < touched < 15


@pytest.fixture
def in_python(monkeypatch):
    """Compiled functions of forces that are found, as Python takes them."""

    def take(space, n):
        first = int(space[0])
        space[0] += n
        return space[first : first + n]

    def solve(A, x, n):
        x[:n] = np.linalg.solve(A, x[:n])
        return True

    replaced = {"take": take, "solve": solve, "matrix_in": lambda numbers, n: np.zeros((n, n))}
    replaced["take_rows"] = lambda space, n, width: take(space, n * width).reshape(n, width)
    for module in (loops, searched_forces):
        for name in replaced.keys() & vars(module).keys():
            monkeypatch.setattr(module, name, replaced[name])


def by_loops(cable, before, touch):
    """Forces by the rounds of compiled steps."""
    n, given = len(cable.W), loops.Actuators.of(cable.actuators, len(cable.u))
    search = searched_forces.search_in(np.zeros(searched_forces.room_for_search(n)), n)
    search.targets[:], search.rates[:] = cable.targets, cable.rates
    bends = cable.actuators.bends(cable.angles)
    assert loops.begin_search(given, bends, cable.W, cable.u, before, 1e-3, search)
    outcome = loops.GOES_ON
    while outcome == loops.GOES_ON:
        if touch is not None:
            assert loops.hold(search)
            _, search.added[:] = touch(search.z, search.holds != 0)
        outcome = loops.look(given, bends, cable.u, touch is not None, search)
    assert outcome == loops.ARE_FOUND
    return search.z


@BOTH
@pytest.mark.parametrize("guides", [1, 3, 13])
def test_compiled_rounds_find_what_numpy_finds(guides, control, in_python):
    """Alone and beside a contact, from wherever the search begins; of many guides by pivots."""
    for seed in range(40 // guides):
        cable = Cable(guides, control, seed)
        X, asked = cable.point @ cable.columns, -0.1
        held = PointsHeldBack(np.array([[cable.point @ cable.point]]), X[None], cable.W)

        def touch(z, holding, gives=None, cable=cable, X=X, held=held, asked=asked):
            short = asked - cable.point @ cable.free - X @ z
            force = short / held.delassus(holding)[0, 0]
            return (force, X * force) if short > 0 else (None, 0 * z)

        for before in (np.zeros(len(X)), np.random.default_rng(seed).standard_normal(len(X))):
            for beside in (None, touch):
                z, _ = cable.solve(before, beside)
                found = by_loops(cable, before, beside)
                np.testing.assert_allclose(found, z, rtol=0, atol=1e-9 * np.abs(z).max())


def test_pivots_solve_complementarity_problems_that_are_degenerate():
    """w = M z + q, with q of which half is 0, and M that is definite on one block and skew on the other."""
    (random, size), ended = (np.random.default_rng(2), 12), 0
    for _ in range(30):
        root = random.standard_normal((size, size))
        sides = random.standard_normal((size, size)) * (random.random((size, size)) < 0.3)
        M = np.block([[root @ root.T, sides], [-sides.T, np.zeros((size, size))]])
        q = np.concatenate([random.standard_normal(size), np.zeros(size)])
        z = solve_by_pivots(M / np.abs(M).max(), q)
        if z is None:  # as round-off hides which of many zeros comes first
            ended += 1
            continue
        w = M @ z / np.abs(M).max() + q
        scale = max(np.abs(z).max(), 1.0)
        assert min(z.min(), w.min()) >= -1e-9 * scale
        assert np.abs(np.minimum(z, w)).max() <= 1e-9 * scale
    assert ended <= 1
    assert solve_by_pivots(-np.eye(2), np.array([-1.0, -1.0])) is None


def test_a_body_that_is_not_stable_against_strokes_is_told_so():
    """Its strokes do not depend on one another: a step that is too long has led to where its tangent is indefinite."""
    actuators, one = ActuatorForces({"air": "volume"}, {}, {"air": 1}), np.ones(1)
    nothing = Targets(0 * one)
    with pytest.raises(StepError, match=r"strokes of air: .* not stable against them; a smaller dt"):
        actuators.solve(one, one, -1e-7 * np.eye(1), nothing, one, lambda z, holding, gives: (None, np.nan * z))
    with pytest.raises(StepError, match="strokes of air: they depend on one another"):
        actuators.solve(one, one, np.zeros((1, 1)), nothing, one, None)
