"""Rows of a symmetric table with one vector or two, four rows at once, by instructions of vectors.

Of the same loops over numbers numba makes code that takes twice the time, as it does not know that arrays are apart.
"""

from typing import Any

from numpy import ndarray as Array

from fenics_rom.compilation import can_compile

ROWS = 4  # at once, and of each four numbers; with two vectors all that is added up fits into 16 registers


def add_rows(table: Array, i: int, given: Array, into: Array) -> None:
    """Adds what rows i to i + 4 of a folded table (N, N) make of a vector (N,), or of two (2, N).

    i and N are multiples of four.
    """
    rows, own = table[i : i + ROWS, i:], slice(i, i + ROWS)
    into[..., i:] += given[..., own] @ rows
    into[..., own] += given[..., i:] @ rows.T


if can_compile():
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic, overload

    _LANES, _PLACE = ir.VectorType(ir.DoubleType(), ROWS), ir.IntType(64)
    _FIRST = ir.Constant(ir.VectorType(ir.IntType(32), ROWS), [0] * ROWS)
    _FUSED = ("contract",)

    @intrinsic
    def _add_rows(context: Any, table: Any, i: Any, given: Any, into: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            arrays = (values[0], values[2], values[3])
            matrix, x, y = (
                cgutils.create_struct_proxy(kind)(context, builder, array)
                for kind, array in zip((table, given, into), arrays, strict=True)
            )
            N, start = cgutils.unpack_tuple(builder, matrix.shape, 2)[1], values[1]

            def at(array: Any, row: Any, column: Any) -> Any:
                return builder.gep(array.data, [builder.add(builder.mul(row, N), column)])

            def lanes(place: Any) -> Any:
                return builder.bitcast(place, _LANES.as_pointer())

            def read(array: Any, row: Any, column: Any) -> Any:
                return builder.load(lanes(at(array, row, column)), align=8)

            def added(total: Any, a: Any, b: Any) -> Any:
                return builder.fadd(total, builder.fmul(a, b, flags=_FUSED), flags=_FUSED)

            def in_all_lanes(number: Any) -> Any:
                one = builder.insert_element(ir.Constant(_LANES, ir.Undefined), number, ir.IntType(32)(0))
                return builder.shuffle_vector(one, one, _FIRST)

            vectors, rows = [_PLACE(k) for k in range(given.ndim)], [builder.add(start, _PLACE(r)) for r in range(ROWS)]
            shares = [[in_all_lanes(builder.load(at(x, k, row))) for row in rows] for k in vectors]
            sums = [[cgutils.alloca_once_value(builder, ir.Constant(_LANES, None)) for _ in rows] for _ in vectors]
            with cgutils.for_range_slice(builder, start, N, _PLACE(ROWS)) as (j, _):
                for_all, numbers = [read(y, k, j) for k in vectors], [read(x, k, j) for k in vectors]
                for r, row in enumerate(rows):
                    entries = read(matrix, row, j)
                    for k in range(given.ndim):
                        for_all[k] = added(for_all[k], entries, shares[k][r])
                        builder.store(added(builder.load(sums[k][r]), entries, numbers[k]), sums[k][r])
                for k in range(given.ndim):
                    builder.store(for_all[k], lanes(at(y, vectors[k], j)), align=8)
            for k in range(given.ndim):
                for r, row in enumerate(rows):
                    found, place = builder.load(sums[k][r]), at(y, vectors[k], row)
                    for lane in range(ROWS):
                        number = builder.extract_element(found, ir.IntType(32)(lane))
                        builder.store(builder.fadd(builder.load(place), number), place)
            return context.get_dummy_value()

        return types.void(table, i, given, into), generate

    @overload(add_rows, strict=False)
    def _compiled_add_rows(table: Any, i: Any, given: Any, into: Any) -> Any:
        return lambda table, i, given, into: _add_rows(table, i, given, into)
