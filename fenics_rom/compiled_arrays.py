"""Arrays in compiled functions of which nobody counts who holds them: whoever has made one keeps it.

numba counts an array at every turn, in one step for all threads, which takes longer than the arithmetic of a small
array. In Python, which counts by itself, these functions give the same.
"""

from typing import Any

from numpy import ndarray as Array

from fenics_rom.compilation import can_compile


def unowned(given: Any) -> Any:
    """The same array, or tuple with arrays, uncounted."""
    return given


def flat(array: Array) -> Array:
    """The numbers of an array in one piece, (size,), uncounted."""
    return array.reshape(array.size)


carray: Any = None  # these in compiled functions alone: an array (..) of what is at a pointer,
floats: Any = None  # and what makes an address a pointer to floats,
integers: Any = None  # and to whole numbers,
flags: Any = None  # and to booleans,
address_of: Any = None  # and where the numbers of an array begin
float_of: Any = None  # and the number whose bits these are

if can_compile():
    import numba
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic, overload

    def _pointer_to(kind: Any) -> Any:
        def pointer(context: Any, address: Any) -> Any:
            def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
                return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

            return types.CPointer(kind)(types.int64), generate

        return intrinsic(pointer)

    @intrinsic
    def _address_of(context: Any, array: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            made = cgutils.create_struct_proxy(array)(context, builder, given[0])
            return builder.ptrtoint(made.data, context.get_value_type(types.int64))

        return types.int64(array), generate

    @intrinsic
    def _float_of(context: Any, bits: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.bitcast(given[0], context.get_value_type(types.float64))

        return types.float64(types.int64), generate

    carray, address_of, float_of = numba.carray, _address_of, _float_of
    floats, integers, flags = map(_pointer_to, (types.float64, types.int64, types.boolean))

    @intrinsic
    def _unowned(context: Any, given: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return _stripped(context, builder, given, values[0])

        return given(given), generate

    @intrinsic
    def _flat(context: Any, array: Any) -> Any:
        kind = types.Array(array.dtype, 1, "C")

        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            of = cgutils.create_struct_proxy(array)(context, builder, given[0])
            made = cgutils.create_struct_proxy(kind)(context, builder)
            made.data, made.nitems, made.itemsize = of.data, of.nitems, of.itemsize
            made.shape, made.strides = (cgutils.pack_array(builder, [each]) for each in (of.nitems, of.itemsize))
            made.meminfo, made.parent = (cgutils.get_null_value(each.type) for each in (made.meminfo, made.parent))
            return made._getvalue()

        return kind(array), generate

    def _stripped(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = cgutils.create_struct_proxy(kind)(context, builder, value)
            array.meminfo, array.parent = (cgutils.get_null_value(each.type) for each in (array.meminfo, array.parent))
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            parts = zip(kind, cgutils.unpack_tuple(builder, value, len(kind)), strict=True)
            return context.make_tuple(builder, kind, [_stripped(context, builder, *part) for part in parts])
        return value

    @overload(unowned, strict=False)
    def _compiled_unowned(given: Any) -> Any:
        return lambda given: _unowned(given)

    @overload(flat, strict=False)
    def _compiled_flat(array: Any) -> Any:
        return lambda array: _flat(array)
