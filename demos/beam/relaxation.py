"""A law with relaxation for the silicone, found from the recordings without a weight.

In each decade of time the modulus falls by the same share g of the relaxed one: branches of Maxwell, 0.01 to 10 s,
beside the viscosity β. The beam lies on a support before it falls, which holds it a little below level. Its force, and
when it is gone, are found for each release, too.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy import ndarray as Array
from recordings import MARKERS, Recording
from scipy.optimize import least_squares

import fenics_rom as fr
from fenics_rom.mechanics.signals import Signal
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.scene.effects import Viscoelasticity

ORDER = 8  # of the reduced models
FIRST_SEEN = 0.01  # s: the support goes in the frame before


@dataclass(frozen=True)
class Law:
    """How the silicone resists."""

    young: float  # relaxed, Pa
    beta: float  # s
    ratio: float  # g, of each branch
    times: tuple[float, ...]  # of the branches, s

    @property
    def series(self) -> PronySeries:
        """Its branches."""
        return PronySeries((self.ratio,) * len(self.times), self.times)

    def vibrating(self, frequency: float) -> float:
        """Modulus of a vibration (Hz), Pa."""
        return self.young * float(np.real(self.series.modulus(2 * np.pi * frequency)))

    def remaining(self, time: float) -> float:
        """Number of branches that still pull after a time, s."""
        return float(np.exp(-time / np.array(self.times)).sum())

    def after(self, time: float) -> float:
        """Modulus under a load that has acted for a time, Pa: to first order in g, it creeps as it relaxes."""
        return self.young * (1 + self.ratio * self.remaining(time))

    @classmethod
    def of(cls, scene: fr.Scene) -> "Law":
        """That of a scene."""
        effects = scene.effects
        assert effects.viscoelasticity is not None
        assert effects.damping is not None
        young, ratio = scene.materials["material"].young, effects.viscoelasticity.ratios[0]
        return cls(young, effects.damping.beta, ratio, effects.viscoelasticity.times)


@dataclass(frozen=True)
class Falls:
    """How the beam falls from where a support holds it, by a reduced model of the small displacements."""

    scene: fr.Scene
    law: Law

    @cached_property
    def _rom(self) -> fr.Rom:
        return fr.reduce(fr.assemble(self._with_force(0.0)), order=ORDER)

    def _with_force(self, force: float) -> fr.Scene:
        """The scene with the law, and the support's force, N."""
        scene, law = self.scene, self.law
        assert scene.run is not None
        assert scene.effects.damping is not None
        load = replace(scene.run.loads[0], signal=Signal(np.array([0.0, 0.0, force])))
        return replace(
            scene,
            materials={"material": replace(scene.materials["material"], young=law.young)},
            effects=replace(
                scene.effects,
                damping=replace(scene.effects.damping, beta=law.beta),
                viscoelasticity=Viscoelasticity(ratios=law.series.ratios, times=law.times),
            ),
            run=replace(scene.run, loads=(load,)),
        )

    def _heights(self, force: float) -> tuple[Array, Array]:
        """Times from the release, s, and the tip's mean height beside that of the straight beam, m."""
        run = fr.simulate(self._rom, scene=self._with_force(force))
        return run.times - run.times[1], np.mean([run.outputs[name][:, 0, 2] for name in MARKERS], axis=0)

    @cached_property
    def _affine(self) -> tuple[Array, Array, Array]:
        """Times, heights without a support, and what 1 N of it adds."""
        times, free = self._heights(0.0)
        return times, free, self._heights(1.0)[1] - free

    def level(self, force: float) -> float:
        """By how much the support holds the tip below level, m."""
        _, free, push = self._affine
        return -float(free[0] + force * push[0])

    def at(self, times: Array, force: float) -> Array:
        """Heights at some times from the release beside where the tip was held, m."""
        own, free, push = self._affine
        heights = free + force * push
        return np.interp(times, own, heights - heights[0])


@dataclass(frozen=True)
class Found:
    """What was found, with intervals of 95 % by the linearized fit; that residuals correlate in time is counted."""

    law: Law
    forces: Array  # of the support, for each recording, N
    delays: Array  # of each release, s
    levels: Array  # below which the tip was held, for each recording, m
    covariance: Array  # of ln E, ln β, g and the mean level (m), (4, 4)
    residual: float  # root mean square, m

    @property
    def half_widths(self) -> Array:
        """Of ln E, ln β, g and the mean level (m)."""
        return 1.96 * np.sqrt(np.diag(self.covariance))


def find_law(scene: fr.Scene, recordings: list[Recording]) -> Found:
    """The law, supports and releases that bring a scene nearest to recordings without a weight."""
    start, count = Law.of(scene), len(recordings)
    assert scene.run is not None
    force = float(scene.run.loads[0].signal(0.0)[2])
    cache: dict[tuple[float, ...], Falls] = {}

    def falls_at(q: Array) -> Falls:
        key = tuple(q[:3])
        if key not in cache:
            law = replace(start, young=start.young * np.exp(q[0]), beta=start.beta * np.exp(q[1]), ratio=q[2])
            cache[key] = Falls(scene, law)
        return cache[key]

    def residual(q: Array) -> Array:
        parts = []
        for recording, push, delay in zip(recordings, q[3 : 3 + count], q[3 + count :], strict=True):
            seen = recording.times >= FIRST_SEEN
            told = falls_at(q).at(recording.times[seen] - 1e-3 * delay, push)
            parts.append(1e3 * (told - recording.fall[seen]))
        return np.concatenate(parts)

    q0 = np.array([0.0, 0.0, start.ratio, *[force] * count, *[0.0] * count])
    fit = least_squares(residual, q0, x_scale=[0.1, 0.2, 0.02, *[0.02] * count, *[1.0] * count], diff_step=1e-4)
    r, J = fit.fun, fit.jac
    alike = float(r[1:] @ r[:-1] / (r @ r))  # from one frame to the next
    variance = r @ r / (len(r) - len(q0)) * (1 + alike) / (1 - alike)
    falls = falls_at(fit.x)
    levels = np.array([falls.level(push) for push in fit.x[3 : 3 + count]])
    onto = np.eye(4, len(q0))  # the level falls with E as all equilibria do
    onto[3] = [-levels.mean(), 0.0, 0.0, *[(falls.level(1.0) - falls.level(0.0)) / count] * count, *[0.0] * count]
    return Found(
        law=falls.law,
        forces=fit.x[3 : 3 + count],
        delays=1e-3 * fit.x[3 + count :],
        levels=levels,
        covariance=onto @ (variance * np.linalg.inv(J.T @ J)) @ onto.T,
        residual=1e-3 * float(np.sqrt(np.mean(r**2))),
    )
