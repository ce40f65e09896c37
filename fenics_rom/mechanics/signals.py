"""What a load or an obstacle does over time: numbers that stay, or straight lines between given times."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Union

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, shown

if TYPE_CHECKING:
    from numpy.typing import ArrayLike  # which takes longer to import than all of the rest here


FLOAT = np.dtype(float)
SEVERAL = (list, tuple)
NO_NUMBERS = str, bytes, type(None)  # which Python would make numbers of, or NumPy NaN


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers that are constant, or given at some times with straight lines between them.

    Attributes:
        values: (w,) where they are constant, else (T, w).
        times: (T,) strictly increasing, s; None where they are constant. Before the first and after the last of them
            the first and the last values hold.
    """

    values: Array
    times: Array | None = None

    def __call__(self, time: float) -> Array:
        """The numbers (w,) at a time, s."""
        if self.times is None:
            return self.values
        return np.array([np.interp(time, self.times, column) for column in self.values.T])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Signal):
            return NotImplemented
        if (self.times is None) != (other.times is None) or not np.array_equal(self.values, other.values):
            return False
        return self.times is None or other.times is None or np.array_equal(self.times, other.times)

    @property
    def width(self) -> int:
        """How many numbers."""
        return self.values.shape[-1]

    def scaled(self, factor: float) -> "Signal":
        """The signal times a number."""
        return Signal(factor * self.values, self.times)


SignalLike = Union[Signal, "ArrayLike", Callable[[float], "ArrayLike"]]  # a function is of time in s


def real_numbers(value: "ArrayLike | Mapping[str, Any]") -> Array:
    """An array of floats.

    Raises:
        TypeError, ValueError: it is not of real numbers; NumPy alone would take real parts of complex ones, numbers in
            texts, times, and what a mask hides.
    """
    array, several = np.asarray(value), isinstance(value, SEVERAL)
    if several and array.dtype is FLOAT and array.ndim < 2:  # as most often
        return array
    kind = array.dtype.kind
    if kind not in "fiub" and (kind != "O" or any(isinstance(part, NO_NUMBERS) for part in array.flat)):
        raise TypeError(f"of type {array.dtype}")
    parts: Any = value if several else [value]
    if type(value) is not np.ndarray and any(map(hides_numbers, parts)):
        raise ValueError("masked")
    try:
        return array.astype(float)
    except OverflowError as error:  # a whole number beyond 1e308
        raise ValueError("too large") from error


def hides_numbers(value: object) -> bool:
    """Whether it is an array that masks some of its numbers."""
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def real_numbers_or_nan(value: "ArrayLike") -> Array:
    """The same; NaN where it is not of real numbers, for those who then refuse what is not finite."""
    try:
        return real_numbers(value)
    except (TypeError, ValueError):
        return np.array(np.nan)


class CheckedSignal:
    """A signal that must give so many finite numbers, wherever they come from, or be refused by its name.

    Raises:
        StepError: it gives something else.
    """

    def __init__(self, name: str, width: int, signal: SignalLike):
        self._name, self._width = name, width
        if isinstance(signal, Signal) and signal.times is None:
            signal = signal.values
        self._function = signal if callable(signal) else None
        self._constant = np.empty(0) if callable(signal) else self._checked(signal)

    @property
    def is_constant(self) -> bool:
        """Whether it is no function of time."""
        return self._function is None

    def at(self, time: float) -> Array:
        """The numbers (w,) at a time, s."""
        if self._function is None:
            return self._constant
        value: Any = self._function(time)
        is_plain = type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (self._width,)
        return value if is_plain and value.dot(value) < math.inf else self._checked(value)  # all finite, as most often

    def _checked(self, value: "ArrayLike") -> Array:
        try:
            numbers = real_numbers(value).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if len(numbers) != self._width or not np.isfinite(numbers).all():
            allowed = "a finite number" if self._width == 1 else f"{self._width} finite numbers"
            raise StepError(f"{self._name} = {shown(value)}: use {allowed}, or a function of time that gives it")
        return numbers
