"""What objects of the package are given is read by somebody: a name that was changed in one place alone is not."""

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest

import fenics_rom

PACKAGE = Path(fenics_rom.__file__).parent
READ_BY_NUMBA = {"_finalized"}


def _unread(trees: Iterable[ast.Module]) -> set[str]:
    """Attributes, as "Class.name", that methods set of self, and nobody reads.

    Private ones are read by methods, of self, of the class or of one that is related to it by inheritance; others by
    anybody, of anything, or by their name in a string.
    """
    nodes = [node for tree in trees for node in ast.walk(tree)]
    classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
    loads = {node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)}
    words = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    given, read = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    above = {node.name: node.name for node in classes}  # one of the family, by which it is known in the end

    def family(name: str) -> str:
        return name if above[name] == name else family(above[name])

    for node in classes:
        for base in node.bases:
            if isinstance(base, ast.Name) and base.id in above:
                above[family(base.id)] = family(node.name)
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id == "self":
                (read if isinstance(part.ctx, ast.Load) else given)[node.name].add(part.attr)
    of_family = defaultdict[str, set[str]](set)
    for name, names in read.items():
        of_family[family(name)] |= names
    return {
        f"{name}.{each}"
        for name, names in given.items()
        for each in names - of_family[family(name)] - READ_BY_NUMBA
        if each.startswith("_") or each not in loads | words
    }


@pytest.mark.slow
def test_what_methods_set_is_read_by_somebody() -> None:
    assert _unread(ast.parse(file.read_text()) for file in PACKAGE.rglob("*.py")) == set()


def test_a_name_that_was_changed_in_one_place_alone_is_found() -> None:
    code = """
class Moving:
    def move(self):
        return self.next_base

class Soft(Moving):
    def begin(self):
        self._base = 1

class Other:
    def end(self):
        self._base, self.told = 1, 2
        return self._base
"""
    assert _unread([ast.parse(code)]) == {"Soft._base", "Other.told"}
