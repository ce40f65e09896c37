"""Constants of a law of rubber from tests: nominal stress over stretch, of strips and sheets that are pulled.

A CSV file has the column `stretch` first, and nominal stresses (force over the area at rest) in `uniaxial (MPa)`,
`planar (MPa)`, `equibiaxial (MPa)` (Pa, kPa): those that were measured, an empty cell where a test has no value at that
stretch. All values count alike, in Pa. Moduli are found by linear least squares within a search for what the law is not
linear in: the exponents α of ogden, Jm of gent, λm of arruda_boyce (variable projection: Golub & Pereyra, 1973).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array
from scipy.optimize import least_squares

from fenics_rom.arguments import path_in
from fenics_rom.errors import DataError, SceneError, check_type
from fenics_rom.io.tables import read_table
from fenics_rom.io.units import UNITS
from fenics_rom.mechanics.isochoric import LAWS_WITH_CONSTANTS, IsochoricTerm, isochoric_terms, shear_modulus
from fenics_rom.mechanics.rubber_tests import TESTS, nominal_stress, stable_stretches
from fenics_rom.scene.scene import Scene

STRETCH = "stretch"  # the first column
LOOKED_AT = (0.1, 10.0)  # principal stretches between which a law's stability is said
LARGEST_EXPONENT, LARGEST_LOGARITHM = 30.0, 5.0  # that are looked for
LOCKS_NOWHERE = "the tests do not show at which stretch chains lock: that constant is not determined"

Terms = tuple[IsochoricTerm, ...]


class RubberData(NamedTuple):
    """A test."""

    file: str
    test: str
    stretch: Array  # (P,)
    stress: Array  # (P,), nominal, Pa


@dataclass(frozen=True)
class RubberFit:
    """A law of rubber that fits tests.

    Example:
        >>> fit = fr.fit_rubber(fr.read_scene("rubber.toml"), ["rubber.csv"])
        >>> f"C10 = {fit.constants[0]:.3g} Pa, young = {fit.young:.3g} Pa"
        'C10 = 2e+05 Pa, young = 1.19e+06 Pa'
    """

    scene: Scene  # whose law it is
    data: tuple[RubberData, ...]
    constants: tuple[float, ...]  # as scenes have them; stresses in Pa
    shear: float  # modulus at rest, Pa
    stable: dict[str, tuple[float, float]]  # of each kind of test, stretches between which the law is stable
    warnings: tuple[str, ...]

    @property
    def material(self) -> str:
        """The law's name."""
        effect = self.scene.effects.large_deformation
        assert effect is not None
        return effect.material

    @property
    def law(self) -> str:
        """As `isochoric_terms` takes it."""
        return _law_text(self.material, self.constants)

    @property
    def young(self) -> float:
        """Pa, with the scene's Poisson's ratio."""
        (material,) = self.scene.materials.values()
        return 2 * self.shear * (1 + material.poisson)

    def predicted(self, part: RubberData) -> Array:
        """Nominal stress of a test (P,), Pa."""
        return self.shear * nominal_stress(isochoric_terms(self.law), part.test, part.stretch)

    @property
    def residual(self) -> float:
        """Root mean square of what the law is off, Pa."""
        off = np.concatenate([self.predicted(part) - part.stress for part in self.data])
        return float(np.sqrt(np.mean(off**2)))


def is_rubber_data(file: str | Path) -> bool:
    """Whether a CSV file has tests of rubber; False, too, where it cannot be read."""
    try:
        return read_table(Path(file), DataError).heading[0] == STRETCH
    except DataError:
        return False


