"""What is done with four rows of a matrix at once, or many pairs of numbers, by instructions of vectors.

Of the same loops over numbers numba makes code that takes twice the time, as it does not know that arrays are apart.
"""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import can_compile

ROWS = 4  # at once; of `add_rows` each four numbers: with two vectors all that is added up fits into 16 registers
LANES = 8  # numbers at once of `subtract_rows` and `turn_pairs`


def add_rows(table: Array, i: int, given: Array, into: Array) -> None:
    """Adds what rows i to i + 4 of a folded table (N, N) make of a vector (N,), or of two (2, N).

    i and N are multiples of four.
    """
    rows, own = table[i : i + ROWS, i:], slice(i, i + ROWS)
    into[..., i:] += given[..., own] @ rows
    into[..., own] += given[..., i:] @ rows.T


def subtract_rows(A: Array, i: int, k: int, first: int, shares: tuple[float, ...]) -> None:
    """Takes shares (4, 4), row after row, of rows k to k + 4 of a matrix from rows i to i + 4, from a column on.

    That, and the width, are full lanes.
    """
    A[i : i + ROWS, first:] -= np.reshape(shares, (ROWS, ROWS)) @ A[k : k + ROWS, first:]


def subtract_before(A: Array, k: int, first: int, shares: tuple[float, ...]) -> None:
    """The same of rows k to k + 4 among themselves: takes from each, in order, shares of those before it."""
    for n, of in enumerate(np.reshape(shares, (ROWS, ROWS))):
        A[k + n, first:] -= of[:n] @ A[k : k + n, first:]


def turn_pairs(turn: Array, states: Array, here: int, pushed: Array, k: int) -> float:
    """Sets the other row of states (2, n) to shares (2, n) of the numbers of one row and of those beside them in pairs.

    Row k of `pushed` is added. n is even and at least LANES. Returns what the sum of the squares of the former is no
    larger than: those of the last lanes may be in it twice.
    """
    before = states[here]
    states[1 - here] = turn[0] * before + turn[1] * before.reshape(-1, 2)[:, ::-1].ravel() + pushed[k]
    return float(before @ before)


def copy_into(to: Array, row: int, first: int, of: Array, k: int, count: int) -> None:
    """Copies the first numbers of row k of a matrix into a row of another one, from a column on."""
    to[row, first : first + count] = of[k, :count]


def add_row_of_blocks(row: int, starts: Array, columns: Array, blocks: Array, x: Array, y: Array) -> None:
    """Adds to rows 3 row to 3 row + 3 of y (.., k) those of A x, of a sparse matrix A of 3 x 3 blocks.

    Of row r it has blocks (b, 3, 3) from starts[r] to starts[r + 1], in columns of three. k is full lanes.
    """
    for entry in range(starts[row], starts[row + 1]):
        y[3 * row : 3 * row + 3] += blocks[entry] @ x[3 * columns[entry] : 3 * columns[entry] + 3]


