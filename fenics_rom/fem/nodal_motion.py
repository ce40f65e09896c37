"""A full-order body in its moving frame between two steps, and in the middle of one, by its nodes."""

from typing import NamedTuple

from numpy import ndarray as Array


class Motion(NamedTuple):
    """The body between two steps; fields are those of the nodes here, (n, 3)."""

    r: Array
    Mr: Array
    q: Array
    Mq: Array
    Kq: Array  # (7, n, 3) with the stiffness, and with the six matrices of geometric stiffness
    R: Array  # (3, 3) attitude
    position: Array  # of the origin, m
    v: Array  # of the origin, in the frame's axes, m/s
    ω: Array  # in the frame's axes, rad/s


class Rate(NamedTuple):
    """Mid-step rate of the displacement, (n, 3), and products with it."""

    r: Array
    Mr: Array
    Kr: Array  # (7, n, 3)
    Dr: Array
