"""How compiled functions call others, such that LLVM works on each once or twice.

numba has LLVM work on all that a function calls again in each that calls it: on what is called five deep five times.

`PartCompiler` leaves what is but a part of others to LLVM until it is in one of them that is called by itself.
`at_address` has functions called by their addresses, behind which LLVM does not see. A caller keeps the address in its
own code, and asks Python for it at its first call. So what comes from disk brings what it calls when that is called,
and no sooner. What gives a number or nothing, as its annotation says, is not even compiled before, unless it is to be.
"""

import pickle
from collections.abc import Callable
from ctypes import CFUNCTYPE, c_int64, c_void_p, cast, string_at
from importlib import import_module
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.errors import LoweringError, NumbaError
from numba.core.imputils import impl_ret_new_ref, lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

_made: dict[tuple[str, str], Any] = {}  # numba's dispatchers, by module and name of their functions
_ASKED = "fenics_rom_address_of"
_GIVEN: dict[Any, Any] = {None: types.none, bool: types.boolean, int: types.int64, float: types.float64}
_FAILS = -1  # in place of an address, where numba fails to compile what is called


class PartCompiler(Compiler):
    """Of functions that are parts of others, and are not called by themselves."""

    def compile_extra(self, func: Any) -> Any:
        """As numba's, into code that is to be linked."""
        self.state.library = _Part(self.state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _Part(JITCodeLibrary):
    """The code of such a function, to be linked: it is not made better, nor made machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """There is none."""
        return 0

    @property
    def codegen(self) -> Any:
        """What numba tells where constants of Python are, which no part has."""
        return _Constants(self._codegen)


class _Constants:
    def __init__(self, codegen: Any):
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, constants: Any) -> None:
        """They are set with the code that the function is a part of."""


def at_address(function: Callable[..., object], dispatcher: Any, ahead: bool) -> None:
    """Has compiled functions call another one by its address.

    Args:
        function: to be called by its name, with arguments by position, from a module that can be imported.
        dispatcher: numba's, of this function.
        ahead: whether it is compiled before those that call it, whatever it gives.
    """
    name = function.__module__, function.__qualname__
    _made[name] = dispatcher

    class Call(AbstractTemplate):
        """Of this function."""

        key = function

        def generic(self, given: Any, named: Any) -> Any:
            if named:
                raise TypeError(f"{name[1]}: use arguments by position")
            kinds = tuple(map(types.unliteral, given))
            gives = None if ahead else _GIVEN.get(function.__annotations__.get("return", function))
            return signature(gives or _compiled(dispatcher, kinds).signature.return_type, *kinds)

    def generate(context: Any, builder: Any, of: Any, given: Any) -> Any:
        kind = context.call_conv.get_function_type(of.return_type, of.args)
        address = _address(builder, name, of.args)
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, address)):  # as Python was interrupted
            context.call_conv.return_user_exc(builder, RuntimeError, (f"{name[1]} could not be read",))
        fails = builder.icmp_signed("==", address, ir.Constant(address.type, _FAILS))
        with cgutils.if_unlikely(builder, fails):
            context.call_conv.return_user_exc(builder, LoweringError, (f"{name[1]} is not compiled",))
        called = builder.inttoptr(address, kind.as_pointer())
        status, result = context.call_conv.call_function(builder, called, of.return_type, of.args, given)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return impl_ret_new_ref(context, builder, of.return_type, result)

    infer_global(function, types.Function(Call))
    lower_builtin(function, types.VarArg(types.Any))(generate)


def _compiled(dispatcher: Any, kinds: tuple[Any, ...]) -> Any:
    dispatcher.compile(kinds)
    return dispatcher.overloads[kinds]


def _address(builder: Any, name: tuple[str, str], kinds: tuple[Any, ...]) -> Any:
    """What is called, kept by the code that calls it."""
    whole, asked = ir.IntType(64), pickle.dumps((name, kinds))
    kept = cgutils.add_global_variable(builder.module, whole, builder.module.get_unique_name("address"))
    kept.linkage, kept.initializer = "internal", ir.Constant(whole, 0)
    with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(kept))):
        text = cgutils.global_constant(builder, "called", cgutils.make_bytearray(asked))
        text.linkage = "internal"
        kind = ir.FunctionType(whole, [cgutils.voidptr_t, whole])
        ask = cgutils.get_or_insert_function(builder.module, kind, _ASKED)
        given = builder.bitcast(text, cgutils.voidptr_t), ir.Constant(whole, len(asked))
        builder.store(builder.call(ask, given), kept)
    return builder.load(kept)


def _find(text: int, length: int) -> int:
    """The address of what is asked for; it is compiled, or read, if it is not there yet."""
    (module, name), kinds = pickle.loads(string_at(text, length))
    import_module(module)
    dispatcher = _made[module, name]
    try:
        made = _compiled(dispatcher, kinds)
    except NumbaError:
        return _FAILS
    gives = _GIVEN.get(dispatcher.py_func.__annotations__.get("return", name))
    if gives not in (None, made.signature.return_type):
        raise TypeError(f"{name} is said to give {gives}, and gives {made.signature.return_type}")
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


_found = CFUNCTYPE(c_int64, c_void_p, c_int64)(_find)  # kept, as compiled functions have but its address
llvm.add_symbol(_ASKED, cast(_found, c_void_p).value)
