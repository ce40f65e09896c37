"""Tables of what strains of second degree store, and how stiff they make a body, of all its points at once.

With x = (1, q) of n = m + 1 numbers strains are E = ½ B(x, x), B symmetric and bilinear, and with

    g(ak|bl) = B_ak : C₀ B_bl,    k(ab|kl) = ½ (g(ak|bl) + g(al|bk)),    K(x) = k(··|xx)

energy is ½ E:C₀E = ⅛ xᵀK(x) x, its slope ½ K(x) x, and AᵀC₀A what K(x) has of q. The pull at x of stresses at another
shape y needs no more, either: g(wx|yy)/2 = ½ wᵀ[(K(x) - K(x - y)) y - K(y) (x - y)]. So a step that carries no other
strains reads k and never g.
"""

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedDeformation


class StrainTables(NamedTuple):
    """What strains are of the r monomials η = (q_i, then q_i q_j of i < j and q_i²/2, row by row), with C₀.

    Attributes:
        first, second: k and l of the products x_k x_l (1 + r,): of 1, then η with twice the squares.
        half: ½ of squares, 1 of other products.
        place: (m, m) which product q_i and q_j make.
        gram: (r, r) 𝒢, of the energy ½ ηᵀ𝒢η, J.
        stiffness: (1 + r, 1 + r) upper triangle of ½ K(x), row by row, from the products.
    """

    first: Array
    second: Array
    half: Array
    place: Array
    gram: Array
    stiffness: Array

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
        n, gradients = body.order + 1, body.gradients
        i, j = np.triu_indices(n)
        place = np.zeros((n, n), int)
        place[i, j] = place[j, i] = np.arange(len(i))
        linear = body.metric_rates(np.broadcast_to(np.eye(3)[:, :, None], gradients.shape[:3]))
        products = [body.metric_rates(gradients[..., k])[..., k:] for k in range(body.order)]
        B = np.concatenate([np.zeros((*linear.shape[:2], 1)), linear, *products], axis=2)
        stressed = body.material.scaled(body.weights).linear_stress(B)
        g = B.reshape(-1, len(i)).T @ stressed.reshape(-1, len(i))
        g = (g + g.T) / 2
        a, b = i[:, None], j[:, None]
        stiffness = g[place[a, i], place[b, j]] + g[place[a, j], place[b, i]]
        half = np.where(i == j, 0.5, 1.0)
        return StrainTables(i, j, half, place[1:, 1:].copy(), g[1:, 1:].copy(), _on_cache_lines(stiffness * half / 2))

    def at(self, q: Array) -> Array:
        """η (r,) of q (m,), or of bodies (m, B)."""
        η = np.empty((len(self.gram), *q.shape[1:]))
        η[: len(q)], products, pairs = q, η[len(q) :], slice(1 + len(q), None)
        np.multiply(q.take(self.first[pairs] - 1, 0), q.take(self.second[pairs] - 1, 0), products)
        np.multiply(products.T, self.half[pairs], products.T)
        return η

    def rates(self, q: Array, v: Array) -> Array:
        """What η change by at q (m,), or of bodies (m, B), with v."""
        pairs = slice(1 + len(q), None)
        i, j = self.first[pairs] - 1, self.second[pairs] - 1
        rates = np.empty((len(self.gram), *q.shape[1:]))
        rates[: len(q)], products = v, rates[len(q) :]
        np.multiply(q.take(i, 0), v.take(j, 0), products)
        products += q.take(j, 0) * v.take(i, 0)
        np.multiply(products.T, self.half[pairs], products.T)
        return rates


def _on_cache_lines(matrix: Array) -> Array:
    """A copy that begins at one, as products with its rows are a tenth faster then."""
    room = np.empty(matrix.size + 8)
    start = -room.ctypes.data % 64 // 8
    aligned: Array = room[start : start + matrix.size].reshape(matrix.shape)
    aligned[:] = matrix
    return aligned


_tables: WeakKeyDictionary[ReducedDeformation, StrainTables] = WeakKeyDictionary()
