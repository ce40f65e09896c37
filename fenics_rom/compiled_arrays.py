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
    from numba.core.imputils import lower_builtin
    from numba.core.typing.templates import AbstractTemplate, infer_global, signature
    from numba.extending import intrinsic

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

    def _written(function: Any, kind_of: Any, write: Any) -> None:
        """Has a function of one argument be what is written, for all kinds: nothing is compiled for each."""

        class Call(AbstractTemplate):
            """Of this function."""

            key = function

            def generic(self, given: Any, named: Any) -> Any:
                return signature(kind_of(given[0]), *given)

        infer_global(function, types.Function(Call))
        lower_builtin(function, types.VarArg(types.Any))(write)

    def _unowned(context: Any, builder: Any, of: Any, given: Any) -> Any:
        return _stripped(context, builder, of.return_type, given[0])

    def _flat(context: Any, builder: Any, of: Any, given: Any) -> Any:
        array = cgutils.create_struct_proxy(of.args[0])(context, builder, given[0])
        made = cgutils.create_struct_proxy(of.return_type)(context, builder)
        made.data, made.nitems, made.itemsize = array.data, array.nitems, array.itemsize
        made.shape, made.strides = (cgutils.pack_array(builder, [each]) for each in (array.nitems, array.itemsize))
        made.meminfo, made.parent = (cgutils.get_null_value(each.type) for each in (made.meminfo, made.parent))
        return made._getvalue()

    def _stripped(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = cgutils.create_struct_proxy(kind)(context, builder, value)
            array.meminfo, array.parent = (cgutils.get_null_value(each.type) for each in (array.meminfo, array.parent))
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            parts = zip(kind, cgutils.unpack_tuple(builder, value, len(kind)), strict=True)
            return context.make_tuple(builder, kind, [_stripped(context, builder, *part) for part in parts])
        return value

    _written(unowned, lambda given: given, _unowned)
    _written(flat, lambda array: types.Array(array.dtype, 1, "C"), _flat)
