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

from fenics_rom.mechanics.surface_gradient import triangle_frames
from fenics_rom.rom.rom import Rom, safe_frequencies

Array = np.ndarray

# A rigid rotation by θ, u = (R - I) X, strains nothing; a linear model sees cos θ - 1 in it: 2.0 % at 0.2 rad.
ROTATION_LIMIT = 0.2  # rad
# An incompressible neo-Hookean bar at it pulls with 9 % less than Young's modulus says, and pushes with 12 % more.
STRAIN_LIMIT = 0.1
MOST = 512  # triangles that are looked at
CURE = "effects.large_deformation follows bodies further"
ROUND_OFF = 1e-9  # share of the largest slope of the basis that is none
SMALLEST, GREATEST = 1e-60, 1e60  # m, longest side of a triangle: beyond, squares of areas vanish or overflow
THINNEST = 1e-9  # height of a triangle as a share of its longest side; below, its normal is round-off


@dataclass(frozen=True)
class SurfaceStrainPeak:
    """How far a surface went.

    Attributes:
        rotation: largest |ω|, rad; linear, so that it may pass π.
        strain: largest |principal strain|.
        time: when, s.
    """

    rotation: float = 0.0
    strain: float = 0.0
    time: float = 0.0

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


def warning(seen: SurfaceStrainPeak) -> str:
    """What to say at the moment a limit is passed; empty within the limits."""
    is_at, good_to = _beyond(seen)
    return is_at and (
        f"the surface is {is_at} at t = {seen.time:.4g} s, and a linear model is good to about {good_to}: "
        f"shapes and forces from here on are not to be trusted; {CURE}"
    )


def summary(seen: SurfaceStrainPeak) -> str:
    """What to say of a whole run, whose excursions were joined; empty within the limits."""
    is_at, good_to = _beyond(seen, "up to ")
    return is_at and (
        f"the surface was {is_at}, and a linear model is good to about {good_to}: "
        f"shapes and forces from t = {seen.time:.4g} s on are not to be trusted; {CURE}"
    )


def _beyond(seen: SurfaceStrainPeak, most: str = "") -> tuple[str, str]:
    """What is beyond its limit, and these limits."""
    passed = []
    if seen.rotation > ROTATION_LIMIT:
        turned = f"turned by {most}{seen.rotation:.3g} rad ({math.degrees(seen.rotation):.3g}°)"
        passed.append((turned, f"{ROTATION_LIMIT:g} rad ({math.degrees(ROTATION_LIMIT):.2g}°)"))
    if seen.strain > STRAIN_LIMIT:
        passed.append((f"strained by {most}{100 * seen.strain:.3g} %", f"{100 * STRAIN_LIMIT:g} %"))
    return " and ".join(what for what, _ in passed), " and ".join(limit for _, limit in passed)


class SurfaceGauges:
    """Measures rotation and strain on at most `MOST` triangles of a surface, spread evenly over the list.

    Args:
        nodes: (N, 3), m.
        triangles: (F, 3) corners; those without area are left out.

    Attributes:
        triangles: (g, 3) those that are looked at; of none everything is zero.
    """

    def __init__(self, nodes: Array, triangles: Array):
        chosen = triangles[:: max(1, math.ceil(len(triangles) / MOST))]
        a, b = nodes[chosen[:, 1]] - nodes[chosen[:, 0]], nodes[chosen[:, 2]] - nodes[chosen[:, 0]]
        n = np.cross(a, b)
        longest = np.linalg.norm([a, b, b - a], axis=2).max(axis=0)
        solid = (longest > SMALLEST) & (longest < GREATEST) & (np.linalg.norm(n, axis=1) > THINNEST * longest**2)
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


def largest(components: Array) -> tuple[float, float]:
    """Largest |ω|, rad, and largest |principal strain|, of components (g, 6)."""
    ω, (ε1, ε2, shear) = components[:, :3], components[:, 3:].T
    principal = np.abs(ε1 + ε2) / 2 + np.hypot((ε1 - ε2) / 2, shear / math.sqrt(2))
    return float(np.linalg.norm(ω, axis=1).max(initial=0.0)), float(principal.max(initial=0.0))


def _safe_energy(strained: Array) -> float:
    """Energy with which nothing is beyond its limit, of the rows (g, 2, 3, m) of energy coordinates, J."""
    scale = np.abs(strained).max(initial=0.0)  # squares may overflow, or vanish
    if scale == 0:
        return math.inf
    if not np.isfinite(scale):
        return 0.0
    strained = strained / scale
    ρ2 = np.linalg.eigvalsh(strained @ strained.swapaxes(2, 3))[:, :, -1].max(axis=0, initial=0.0)
    severity = float(scale) * float((np.sqrt(ρ2) / [ROTATION_LIMIT, STRAIN_LIMIT]).max())
    return 0.5 / severity / severity


def basis_rows(rom: Rom) -> Array:
    """Components (6g, k) of the shared basis Q: those of the state q of a contact mode are `basis_rows(rom) @ C @ q`.

    A ROM without a mesh has none, (0, k).
    """
    k = rom.basis.shape[1]
    if len(rom.triangles) == 0:
        return np.empty((0, k))
    gauges = SurfaceGauges(rom.nodes, rom.triangles)
    row = np.full(3 * len(rom.nodes), -1)
    row[rom.free] = np.arange(len(rom.free))
    row = row[3 * gauges.triangles[:, :, None] + np.arange(3)]
    corners = rom.basis[row]  # of 3 N rows only these: a Simulator is made in milliseconds
    corners[row < 0] = 0.0
    return gauges.of_corners(corners).reshape(-1, k)


class ModeGauge:
    """Reads rotation and strain off the state q of one contact mode, and says when there is no need to.

    With q = diag(1/√γ) y, |y|² = qᵀ diag(γ) q is at most 2 E. So no triangle turns by more than ρ √(2E), ρ the largest
    spectral norm of (its rows of ω) diag(1/√γ), and some state does; for strain, whose |ε| bounds the principal
    strains to a factor of at most √2, likewise. No energy bounds a rigid rotation: where there is one, none is safe.

    Args:
        rows: (6g, m) components of the basis W of the contact mode.
        eigenvalues: γ (m,), 1/s².

    Attributes:
        safe_energy: with no more than this stored energy nothing is beyond its limit, J; inf without rows.
    """

    def __init__(self, rows: Array, eigenvalues: Array):
        self._rows = rows
        self.safe_energy = _safe_energy((rows / safe_frequencies(eigenvalues)).reshape(-1, 2, 3, len(eigenvalues)))
        turning = np.abs(rows[:, eigenvalues == 0]).max(initial=0.0)
        if turning > ROUND_OFF * np.abs(rows).max(initial=0.0):  # translations turn nothing but by round-off
            self.safe_energy = 0.0

    def read(self, q: Array) -> tuple[float, float]:
        """Largest |ω|, rad, and largest |principal strain|, of the state q (m,)."""
        return largest((self._rows @ q).reshape(-1, 6))

    def safe_change(self, severity: float) -> float:
        """From a state of this severity, the energy ½ δᵀ diag(γ) δ of a change δ of q that leads beyond no limit, J."""
        return (1 - severity) ** 2 * self.safe_energy if severity < 1 else 0.0
