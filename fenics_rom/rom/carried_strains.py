"""Strains of a body that deforms as far as it likes, as coordinates y that a step can carry along as unknowns.

    E(q) is of second degree in q,   dE/dt = A(q) v,   energy ½ yᵀz of z = C₀ y, forces Aᵀz, stiffness AᵀC₀A

`MonomialStrains` are coordinates of the monomials of q: tables replace the points, and a step needs but three products
with them. `PointStrains` are the strains of the points themselves, which of many modes are fewer.
"""

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import VOIGT_SHEAR, linear_stress
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.material_points import MaterialPoints

MOST_MODES = 30  # beyond, their tables outgrow the caches, and points are as fast


class StrainTables(NamedTuple):
    """What strains are of the r monomials η = (q_i, then q_i q_j of i < j and q_i²/2, row by row), with C₀.

    Attributes:
        first, second: i and j of the products.
        half: ½ of squares, 1 of other products.
        place: (m, m) which product i and j make.
        gram: (r, r) 𝒢, of the energy ½ ηᵀ𝒢η, J.
        stiffness: (m (m+1)/2, r) upper triangle of AᵀC₀A, row by row, from η, but for that at rest.
        at_rest: (m (m+1)/2,) of that.
    """

    first: Array
    second: Array
    half: Array
    place: Array
    gram: Array
    stiffness: Array
    at_rest: Array

    def __deepcopy__(self, memo: object) -> "StrainTables":
        return self  # nobody writes to it

    @staticmethod
    def of(body: ReducedDeformation) -> "StrainTables":
        """Of a body, made once."""
        if body not in _tables:
            _tables[body] = StrainTables._made(body)
        return _tables[body]

    @staticmethod
    def _made(body: ReducedDeformation) -> "StrainTables":
        m, gradients = body.order, body.gradients
        i, j = np.triu_indices(m)
        place = np.zeros((m, m), int)
        place[i, j] = place[j, i] = np.arange(len(i))
        linear = body.metric_rates(np.broadcast_to(np.eye(3)[:, :, None], gradients.shape[:3]))
        products = [body.metric_rates(gradients[..., k])[..., k:] for k in range(m)]
        C = np.concatenate([linear, *products], axis=2).reshape(6, len(body.weights), -1)
        stressed = (2 * body.weights * body.shear / VOIGT_SHEAR)[:, :, None] * C
        stressed[:3] += (body.weights * body.first_lame)[:, None] * C[:3].sum(axis=0)
        r = C.shape[2]
        gram = C.reshape(-1, r).T @ stressed.reshape(-1, r)
        gram = (gram + gram.T) / 2
        at, k, i_, j_ = place + m, np.arange(m), i[:, None], j[:, None]
        by_one = gram[i_, at[k, j_]] + gram[j_, at[k, i_]]
        by_two = gram[at[i, i_], at[j, j_]] + gram[at[j, i_], at[i, j_]]
        half = np.where(i == j, 0.5, 1.0)
        return StrainTables(i, j, half, place, gram, np.hstack([by_one, by_two]), gram[i, j])

    def at(self, q: Array) -> Array:
        """η (r,) of q (m,), or of bodies (m, B)."""
        η = np.empty((len(self.gram), *q.shape[1:]))
        η[: len(q)] = q
        self.products(q, η[len(q) :])
        return η

    def products(self, q: Array, products: Array | None = None) -> Array:
        """What of η are products (m (m+1)/2,), of q (m,) or of bodies (m, B); written where they are to be."""
        products = np.multiply(q.take(self.first, 0), q.take(self.second, 0), products)
        np.multiply(products.T, self.half, products.T)
        return products

    def rates(self, q: Array, v: Array) -> Array:
        """What η change by at q (m,), or of bodies (m, B), with v."""
        rates = np.empty((len(self.gram), *q.shape[1:]))
        rates[: len(q)] = v
        products = rates[len(q) :]
        np.multiply(q.take(self.first, 0), v.take(self.second, 0), products)
        products += q.take(self.second, 0) * v.take(self.first, 0)
        np.multiply(products.T, self.half, products.T)
        return rates


_tables: WeakKeyDictionary[ReducedDeformation, StrainTables] = WeakKeyDictionary()


class MonomialStrains:
    """Strains as coordinates of monomials, of a body with one viscosity.

    Attributes:
        size: number of coordinates.
        viscosity: β, s.
    """

    def __init__(self, body: ReducedDeformation):
        self._tables, self._m = StrainTables.of(body), body.order
        self.size = len(self._tables.gram)
        self.viscosity = float(body.viscosity[0])

    def around(self, q: Array) -> "MonomialsAround":
        """Of shapes near q."""
        return MonomialsAround(self._tables, self.viscosity, q)

    def at(self, q: Array) -> Array:
        """y of E(q)."""
        return self._tables.at(q)

    def stressed(self, y: Array) -> Array:
        """C₀ y."""
        z: Array = self._tables.gram.dot(y)
        return z

    def with_next(
        self, q: Array, middle: Array, v: Array, relaxation: float, is_elastic: bool
    ) -> tuple[Array, Array, "MonomialsAround", Array]:
        """y and C₀y at q, and around another shape, `middle`, C₀ times what is `damped` there: in one product."""
        y, around = np.empty((2, self.size)), self.around(middle)
        y[0], y[1] = self.at(q), around.damped(v, relaxation, is_elastic)
        z = self._tables.gram.dot(y.T)
        return y[0], z[:, 0], around, z[:, 1]

    def geometric(self, z: Array) -> Array:
        """∂(Aᵀz)/∂q (m, m)."""
        return z[self._m :].take(self._tables.place)

    def geometric_back(self, N: Array) -> Array:
        """What a matrix N (m, m) times `geometric` owes to z."""
        return np.bincount(self._m + self._tables.place.ravel(), N.ravel(), self.size)


