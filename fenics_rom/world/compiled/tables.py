"""The arrays of a world, which compiled functions find in one table."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.runtime.compiled.arrays_at import (
    cube_at,
    integer_cube_at,
    integer_rows_at,
    integers_at,
    matrix_at,
    vector_at,
)
from fenics_rom.world.compiled.rigid_bodies import RigidBodies
from fenics_rom.world.compiled.row_tables import Rows

# Kinds of meetings: of a soft body and a rigid shape, of two soft ones; contacts of others are given, and where bodies
# are joined there are none.
GIVEN, SOFT_FIRST, SOFT_SECOND, SOFT_BOTH, JOINED = range(5)
RIGID, DRIVEN, SOFT, FREE = range(4)  # kinds of bodies; soft are those that are held or carried, and free ones
SIZE, RESTITUTION, FRICTION, NO_GAP, OF_RIGID = range(5)  # in `Meetings.numbers`
OF_RESTITUTION, OF_FRICTION, SWUNG, HELPED, OWN, OUT = range(6)  # in `Near.numbers`
MIDDLE, IN_MIDDLE, MEAN, V, SPIN, POWER, AWAY, ASKEW = 0, 3, 12, 21, 24, 27, 28, 29  # in `Driven.step`
COUNT, IS_INVERSE_KNOWN, YIELDS = range(3)  # in `Operators.known`
SUPPLIED, DISSIPATED, BY_OTHERS = range(3)  # in `Owed.bodies`
BY_IMPACTS, BY_FRICTION, BY_JOINTS, NUMERICAL, BY_MOTORS = range(5)  # in `Owed.met`
OF_JOINT = -1  # in place of a meeting
SLIDES = -2  # in place of a feature: the first body is pushed where the point of the second one is
PAIRS, PAIRS_BEFORE, ARRAYS_OF_PAIRS = 37, 71, 16  # where those of a step, and of the step before, are in the table
TAKEN, COUNTED, SWEPT, ENDED = range(4)  # of `take_steps`: how many, contacts and sweeps of the last, and why they end
THRESHOLD, IS_WHOLE, INTERVAL, SINCE, RADIUS, IS_DUE = range(6)  # of `take_steps`, of a soft body


class Bodies(NamedTuple):
    """B of them."""

    kinds: Array  # (B,)
    numbers: Array  # (B,) among those of its kind; of soft and free ones among both
    shapes: Array  # (B, 17), see `mechanics.compiled.shapes`
    radii: Array  # (B,) around them, m
    placed: Array  # (B, 12) rigid ones in the middle of a step: position, then R
    travels: Array  # (B, 4) how far they go as a whole, and a point beside, m
    carriers: Array  # (S,) of soft ones, numbers of those that are driven and carry them; -1: none


class Freedoms(NamedTuple):
    """What rigid bodies that move freely have besides `RigidBodies`, B of them."""

    gravity: Array  # (B, 3), m/s²
    given: Array  # (B, 2, 3): force, N, and torque, N m, of inputs
    quaternion: Array  # (B, 4)
    momentum: Array  # angular (B, 3) about the centre of mass, in world axes
    acceleration: Array  # (B, 3) in the step before
    inverse: Array  # of the inertia, (B, 3, 3)
    size: Array  # (B,) radius around, m
    tries: Array  # (B, 4, 3) as of `rigid_bodies.attempt`
    off: Array  # (B, 12) where the middle of the shape is from the centre of mass, m, and how it is turned


class Driven(NamedTuple):
    """D bodies that move as they are told."""

    start: Array  # (D, 13): position, quaternion and twist
    end: Array  # (D, 13)
    step: Array  # (D, 30): middle of the way, R there, (R + R⁺)/2, v̂ and R ω̂; power, W; gaps as of `world.driven`
    misfit: Array  # (D, 2) the largest gaps
    size: Array  # (D,) m


class Meetings(NamedTuple):
    """Two bodies each that may touch, M of them."""

    bodies: Array  # (M, 2) numbers of the first and the second
    kinds: Array  # (M,)
    numbers: Array  # (M, 5): size of the smaller, m, restitution, friction, gaps that are none, m, if both are rigid
    slots: Array  # (M + 1,) where what is kept of their contacts begins
    margins: Array  # (M,), m, in a step
    are_near: Array  # (M,) whether those that are to be given may be nearer than that


class Kept(NamedTuple):
    """What is kept of contacts from step to step, F of them at most."""

    features: Array  # (F,); -1: none
    forces: Array  # (F, 3) on the first bodies, N
    swung: Array  # (F,) in how many steps in a row friction did not stop them
    dissipated: Array  # (M,) by each meeting, J


class Near(NamedTuple):
    """The pairs of a step, F at most: contacts, then points of joints, of which normals and laws mean nothing."""

    meetings: Array  # (F,)
    features: Array  # (F,); of points of joints as of `Joined.couples`
    slots: Array  # (F,)
    ends: Array  # (F, 2) numbers of the bodies
    rigid: Array  # (F, 2) those among rigid ones that move freely; -1: others
    nodes: Array  # (F, 2, c) of soft bodies, as many as carry a point at most
    weights: Array  # (F, 2, c) of these
    places: Array  # (F, 3) in the middle of the step, m
    normals: Array  # (F, 3)
    gaps: Array  # (F,) when it begins, m
    before: Array  # u (F, 3) when it begins, m/s
    # (F, 6): restitution, friction, in how many steps friction did not stop it, if now it is not to; n·W n, m/s/N, and
    # speeds, m/s, of `speeds_out`
    numbers: Array
    are_rigid: Array  # (F,)
    u: Array  # (F, 3) in its middle, m/s
    forces: Array  # (F, 3) N
    arms: Array  # (F, 2, 3) of rigid bodies at points of joints, in their axes from their centre of mass, m


class Joined(NamedTuple):
    """Points of joints that hold, J of them; as of Near."""

    ends: Array  # (J, 2)
    nodes: Array  # (J, 2, c)
    weights: Array  # (J, 2, c)
    arms: Array  # (J, 2, 3)
    forces: Array  # (J, 3) in the step before, N
    are_stopped: Array  # (J,) whether an impulse takes what velocity is left after a step
    couples: Array  # (J,) which couple, of K, stands for how bodies turn; -1: a point, or SLIDES
    arms_of_turning: Array  # (K, 3 + c, 3) as of `couples.Turning`, in a step


class Operators(NamedTuple):
    """What is kept of the contacts that took part last, K at most."""

    known: Array  # (3,): how many, whether the inverse is known, whether all yield
    slots: Array  # (K,) of these contacts
    nodes: Array  # (K, 2, c) of soft bodies, as many as carry a point at most that is no joint's, and
    weights: Array  # (K, 2, c) of these
    frames: Array  # (S, 64) of soft bodies, as they turned in that step: `soft_bodies.Step.turn`
    soft: Array  # (9 K²,) Wᵀ of soft bodies, as rows of (3k, 3k)
    inverse: Array  # (9 K²,) of it
    whole: Array  # (9 K²,) Wᵀ of all bodies


class Owed(NamedTuple):
    """What steps are to be booked for, J: N of them at most."""

    bodies: Array  # (N, B, 3) of each: supplied, dissipated, and by other bodies
    met: Array  # (N, 5): dissipated by impacts, friction, and in joints; what these miss; by motors


class GivenContacts(NamedTuple):
    """Contacts that are found elsewhere, G of them, by meetings; a table of its own."""

    meetings: Array  # (G,)
    features: Array  # (G,)
    nodes: Array  # (G, 2, c)
    weights: Array  # (G, 2, c)
    places: Array  # (G, 3)
    normals: Array  # (G, 3)
    gaps: Array  # (G,)


class World(NamedTuple):
    """All arrays of a world: what its table is made of, one after the other, is the arrays of each of these."""

    softs: Array  # (S, rows, 4) tables of soft bodies, see `soft_bodies`
    bodies: Bodies
    rigid: RigidBodies
    freedoms: Freedoms
    driven: Driven
    meetings: Meetings
    kept: Kept
    near: Near
    operators: Operators
    owed: Owed
    joined: Joined
    before: Near  # pairs of the step before, or of this one: they change places in the table
    rows: Rows


@jit_part
def is_soft(kind: int) -> bool:
    """Whether a body is, free or not."""
    return kind >= SOFT


@jit_part
def is_followed(bodies: Bodies, near: Near, c: int, side: int) -> bool:
    """Whether a body is pushed at the point of another one: both are free, so that momenta stay to the last bit."""
    return (
        side == 1
        and near.meetings[c] != OF_JOINT
        and bodies.kinds[near.ends[c, 0]] == FREE
        and bodies.kinds[near.ends[c, 1]] == FREE
    )


@jit_part
def softs_at(world: Array) -> Array:
    """(S, rows, 4)."""
    return integer_cube_at(world[0])


@jit_part
def bodies_at(world: Array) -> Bodies:
    """Of a table."""
    t = world[1:]
    kinds, index, carriers = integers_at(t[0]), integers_at(t[1]), integers_at(t[6])
    return Bodies(kinds, index, matrix_at(t[2]), vector_at(t[3]), matrix_at(t[4]), matrix_at(t[5]), carriers)


@jit_part
def rigid_at(world: Array) -> RigidBodies:
    """Of a table."""
    t = world[8:]
    return RigidBodies(vector_at(t[0]), cube_at(t[1]), cube_at(t[2]), cube_at(t[3]), cube_at(t[4]))


@jit_part
def freedoms_at(world: Array) -> Freedoms:
    """Of a table."""
    t = world[13:]
    gravity, given, quaternion, momentum = matrix_at(t[0]), cube_at(t[1]), matrix_at(t[2]), matrix_at(t[3])
    acceleration, inverse, size, tries = matrix_at(t[4]), cube_at(t[5]), vector_at(t[6]), cube_at(t[7])
    return Freedoms(gravity, given, quaternion, momentum, acceleration, inverse, size, tries, matrix_at(t[8]))


@jit_part
def driven_at(world: Array) -> Driven:
    """Of a table."""
    t = world[22:]
    return Driven(matrix_at(t[0]), matrix_at(t[1]), matrix_at(t[2]), matrix_at(t[3]), vector_at(t[4]))


@jit_part
def meetings_at(world: Array) -> Meetings:
    """Of a table."""
    t = world[27:]
    bodies, kinds, numbers = integer_rows_at(t[0]), integers_at(t[1]), matrix_at(t[2])
    return Meetings(bodies, kinds, numbers, integers_at(t[3]), vector_at(t[4]), vector_at(t[5]))


@jit_part
def kept_at(world: Array) -> Kept:
    """Of a table."""
    t = world[33:]
    return Kept(integers_at(t[0]), matrix_at(t[1]), integers_at(t[2]), vector_at(t[3]))


@jit_part
def near_at(world: Array) -> Near:
    """Of a table."""
    t = world[PAIRS:]
    meetings, features, slots = integers_at(t[0]), integers_at(t[1]), integers_at(t[2])
    ends, rigid, nodes, weights = integer_rows_at(t[3]), integer_rows_at(t[4]), integer_cube_at(t[5]), cube_at(t[6])
    places, normals, gaps, before = matrix_at(t[7]), matrix_at(t[8]), vector_at(t[9]), matrix_at(t[10])
    numbers, are_rigid, u, forces = matrix_at(t[11]), vector_at(t[12]), matrix_at(t[13]), matrix_at(t[14])
    arms = cube_at(t[15])
    found = meetings, features, slots, ends, rigid, nodes, weights
    return Near(*found, places, normals, gaps, before, numbers, are_rigid, u, forces, arms)


@jit_part
def operators_at(world: Array) -> Operators:
    """Of a table."""
    t = world[53:]
    known, slots, nodes, weights = vector_at(t[0]), integers_at(t[1]), integer_cube_at(t[2]), cube_at(t[3])
    return Operators(known, slots, nodes, weights, matrix_at(t[4]), vector_at(t[5]), vector_at(t[6]), vector_at(t[7]))


@jit_part
def owed_at(world: Array) -> Owed:
    """Of a table."""
    t = world[61:]
    return Owed(cube_at(t[0]), matrix_at(t[1]))


@jit_part
def joined_at(world: Array) -> Joined:
    """Of a table."""
    t = world[63:]
    ends, nodes, weights, arms = integer_rows_at(t[0]), integer_cube_at(t[1]), cube_at(t[2]), cube_at(t[3])
    return Joined(ends, nodes, weights, arms, matrix_at(t[4]), vector_at(t[5]), integers_at(t[6]), cube_at(t[7]))


@jit_part
def given_at(given: Array) -> GivenContacts:
    """Of a table of contacts that are given."""
    meetings, features, nodes = integers_at(given[0]), integers_at(given[1]), integer_cube_at(given[2])
    weights, places, normals, gaps = cube_at(given[3]), matrix_at(given[4]), matrix_at(given[5]), vector_at(given[6])
    return GivenContacts(meetings, features, nodes, weights, places, normals, gaps)
