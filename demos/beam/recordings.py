"""What the recordings say by themselves: where the tip was, how it rang, and where it came to rest."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray as Array
from scipy.optimize import least_squares

MARKERS = ("tip_1", "tip_2", "tip_3")
WINDOWS = {"alone": (0.12, 0.7), "weight52": (0.25, 1.2)}  # s: some five periods, after what is faster has died away
AT_REST = 0.5  # s, at a recording's end


@dataclass(frozen=True)
class Recording:
    """A release, with displacements from where the tip was held."""

    case: str  # "alone" or "weight52"
    times: Array  # (T,) from the release, s
    moved: Array  # (T, 3 markers, 3), m

    @property
    def fall(self) -> Array:
        """Height of the three markers' mean, (T,), m."""
        return self.moved[:, :, 2].mean(axis=1)

    @property
    def at_rest(self) -> Array:
        """Displacements at the end, (3 markers, 3), m."""
        return self.moved[self.times > self.times[-1] - AT_REST].mean(axis=0)

    @property
    def ringing(self) -> "Ringing":
        """Of the mean height."""
        return Ringing.of(self.times, self.fall, *WINDOWS[self.case])


@dataclass(frozen=True)
class Ringing:
    """A decaying vibration about a middle that creeps as the logarithm of time."""

    frequency: float  # Hz
    decay: float  # 1/s
    middle: float  # after 1 s, m
    creep: float  # of the middle in each e-fold of time, m

    def middle_at(self, time: float) -> float:
        """About which it vibrates, m."""
        return self.middle + self.creep * float(np.log(time))

    @classmethod
    def of(cls, times: Array, height: Array, start: float, stop: float) -> "Ringing":
        """The least-squares fit between two times: frequency and decay by Gauss and Newton, the rest is linear."""
        t, z = (array[(times >= start) & (times <= stop)] for array in (times, height))

        def columns(q: Array) -> Array:
            phase, envelope = 2 * np.pi * q[0] * t, np.exp(-q[1] * (t - start))
            return np.stack([np.ones(len(t)), np.log(t), envelope * np.cos(phase), envelope * np.sin(phase)], axis=1)

        def residual(q: Array) -> Array:
            return 1e3 * (columns(q) @ np.linalg.lstsq(columns(q), z, rcond=None)[0] - z)

        frequencies = np.linspace(2.0, 10.0, 81)
        first = min(frequencies, key=lambda frequency: np.linalg.norm(residual(np.array([frequency, 2.0]))))
        q = least_squares(residual, [first, 2.0]).x
        middle, creep, *_ = np.linalg.lstsq(columns(q), z, rcond=None)[0]
        return cls(float(q[0]), float(q[1]), float(middle), float(creep))


def read_recording(file: Path) -> Recording:
    """Reads one of data/*.csv."""
    with file.open(newline="") as stream:
        values = np.array(list(csv.reader(stream))[1:], dtype=float)
    times, places = values[:, 0], values[:, 1:].reshape(len(values), len(MARKERS), 3)
    return Recording(file.stem.rsplit("_", 1)[0], times, places - places[times < 0].mean(axis=0))