class MonomialsAround:
    """What strains of shapes near q are by their rates; y are those at q."""

    _stiffness: Array  # AᵀC₀A, once it was asked for

    def __init__(self, tables: StrainTables, viscosity: float, q: Array):
        self._tables, self._β, self._q = tables, viscosity, q

    @property
    def y(self) -> Array:
        """At q."""
        return self._tables.at(self._q)

    def rates(self, v: Array) -> Array:
        """A v."""
        return self._tables.rates(self._q, v)

    def pulled(self, z: Array) -> Array:
        """Aᵀz (m,)."""
        m = len(self._q)
        force: Array = z[m:].take(self._tables.place).dot(self._q)
        force += z[:m]
        return force

    def damped(self, v: Array, relaxation: float, is_elastic: bool) -> Array:
        """(β + relaxation) A v (size,), and y with it where that is elastic."""
        tables, moved = self._tables, (self._β + relaxation) * v
        if not is_elastic:
            return tables.rates(self._q, moved)
        both = tables.at(self._q + moved)  # but for the squares of what is moved
        both[len(v) :] -= tables.products(moved)
        return both

    def stiffness(self, elastic: float) -> Array:
        """Aᵀ (elastic + β) C₀ A (m, m)."""
        upper = self._tables.stiffness.dot(self.y)
        upper += self._tables.at_rest
        self._stiffness = upper.take(self._tables.place)
        return (elastic + self._β) * self._stiffness

    def squares(self, v: Array) -> tuple[float, float]:
        """Of A v by C₀, and by β C₀; `stiffness` was found before."""
        square = float(v.dot(self._stiffness.dot(v)))
        return square, self._β * square


class PointStrains:
    """Strains (6 P,) of the points of a body. Attributes as in MonomialStrains; β is of each strain."""

    def __init__(self, body: ReducedDeformation):
        self.body, self.points, self.size = body, MaterialPoints(body), 6 * len(body.weights)
        self.viscosity = np.tile(body.viscosity, 6)
        self._λ, self._μ = body.weights * body.first_lame, body.weights * body.shear

    def around(self, q: Array) -> "PointsAround":
        """Of shapes near q."""
        return PointsAround(self, *self.points.strains(q))

    def at(self, q: Array) -> Array:
        """y of E(q)."""
        return self.points.strains(q)[1].ravel()

    def stressed(self, y: Array) -> Array:
        """C₀ y."""
        return linear_stress(y.reshape(6, -1), self._λ, self._μ).ravel()

    def with_next(
        self, q: Array, middle: Array, v: Array, relaxation: float, is_elastic: bool
    ) -> tuple[Array, Array, "PointsAround", Array]:
        """As in MonomialStrains."""
        y, around = self.at(q), self.around(middle)
        return y, self.stressed(y), around, self.stressed(around.damped(v, relaxation, is_elastic))

    def geometric(self, z: Array) -> Array:
        """∂(Aᵀz)/∂q (m, m)."""
        return self.body.geometric(z.reshape(6, -1))

    def geometric_back(self, N: Array) -> Array:
        """What a matrix N (m, m) times `geometric` owes to z."""
        return self.body.geometric_back(N).ravel()


class PointsAround:
    """What strains of shapes near q are by their rates; F (3, 3, P) and E (6, P) are those at q."""

    def __init__(self, strains: PointStrains, F: Array, E: Array):
        self._strains, self._F, self.y = strains, F, E.ravel()

    def rates(self, v: Array) -> Array:
        """A v."""
        return self._strains.points.rates(self._F, v).ravel()

    def damped(self, v: Array, relaxation: float, is_elastic: bool) -> Array:
        """(β + relaxation) A v (6 P,), and y with it where that is elastic."""
        damped: Array = (self._strains.viscosity + relaxation) * self.rates(v)
        return damped + self.y if is_elastic else damped

    def pulled(self, z: Array) -> Array:
        """Aᵀz (m,)."""
        return self._strains.points.resultant(self._F, z.reshape(6, -1))[:, 0]

    def squares(self, v: Array) -> tuple[float, float]:
        """Of A v by C₀, and by β C₀."""
        rates = self.rates(v)
        stressed = self._strains.stressed(rates)
        return float(stressed.dot(rates)), float(stressed.dot(self._strains.viscosity * rates))

    def stiffness(self, elastic: float) -> Array:
        """Aᵀ (elastic + β) C₀ A (m, m)."""
        body = self._strains.body
        A, weights = body.metric_rates(self._F), (elastic + body.viscosity) * body.weights
        CA = (2 * weights * body.shear / VOIGT_SHEAR)[:, :, None] * A
        CA[:3] += (weights * body.first_lame)[:, None] * A[:3].sum(axis=0)
        K: Array = A.reshape(-1, body.order).T.dot(CA.reshape(-1, body.order))
        return K


def carried_strains(body: ReducedDeformation) -> MonomialStrains | PointStrains:
    """In the coordinates that are the fastest for a body."""
    has_tables = body.order <= MOST_MODES and np.ptp(body.viscosity) == 0
    return MonomialStrains(body) if has_tables else PointStrains(body)