def read_rubber_data(file: str | Path) -> list[RubberData]:
    """The tests of a CSV file.

    Raises:
        DataError: with the line and column of what cannot be used.

    Example:
        >>> [part.test for part in fr.read_rubber_data("rubber.csv")]
        ['uniaxial', 'planar']
    """
    table = read_table(path_in("read_rubber_data", file), DataError)
    if table.heading[0] != STRETCH or len(table.heading) < 2:
        table.refuse(1, table.heading[0], f"use {STRETCH!r} first, then at least one of {_allowed()}")
    stretch = table.numbers(STRETCH)
    for line, value in zip(table.lines, stretch, strict=True):
        if value <= 0:
            table.refuse(line, STRETCH, f"{value:g} was given; use > 0, the length over that at rest")
    found = []
    for column in table.heading[1:]:
        test, factor = table.unit(column, UNITS["Pa"])
        if test not in TESTS:
            table.refuse(1, column, f"use one of {_allowed()}")
        stress = table.numbers(column, factor, empty=True)
        seen = np.isfinite(stress)
        wrong = np.flatnonzero(seen & (stress * (stretch - 1) < 0))
        if len(wrong):
            where = int(wrong[0])
            says = f"{stress[where]:g} Pa at a stretch of {stretch[where]:g}; use > 0 above 1, and < 0 below 1"
            table.refuse(table.lines[where], column, says)
        if seen.any():
            found.append(RubberData(str(file), test, stretch[seen], stress[seen]))
    return found


def _allowed() -> str:
    return ", ".join(f"{test} (MPa)" for test in TESTS)


def fit_rubber(scene: Scene, data: Sequence[str | Path | RubberData]) -> RubberFit:
    """Finds the constants with which the law of a scene fits tests of rubber best.

    Args:
        scene: of one material, with a law with constants in effects.large_deformation. As many constants are sought as
            it has; its exponents of ogden are where the search begins.
        data: CSV files (see this module), or what `read_rubber_data` read from them.

    Raises:
        DataError: data that cannot be used, or are fewer than the constants.
        SceneError: a scene of another law, or of several materials.

    Example:
        >>> fit = fr.fit_rubber(fr.read_scene("rubber.toml"), ["rubber.csv"])
        >>> f"{fit.law.split()[0]}, {fit.shear:.3g} Pa"
        'yeoh, 4e+05 Pa'
    """
    check_type("fit_rubber", scene, Scene, "fr.read_scene(file)")
    given = scene.effects.large_deformation
    if given is None or given.material not in LAWS_WITH_CONSTANTS:
        raise SceneError(
            "effects.large_deformation.material: tests of rubber are fitted by a law with constants; use "
            + ", ".join(LAWS_WITH_CONSTANTS)
        )
    if len(scene.materials) > 1:
        raise SceneError(f"materials: {', '.join(scene.materials)}: to fit tests of rubber, use one")
    tests = [test for part in data for test in ([part] if isinstance(part, RubberData) else read_rubber_data(part))]
    strained = sum(int((test.stretch != 1).sum()) for test in tests)
    if strained < len(given.constants) + 1:
        raise DataError(
            f"{strained} stresses of stretched rubber were measured; to find the modulus and {len(given.constants)} "
            "constants, use more"
        )
    family = FAMILIES[given.material]
    θ, moduli, longest = _fitted(family, given.constants, tests)
    constants = tuple(map(float, family.constants(θ, moduli, longest)))  # whose texts are numbers alone
    parts = family.parts(θ, len(given.constants), longest)
    shear = float(moduli @ [shear_modulus(part) for part in parts])
    try:
        isochoric_terms(law := _law_text(given.material, constants))
    except ValueError as error:
        raise DataError(f"the best fit is no law, as {error}; another law, or fewer constants, may fit") from None
    stable = {test: stable_stretches(law, test, *LOOKED_AT) for test in TESTS}
    fit = RubberFit(scene, tuple(tests), constants, shear, stable, ())
    return replace(fit, warnings=tuple(_doubts(fit, θ)))


class Family(NamedTuple):
    """Laws of one name: the terms whose moduli are found, each 1, and θ, what these are not linear in."""

    begin: Callable[[Sequence[float], float], list[float]]  # θ, by the scene's constants and the longest I1 - 3
    parts: Callable[[Array, int, float], list[Terms]]  # by θ, how many there are, and the longest I1 - 3
    constants: Callable[[Array, Array, float], list[float]]  # by θ, the moduli found, and the longest I1 - 3
    bound: float = np.inf  # of |θ|
    beyond: str = ""  # what it means where that is reached


