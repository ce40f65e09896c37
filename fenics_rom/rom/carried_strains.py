"""Strains of a body that deforms as far as it likes, as coordinates y that a step can carry along as unknowns.

    E(q) is of second degree in q,   dE/dt = A(q) v,   energy ½ yᵀz of z = C₀ y, forces Aᵀz, stiffness AᵀC₀A

`MonomialStrains` are coordinates of the monomials of q: tables replace the points (`strain_tables.py`). `PointStrains`
are the strains of the points themselves, which of many modes are fewer.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.rom.strain_tables import StrainTables

MOST_MODES = 40  # whose tables take 12 MB, and as much again in loops: more modes were not measured


class MonomialStrains:
    """Strains as coordinates of monomials, of a body with one viscosity.

    Attributes:
        tables: what they are of.
        size: number of coordinates.
        viscosity: β, s.
    """

    def __init__(self, body: ReducedDeformation):
        self.tables = tables = StrainTables.of(body)
        self.size = len(tables.gram)
        self.viscosity = float(body.viscosity[0])
        self._places = tables.place - 1  # of the products of coordinates in y (m, m),
        self._two_places = np.stack([tables.place, tables.place + 1 + self.size])  # and in two rows of ½ K(x)
        self._x = np.ones((2, 1 + body.order))  # (1, q) of two shapes,
        self._changed = np.eye(2, 1 + body.order)  # and of one, with (0, q) of a change

    def at(self, q: Array) -> Array:
        """y of E(q)."""
        return self.tables.at(q)

    def rates(self, q: Array, v: Array) -> Array:
        """A v at q."""
        return self.tables.rates(q, v)

    def stressed(self, y: Array) -> Array:
        """C₀ y, of one or of each row."""
        z: Array = y.dot(self.tables.gram)
        return z

    def around(self, q: Array) -> "MonomialsAround":
        """Of shapes near q."""
        x = self._x
        x[:, 1:] = q
        upper, K = self._stiffnesses(self._products(x))
        return MonomialsAround(self, q, upper[0], K[0])

    def with_next(
        self, q: Array, middle: Array, v: Array, relaxation: float, is_elastic: bool
    ) -> "tuple[MonomialShape, MonomialsAround, Array]":
        """What is strained at q, what is around another shape, `middle`, and there Aᵀ of what is `damped`."""
        x = self._x
        x[0, 1:], x[1, 1:] = q, middle
        products = self._products(x)
        upper, K = self._stiffnesses(products)
        around = MonomialsAround(self, middle, upper[1], K[1])
        moved = (2 * (self.viscosity + relaxation)) * v
        if is_elastic:
            moved += middle
        damped = K[1].dot(moved)
        if is_elastic:
            damped += around.linear
        return MonomialShape(self, q, K[0], float((products[0] * upper[0]).dot(self.tables.half)) / 2), around, damped

    def around_another(self, q: Array, shape: "MonomialShape") -> "tuple[MonomialsAround, Array]":
        """Of shapes near q, and Aᵀ there of the stresses at another one."""
        x = self._changed
        x[0, 1:] = q
        change = np.subtract(q, shape.q, x[1, 1:])
        products = self._products(x)
        np.subtract(products[0], products[1], products[1])
        upper, K = self._stiffnesses(products)
        pulled = K[1].dot(shape.q)
        pulled += upper[1, 1 : len(x[0])]
        pulled -= shape.K.dot(change)
        return MonomialsAround(self, q, upper[0], K[0]), pulled

    def geometric(self, z: Array) -> Array:
        """∂(Aᵀz)/∂q (m, m)."""
        return z.take(self._places)

    def geometric_back(self, N: Array) -> Array:
        """What a matrix N (m, m) times `geometric` owes to z."""
        return np.bincount(self._places.ravel(), N.ravel(), self.size)

    def _products(self, x: Array) -> Array:
        """Of each of two x (2, n)."""
        products = x.take(self.tables.first, 1)
        products *= x.take(self.tables.second, 1)
        return products

    def _stiffnesses(self, products: Array) -> tuple[Array, Array]:
        """The upper triangles of ½ K(x), from products (2, 1 + r), and what they have of q (2, m, m)."""
        upper, table = np.empty(products.shape), self.tables.stiffness
        table.dot(products[0], upper[0])
        table.dot(products[1], upper[1])  # one by one, which takes half the time of a product with both
        return upper, upper.take(self._two_places)


class MonomialShape(NamedTuple):
    """What is strained at a shape."""

    strains: MonomialStrains
    q: Array
    K: Array  # ½ K(x) of q (m, m)
    energy: float  # J

    def around(self, q: Array) -> "tuple[MonomialsAround, Array]":
        """Of shapes near q, and Aᵀ there of the stresses here."""
        return self.strains.around_another(q, self)


class MonomialsAround(NamedTuple):
    """What strains of shapes near one are by their rates."""

    strains: MonomialStrains
    q: Array
    upper: Array  # triangle of ½ K(x) there
    K: Array  # what it has of q (m, m)

    @property
    def linear(self) -> Array:
        """What ½ K(x) has of 1 and q (m,)."""
        return self.upper[1 : 1 + len(self.q)]

    @property
    def elastic(self) -> tuple[float, Array]:
        """Energy of these strains, J, and its slope (m,)."""
        slope = self.K.dot(self.q)
        slope += self.linear
        energy = float((slope + self.linear).dot(self.q)) + self.upper.item(0)
        return energy / 4, slope

    def rates(self, v: Array) -> Array:
        """A v."""
        return self.strains.rates(self.q, v)

    def pulled(self, z: Array) -> Array:
        """Aᵀz (m,)."""
        force: Array = self.strains.geometric(z).dot(self.q)
        force += z[: len(force)]
        return force

    def damped(self, v: Array, relaxation: float, is_elastic: bool) -> Array:
        """(β + relaxation) A v (size,), and y with it where that is elastic."""
        rates = self.rates((self.strains.viscosity + relaxation) * v)
        return rates + self.strains.at(self.q) if is_elastic else rates

    def stiffness(self, elastic: float) -> Array:
        """Aᵀ (elastic + β) C₀ A (m, m)."""
        return (2 * (elastic + self.strains.viscosity)) * self.K

    def squares(self, v: Array) -> tuple[float, float]:
        """Of A v by C₀, and by β C₀."""
        square = 2 * float(v.dot(self.K.dot(v)))
        return square, self.strains.viscosity * square


class PointStrains:
    """Strains (6 P,) of the points of a body. Attributes as in MonomialStrains; β is of each strain."""

    def __init__(self, body: ReducedDeformation):
        self.body, self.points, self.size = body, MaterialPoints(body), 6 * len(body.weights)
        self.viscosity = np.tile(body.viscosity, 6)
        self._material = body.material.scaled(body.weights)

    def at(self, q: Array) -> Array:
        """y of E(q)."""
        return self.points.strains(q)[1].ravel()

    def rates(self, q: Array, v: Array) -> Array:
        """A v at q."""
        return self.around(q).rates(v)

    def stressed(self, y: Array) -> Array:
        """C₀ y, of one or of each row."""
        by_component = y.reshape(-1, 6, self.size // 6).transpose(1, 2, 0)
        return self._material.linear_stress(by_component).transpose(2, 0, 1).reshape(y.shape)

    def around(self, q: Array) -> "PointsAround":
        """Of shapes near q."""
        return PointsAround(self, *self.points.strains(q))

    def with_next(
        self, q: Array, middle: Array, v: Array, relaxation: float, is_elastic: bool
    ) -> "tuple[PointShape, PointsAround, Array]":
        """As in MonomialStrains."""
        y, around = self.at(q), self.around(middle)
        z = self.stressed(y)
        damped = around.pulled(self.stressed(around.damped(v, relaxation, is_elastic)))
        return PointShape(self, z, float(z.dot(y)) / 2), around, damped

    def geometric(self, z: Array) -> Array:
        """∂(Aᵀz)/∂q (m, m)."""
        return self.body.geometric(z.reshape(6, -1))

    def geometric_back(self, N: Array) -> Array:
        """What a matrix N (m, m) times `geometric` owes to z."""
        return self.body.geometric_back(N).ravel()


class PointShape(NamedTuple):
    """What is strained at a shape."""

    strains: PointStrains
    z: Array  # C₀ y
    energy: float  # J

    def around(self, q: Array) -> "tuple[PointsAround, Array]":
        """Of shapes near q, and Aᵀ there of the stresses here."""
        around = self.strains.around(q)
        return around, around.pulled(self.z)


class PointsAround:
    """What strains of shapes near q are by their rates; F (3, 3, P) and E (6, P) are those at q."""

    def __init__(self, strains: PointStrains, F: Array, E: Array):
        self._strains, self._F, self.y = strains, F, E.ravel()

    @property
    def elastic(self) -> tuple[float, Array]:
        """Energy of these strains, J, and its slope (m,)."""
        z = self._strains.stressed(self.y)
        return float(z.dot(self.y)) / 2, self.pulled(z)

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
        CA = weights[:, None] * body.material.linear_stress(A)
        K: Array = A.reshape(-1, body.order).T.dot(CA.reshape(-1, body.order))
        return K


def carried_strains(body: ReducedDeformation) -> MonomialStrains | PointStrains:
    """In the coordinates that are the fastest for a body."""
    has_tables = body.order <= MOST_MODES and np.ptp(body.viscosity) == 0
    return MonomialStrains(body) if has_tables else PointStrains(body)