if can_compile():
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic, overload

    _LANES, _PLACE = ir.VectorType(ir.DoubleType(), ROWS), ir.IntType(64)
    _FUSED = ("contract",)

    def _added(builder: Any, total: Any, a: Any, b: Any) -> Any:
        return builder.fadd(total, builder.fmul(a, b, flags=_FUSED), flags=_FUSED)

    def _in_all(builder: Any, number: Any, lanes: Any) -> Any:
        one = builder.insert_element(ir.Constant(lanes, ir.Undefined), number, ir.IntType(32)(0))
        first = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
        return builder.shuffle_vector(one, one, first)

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
                return _added(builder, total, a, b)

            def in_all_lanes(number: Any) -> Any:
                return _in_all(builder, number, _LANES)

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

    def _subtract(builder: Any, within: bool, array: Any, to: Any, of: Any, start: Any, given: Any) -> None:
        lanes = ir.VectorType(ir.DoubleType(), LANES)
        width = cgutils.unpack_tuple(builder, array.shape, 2)[1]

        def at(row: Any, column: Any) -> Any:
            place = builder.gep(array.data, [builder.add(builder.mul(row, width), column)])
            return builder.bitcast(place, lanes.as_pointer())

        less = [_in_all(builder, builder.fneg(builder.extract_value(given, n)), lanes) for n in range(ROWS**2)]
        rows, into = ([builder.add(begin, _PLACE(r)) for r in range(ROWS)] for begin in (of, to))
        with cgutils.for_range_slice(builder, start, width, _PLACE(LANES)) as (j, _):
            of_rows = [builder.load(at(row, j), align=8) for row in rows]
            for n in range(1 if within else 0, ROWS):
                total = of_rows[n] if within else builder.load(at(into[n], j), align=8)
                for m in range(n if within else ROWS):
                    total = _added(builder, total, of_rows[m], less[ROWS * n + m])
                builder.store(total, at(into[n], j), align=8)
                if within:
                    of_rows[n] = total

    @intrinsic
    def _subtract_rows(context: Any, A: Any, i: Any, k: Any, first: Any, shares: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            array, *given = values
            _subtract(builder, False, cgutils.create_struct_proxy(A)(context, builder, array), *given)
            return context.get_dummy_value()

        return types.void(A, i, k, first, shares), generate

    @intrinsic
    def _subtract_before(context: Any, A: Any, k: Any, first: Any, shares: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            array, of, *given = values
            _subtract(builder, True, cgutils.create_struct_proxy(A)(context, builder, array), of, of, *given)
            return context.get_dummy_value()

        return types.void(A, k, first, shares), generate

    @overload(subtract_rows, strict=False)
    def _compiled_subtract_rows(A: Any, i: Any, k: Any, first: Any, shares: Any) -> Any:
        return lambda A, i, k, first, shares: _subtract_rows(A, i, k, first, shares)

    @overload(subtract_before, strict=False)
    def _compiled_subtract_before(A: Any, k: Any, first: Any, shares: Any) -> Any:
        return lambda A, k, first, shares: _subtract_before(A, k, first, shares)

    @intrinsic
    def _turn_pairs(context: Any, turn: Any, states: Any, here: Any, pushed: Any, k: Any) -> Any:
        lanes = ir.VectorType(ir.DoubleType(), LANES)
        beside = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [lane ^ 1 for lane in range(LANES)])

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            shares, numbers, forces = (
                cgutils.create_struct_proxy(kind)(context, builder, values[place])
                for kind, place in ((turn, 0), (states, 1), (pushed, 3))
            )
            n = cgutils.unpack_tuple(builder, shares.shape, 2)[1]
            one, other, forced = (
                builder.mul(row, n) for row in (values[2], builder.sub(_PLACE(1), values[2]), values[4])
            )
            last = builder.sub(n, _PLACE(LANES))  # lanes that overlap others do the same again

            def at(array: Any, row: Any, column: Any) -> Any:
                return builder.bitcast(builder.gep(array.data, [builder.add(row, column)]), lanes.as_pointer())

            def read(array: Any, row: Any, column: Any) -> Any:
                return builder.load(at(array, row, column), align=8)

            total = cgutils.alloca_once_value(builder, ir.Constant(lanes, None))
            builder.store(ir.Constant(lanes, None), total)
            with cgutils.for_range_slice(builder, _PLACE(0), n, _PLACE(LANES)) as (begin, _):
                j = builder.select(builder.icmp_signed("<", begin, last), begin, last)
                before = read(numbers, one, j)
                swapped = builder.shuffle_vector(before, before, beside)
                after = _added(builder, read(forces, forced, j), read(shares, _PLACE(0), j), before)
                builder.store(_added(builder, after, read(shares, n, j), swapped), at(numbers, other, j), align=8)
                builder.store(_added(builder, builder.load(total), before, before), total)
            found, added = builder.load(total), ir.Constant(ir.DoubleType(), 0.0)
            for lane in range(LANES):
                added = builder.fadd(added, builder.extract_element(found, ir.IntType(32)(lane)))
            return added

        return types.float64(turn, states, here, pushed, k), generate

    @overload(turn_pairs, strict=False)
    def _compiled_turn_pairs(turn: Any, states: Any, here: Any, pushed: Any, k: Any) -> Any:
        return lambda turn, states, here, pushed, k: _turn_pairs(turn, states, here, pushed, k)

    @intrinsic
    def _copy_into(context: Any, to: Any, row: Any, first: Any, of: Any, k: Any, count: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            def at(kind: Any, array: Any, row: Any, column: Any) -> Any:
                matrix = cgutils.create_struct_proxy(kind)(context, builder, array)
                width = cgutils.unpack_tuple(builder, matrix.shape, 2)[1]
                return builder.gep(matrix.data, [builder.add(builder.mul(row, width), column)])

            target, row, column, source, k, count = values
            cgutils.raw_memcpy(builder, at(to, target, row, column), at(of, source, k, _PLACE(0)), count, 8)
            return context.get_dummy_value()

        return types.void(to, row, first, of, k, count), generate

    @overload(copy_into, strict=False)
    def _compiled_copy_into(to: Any, row: Any, first: Any, of: Any, k: Any, count: Any) -> Any:
        return lambda to, row, first, of, k, count: _copy_into(to, row, first, of, k, count)

    @intrinsic
    def _add_row_of_blocks(context: Any, row: Any, starts: Any, columns: Any, blocks: Any, x: Any, y: Any) -> Any:
        number = ir.FloatType() if x.dtype == types.float32 else ir.DoubleType()
        lanes, size = ir.VectorType(number, LANES), x.dtype.bitwidth // 8

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            begins, places, entries, given, into = (
                cgutils.create_struct_proxy(kind)(context, builder, value)
                for kind, value in zip((starts, columns, blocks, x, y), values[1:], strict=True)
            )
            width = cgutils.unpack_tuple(builder, given.shape, 2)[1]

            def index(array: Any, at: Any) -> Any:
                return builder.sext(builder.load(builder.gep(array.data, [at])), _PLACE)

            def at(array: Any, row: Any, column: Any) -> Any:
                place = builder.gep(array.data, [builder.add(builder.mul(row, width), column)])
                return builder.bitcast(place, lanes.as_pointer())

            def three(first: Any) -> list[Any]:
                return [builder.add(builder.mul(first, _PLACE(3)), _PLACE(r)) for r in range(3)]

            first, last = index(begins, values[0]), index(begins, builder.add(values[0], _PLACE(1)))
            rows = three(values[0])
            with cgutils.for_range_slice(builder, _PLACE(0), width, _PLACE(LANES)) as (j, _):
                sums = [cgutils.alloca_once(builder, lanes) for _ in rows]
                for r in range(3):
                    builder.store(builder.load(at(into, rows[r], j), align=size), sums[r])
                with cgutils.for_range_slice(builder, first, last, _PLACE(1)) as (entry, _):
                    of = [builder.load(at(given, row, j), align=size) for row in three(index(places, entry))]
                    begin = builder.mul(entry, _PLACE(9))
                    for r in range(3):
                        total = builder.load(sums[r])
                        for c in range(3):
                            share = builder.load(builder.gep(entries.data, [builder.add(begin, _PLACE(3 * r + c))]))
                            total = _added(builder, total, _in_all(builder, share, lanes), of[c])
                        builder.store(total, sums[r])
                for r in range(3):
                    builder.store(builder.load(sums[r]), at(into, rows[r], j), align=size)
            return context.get_dummy_value()

        return types.void(row, starts, columns, blocks, x, y), generate

    @overload(add_row_of_blocks, strict=False)
    def _compiled_add_row_of_blocks(row: Any, starts: Any, columns: Any, blocks: Any, x: Any, y: Any) -> Any:
        return lambda row, starts, columns, blocks, x, y: _add_row_of_blocks(row, starts, columns, blocks, x, y)
