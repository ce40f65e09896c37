"""The step of `held_step` of a body whose arrays are in a table, as each that is handed over takes time."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit
from fenics_rom.runtime.compiled.arrays_at import cube_at, integers_at, matrix_at, vector_at
from fenics_rom.runtime.compiled.carried_strains import Law, Memory
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.held_step import Body, Step, take_step
from fenics_rom.runtime.compiled.material_points import Points


def arrays_of(body: Body, memory: Memory, motion: tuple[Array, Array], pushed: Array) -> tuple[Array, ...]:
    """What a table has, in its order."""
    law = body.law
    return (*body[:3], *body.loads, *law[5:-1], *law.points, *memory, *motion, pushed)


@jit
def take_step_at(table: Array, numbers: Array, u: Array, halves: Array) -> Step:
    """The same as `take_step` of a body that nothing touches or pulls; numbers are those of its law, (5,)."""
    following = Following(
        integers_at(table[3]), cube_at(table[4]), integers_at(table[5]), matrix_at(table[6]), cube_at(table[7])
    )
    points = Points(matrix_at(table[13]), matrix_at(table[14]))
    law = Law(
        numbers[0],
        numbers[1],
        numbers[2],
        numbers[3],
        numbers[4],
        matrix_at(table[8]),
        matrix_at(table[9]),
        matrix_at(table[10]),
        matrix_at(table[11]),
        matrix_at(table[12]),
        points,
    )
    body = Body(vector_at(table[0]), vector_at(table[1]), matrix_at(table[2]), following, law)
    memory = Memory(
        matrix_at(table[15]),
        matrix_at(table[16]),
        matrix_at(table[17]),
        vector_at(table[18]),
        matrix_at(table[19]),
        cube_at(table[20]),
        matrix_at(table[21]),
    )
    motion = matrix_at(table[22]), matrix_at(table[23])
    return take_step(body, u, halves, vector_at(table[24]), memory, motion[0], motion[1], None, None)
