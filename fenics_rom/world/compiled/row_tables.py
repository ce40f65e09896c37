"""Arrays of the rows of joints, where these are not all points alone: `world.joint_rows`."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.runtime.compiled.arrays_at import cube_at, integer_rows_at, integers_at, matrix_at, vector_at

FIXED, AT_START, ALONG, TURNING, FOLLOWING = range(5)  # kinds of entries
HELD, COMPLIANCE, TARGET_SPEED, KNOWN, FORCE = range(5)  # in `Rows.numbers`
ROWS = 87  # where these arrays are in the table of a world
MOTION, FORCED = 0, 1  # in `Rows.maps`


class Rows(NamedTuple):
    """R rows of joints, island after island. An entry, of E, is what a row has to do with a pair."""

    begins: Array  # (R + 1,) of entries
    pairs: Array  # (E,) among points of joints
    kinds: Array  # (E,)
    leaders: Array  # (E,) of FOLLOWING: the entry that it is a share of
    basis: Array  # (E, 3) in the axes of the first body, or of the world; of FOLLOWING the share
    D: Array  # (E, 3) directions as bodies were tried last
    bodies: Array  # (R, 4) rigid ones that move freely, which a row moves; -1: none
    of_bodies: Array  # (B + 1,) where rows of each body begin among
    rows_of_bodies: Array  # (N, 2) rows, and the place of the body in `bodies`
    soft: Array  # (N, 2) rows and entries that are at soft bodies
    islands: Array  # (I + 1,) where rows of each begin
    reach: Array  # (R,) the last row that one, or one before it, moves in its island
    squares: Array  # (I + 1,) where its matrix begins
    matrix: Array  # (N,) factors of these
    idle: Array  # (N,) and as of `joints.Factor` where they are singular
    order: Array  # (R,)
    ranks: Array  # (I, 2) how many rows are held, and the rank; -1: as many, and no pivots are needed
    scale: Array  # (R,)
    numbers: Array  # (5, R) whether it is held, its compliance, speed and known force; force in the last try
    maps: Array  # (2, R, 24) of velocities of the four bodies, and of forces on them
    driven: Array  # (Q,) rows that drives act along
    drives: Array  # (Q, 11) as of `drive_law`
    states: Array  # (Q, 6)
    pieces: Array  # (Q, 12, 7)
    on: Array  # (Q, 2) how many pieces there are, and which one a drive is on
    slides: Array  # points of joints where the first body is pushed where that of the second one is
    turns: Array  # (B,) rigid bodies, in the order in which they are tried: second ones of these before first ones


@jit_part
def rows_at(world: Array) -> Rows:
    """Of the table of a world."""
    t = world[ROWS:]
    begins, pairs, kinds, leaders = integers_at(t[0]), integers_at(t[1]), integers_at(t[2]), integers_at(t[3])
    basis, D, bodies, of_bodies = matrix_at(t[4]), matrix_at(t[5]), integer_rows_at(t[6]), integers_at(t[7])
    rows_of_bodies, soft, islands = integer_rows_at(t[8]), integer_rows_at(t[9]), integers_at(t[10])
    reach, squares, matrix, idle = integers_at(t[11]), integers_at(t[12]), vector_at(t[13]), vector_at(t[14])
    order, ranks, scale, numbers = integers_at(t[15]), integer_rows_at(t[16]), vector_at(t[17]), matrix_at(t[18])
    maps, driven, drives, states = cube_at(t[19]), integers_at(t[20]), matrix_at(t[21]), matrix_at(t[22])
    pieces, on, slides, turns = cube_at(t[23]), integer_rows_at(t[24]), integers_at(t[25]), integers_at(t[26])
    of_rows = begins, pairs, kinds, leaders, basis, D, bodies, of_bodies, rows_of_bodies, soft
    of_islands = islands, reach, squares, matrix, idle, order, ranks, scale, numbers, maps
    return Rows(*of_rows, *of_islands, driven, drives, states, pieces, on, slides, turns)