FAMILIES = {
    "mooney_rivlin": Family(
        lambda given, longest: [],
        lambda θ, count, longest: [(IsochoricTerm(1.0, 1.0),), (IsochoricTerm(1.0, -1.0),)],
        lambda θ, moduli, longest: list(moduli),
    ),
    "yeoh": Family(
        lambda given, longest: [],
        lambda θ, count, longest: [(IsochoricTerm(1.0, 1.0, n + 1),) for n in range(count)],
        lambda θ, moduli, longest: list(moduli),
    ),
    "ogden": Family(
        lambda given, longest: list(given[1::2]),
        lambda θ, count, longest: [(IsochoricTerm(1 / α, α / 2),) for α in θ],
        lambda θ, moduli, longest: np.stack([moduli, θ], axis=1).ravel().tolist(),
        LARGEST_EXPONENT,
        "an exponent is as large as is looked for: fewer pairs may fit as well",
    ),
    "gent": Family(
        lambda given, longest: [0.0],
        lambda θ, count, longest: [isochoric_terms(f"gent {_largest_invariant(θ, longest)!r}")],
        lambda θ, moduli, longest: [_largest_invariant(θ, longest)],
        LARGEST_LOGARITHM,
        LOCKS_NOWHERE,
    ),
    "arruda_boyce": Family(
        lambda given, longest: [0.0],
        lambda θ, count, longest: [isochoric_terms(f"arruda_boyce {_locking_stretch(θ, longest)!r}")],
        lambda θ, moduli, longest: [_locking_stretch(θ, longest)],
        LARGEST_LOGARITHM,
        LOCKS_NOWHERE,
    ),
}


def _largest_invariant(θ: Array, longest: float) -> float:
    """Jm, beyond all that was measured."""
    return float(longest * (1 + np.exp(θ[0])))


def _locking_stretch(θ: Array, longest: float) -> float:
    """λm > 1; where θ is 0 as long as chains were stretched, √(I1/3)."""
    return float(1 + (np.sqrt(1 + longest / 3) - 1) * np.exp(θ[0]))


def _fitted(family: Family, given: Sequence[float], tests: Sequence[RubberData]) -> tuple[Array, Array, float]:
    """θ, the moduli of the parts, and the longest I1 - 3."""
    longest = max(
        float((test.stretch[:, None] ** (2 * np.array(TESTS[test.test]))).sum(axis=1).max()) - 3 for test in tests
    )
    stress = np.concatenate([test.stress for test in tests])

    def columns(θ: Array) -> Array:
        parts = family.parts(θ, len(given), longest)
        of_tests = [[nominal_stress(part, test.test, test.stretch) for part in parts] for test in tests]
        return np.hstack(of_tests).T

    def off(θ: Array) -> Array:
        A = columns(θ)
        return (A @ np.linalg.lstsq(A, stress, rcond=None)[0] - stress) / np.abs(stress).max()

    θ = np.array(family.begin(given, longest))
    if len(θ):
        bounds = (-family.bound, family.bound)
        θ = least_squares(off, θ, bounds=bounds, x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12).x
    return θ, np.linalg.lstsq(columns(θ), stress, rcond=None)[0], longest


def _doubts(fit: "RubberFit", θ: Array) -> Iterator[str]:
    """What a user is to know of a fit."""
    family = FAMILIES[fit.material]
    if (np.abs(θ) > 0.99 * family.bound).any():
        yield family.beyond
    for part in fit.data:
        least, largest = fit.stable[part.test]
        ends = min(part.stretch.min(), 1.0), max(part.stretch.max(), 1.0)
        if ends[0] < least or largest < ends[1]:
            yield (
                f"in {part.test} tests the law is stable from a stretch of {least:.3g} to {largest:.3g}, and was "
                f"measured from {ends[0]:.3g} to {ends[1]:.3g}: beyond, a body of it gives way; try another law, or "
                "fewer constants"
            )
    if len(kinds := {part.test for part in fit.data}) == 1:
        yield f"all tests are {kinds.pop()}: the law may be far off where rubber is pulled in other ways"


def _law_text(material: str, constants: Sequence[float]) -> str:
    return " ".join([material, *map(repr, constants)])
