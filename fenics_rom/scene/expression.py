"""A field over the body that a scene says by a text, such as "sqrt(x**2 + y**2) + z"."""

import ast
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.scene.values import Refused, Value

NAMES = ("x", "y", "z")
CONSTANTS = {"pi": np.pi}
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    **{name: (getattr(np, name), 1) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "abs")},
    **{"min": (np.minimum, 2), "max": (np.maximum, 2), "atan2": (np.arctan2, 2), "where": (np.where, 3)},
}
OPERATIONS: dict[type, Callable[..., Any]] = {
    **{ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power},
    **{ast.USub: np.negative, ast.UAdd: np.positive},
    **{ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal},
}
LONGEST = 1000


@dataclass(frozen=True)
class Expression(Value):
    """A text of x, y and z (m), numbers, pi, + - * / **, < <= > >= and functions of `FUNCTIONS`."""

    allowed = (
        f"a text of numbers, x, y, z (m), pi, + - * / **, < <= > >= and {', '.join(FUNCTIONS)}, such as "
        '"20 + 100 * sqrt(x**2 + y**2)"'
    )

    def checked(self, value: Any) -> str:
        """See Value."""
        if not isinstance(value, str) or not value.strip():
            raise Refused(f" = {value!r}: use {self.allowed}")
        evaluated(value, np.zeros((0, 3)))
        return value


def evaluated(text: str, places: Array) -> Array:
    """The numbers (P,) of an expression at places (P, 3), m; Refused where it is none."""
    try:
        if len(text) > LONGEST:
            raise SyntaxError("too long")
        tree = ast.parse(text.strip(), mode="eval").body
        with np.errstate(all="ignore"):  # the caller looks at what is not finite
            found = _value(tree, dict(zip(NAMES, places.T, strict=True)) | CONSTANTS)
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError, TypeError) as error:
        raise Refused(f" = {text[:LONGEST]!r}: {error}; use {Expression.allowed}") from None
    return np.broadcast_to(np.asarray(found, dtype=float), (len(places),)).copy()


def _value(node: ast.expr, known: dict[str, Any]) -> Any:
    """What a part of an expression is worth; ValueError where it is none."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.Name) and node.id in known:
        return known[node.id]
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATIONS:
        return OPERATIONS[type(node.op)](_value(node.left, known), _value(node.right, known))
    if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATIONS:
        return OPERATIONS[type(node.op)](_value(node.operand, known))
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATIONS:
        return OPERATIONS[type(node.ops[0])](_value(node.left, known), _value(node.comparators[0], known))
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in FUNCTIONS
        and not node.keywords
    ):
        function, count = FUNCTIONS[node.func.id]
        if len(node.args) != count:
            raise ValueError(f"{node.func.id} takes {count} argument{'s' * (count > 1)} (got {len(node.args)})")
        return function(*(_value(part, known) for part in node.args))
    raise ValueError(f"{ast.unparse(node)!r} is no part of it")
