"""How far the surface of a body has turned and strained, against what a linear model can follow.

On a triangle the surface gradient H = ∇ₛu, (3, 2), is constant. In the frame t₁, t₂ of its plane and n normal to it

    ω = (H_n2, -H_n1, (H_21 - H_12)/2)   rotation vector: tilt of the normal, and spin about it, rad,
    ε = (H_11, H_22, (H_12 + H_21)/√2)   strain in the plane, such that |ε| is its Frobenius norm.

u = ω × X has this ω and ε = 0. Shear at the surface would be taken for tilt, but where no force acts there is none.
Source: Gurtin, An Introduction to Continuum Mechanics, 1981, chapter III (small deformations).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

# A rigid rotation by θ, u = (R - I) X, strains nothing; a linear model sees cos θ - 1 in it: 2.0 % at 0.2 rad.
ROTATION_LIMIT = 0.2  # rad
# An incompressible neo-Hookean bar at it pulls with 9 % less than Young's modulus says, and pushes with 12 % more.
STRAIN_LIMIT = 0.1
MAX_TRIANGLES = 512  # that are looked at
REMEDY = "effects.large_deformation follows bodies further"
MIN_SIDE, MAX_SIDE = 1e-60, 1e60  # m, longest side of a triangle: beyond, squares of areas vanish or overflow
MIN_HEIGHT_RATIO = 1e-9  # height of a triangle as a share of its longest side; below, its normal is round-off


@dataclass(frozen=True)
class SurfaceStrainPeak:
    """How far a surface went."""

    rotation: float = 0.0  # largest |ω|, rad; linear, so that it may pass π
    strain: float = 0.0  # largest |principal strain|
    time: float = 0.0  # when, s

    @property
    def severity(self) -> float:
        """The larger of rotation and strain as shares of their limits."""
        return max(self.rotation / ROTATION_LIMIT, self.strain / STRAIN_LIMIT)

    @property
    def beyond(self) -> bool:
        """Whether a linear model can no longer be trusted."""
        return self.severity > 1

    def joined(self, later: "SurfaceStrainPeak") -> "SurfaceStrainPeak":
        """The larger of each, and the time of the first that is beyond."""
        return SurfaceStrainPeak(
            rotation=max(self.rotation, later.rotation),
            strain=max(self.strain, later.strain),
            time=self.time if self.beyond else later.time,
        )

    @property
    def warning(self) -> str:
        """What to say at the moment a limit is passed; empty within the limits."""
        return self._message("is", "", f" at t = {self.time:.4g} s", "here")

    @property
    def summary(self) -> str:
        """What to say of a whole run, whose peaks were joined; empty within the limits."""
        return self._message("was", "up to ", "", f"t = {self.time:.4g} s")

    def _message(self, is_or_was: str, up_to: str, when: str, since: str) -> str:
        """What is beyond its limit, and these limits; empty where nothing is."""
        excess, limits = [], []
        if self.rotation > ROTATION_LIMIT:
            excess.append(f"turned by {up_to}{self.rotation:.3g} rad ({math.degrees(self.rotation):.3g}°)")
            limits.append(f"{ROTATION_LIMIT:g} rad ({math.degrees(ROTATION_LIMIT):.2g}°)")
        if self.strain > STRAIN_LIMIT:
            excess.append(f"strained by {up_to}{100 * self.strain:.3g} %")
            limits.append(f"{100 * STRAIN_LIMIT:g} %")
        return " and ".join(excess) and (
            f"the surface {is_or_was} {' and '.join(excess)}{when}, and a linear model is good to about "
            f"{' and '.join(limits)}: shapes and forces from {since} on are not to be trusted; {REMEDY}"
        )


class SurfaceGauges:
    """Measures rotation and strain on at most `MAX_TRIANGLES` triangles of a surface, spread evenly over the list.

    Args:
        nodes: (N, 3), m.
        triangles: (F, 3) corners; those without area are left out.

    Attributes:
        triangles: (g, 3) those that are looked at; of none everything is zero.
    """

    def __init__(self, nodes: Array, triangles: Array):
        chosen = triangles[:: max(1, math.ceil(len(triangles) / MAX_TRIANGLES))]
        a, b = nodes[chosen[:, 1]] - nodes[chosen[:, 0]], nodes[chosen[:, 2]] - nodes[chosen[:, 0]]
        doubled_area = np.linalg.norm(np.cross(a, b), axis=1)
        longest = np.linalg.norm([a, b, b - a], axis=2).max(axis=0)
        solid = (longest > MIN_SIDE) & (longest < MAX_SIDE) & (doubled_area > MIN_HEIGHT_RATIO * longest**2)
        self.triangles = chosen[solid]
        frame, shape_gradients = triangle_frames(a[solid], b[solid])
        H = np.einsum("gic,gkj->ijgkc", frame, shape_gradients).reshape(3, 2, len(frame), 9)
        ω = H[2, 1], -H[2, 0], (H[1, 0] - H[0, 1]) / 2
        ε = H[0, 0], H[1, 1], (H[0, 1] + H[1, 0]) / math.sqrt(2)
        self._operator = np.stack([*ω, *ε], axis=1)

    def components(self, displacement: Array) -> Array:
        """ω, rad, and ε of each triangle, (g, 6), from the displacement of all nodes, (N, 3), m.

        Of k fields at once, (N, 3, k), it is (g, 6, k).
        """
        return self.of_corners(displacement[self.triangles])

    def of_corners(self, u: Array) -> Array:
        """The same from the displacement of the corners of `triangles`, (g, 3, 3) or (g, 3, 3, k), m."""
        return np.einsum("gij,gj...->gi...", self._operator, u.reshape(len(u), 9, *u.shape[3:]))


def measure_peaks(components: Array) -> tuple[float, float]:
    """Largest |ω|, rad, and largest |principal strain|, of components (g, 6)."""
    ω, (ε1, ε2, shear) = components[:, :3], components[:, 3:].T
    principal = np.abs(ε1 + ε2) / 2 + np.hypot((ε1 - ε2) / 2, shear / math.sqrt(2))
    return float(np.linalg.norm(ω, axis=1).max(initial=0.0)), float(principal.max(initial=0.0))


def triangle_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Frames and gradients of the corners' shape functions.

    On a triangle with corners x_0, x_1, x_2 a field u that is linear has the constant surface gradient
    ∇ₛu = Σ u_k ⊗ ∇N_k, N_k the barycentric coordinates. With the sides' coordinates in the frame t₁ (along the first
    side), t₂ = n × t₁ as columns of S (2, 2), the gradients of N_1 and N_2 are the rows of S⁻¹, and that of N_0 is
    minus their sum. Source: Zienkiewicz, Taylor & Zhu, The Finite Element Method, 2013, § 6.2 (linear triangles).

    Args:
        a, b: sides from the first corner to the second and to the third, (g, 3) each, m; of triangles with area.

    Returns:
        t₁, t₂ and n, (g, 3, 3), as rows; and the gradients along t₁ and t₂ of the three corners, (g, 3, 2), 1/m.
    """
    n, t1 = _unit(np.cross(a, b)), _unit(a)
    frame = np.stack([t1, np.cross(n, t1), n], axis=1)
    sides = frame[:, :2] @ np.stack([a, b], axis=2)
    return frame, np.array([[-1, -1], [1, 0], [0, 1]]) @ np.linalg.inv(sides)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
