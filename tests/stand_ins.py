"""Whatever stands in for a part of ours in a test is called as that part is, or the call fails as the part's would.

A stand-in that takes what the part would refuse hides a wrong call: `monkeypatch.setattr` is watched (conftest.py).
"""

import functools
import inspect
import pkgutil
from pathlib import Path

PROJECT = Path(__file__).parents[1]
OURS = (PROJECT / "fenics_rom", PROJECT / "demos")
MISSING = object()


def checked(part, stand_in, name):
    """What may stand in for a part: a class derived from it, a value of its type, a function called as it is,
    or for a module an object with functions that it has.

    Raises:
        TypeError: it is of another kind.
    """
    if inspect.isclass(part) and inspect.isclass(stand_in):
        if not issubclass(stand_in, part):
            raise TypeError(f"{stand_in} stands in for the class {name}, and is not derived from it")
        return stand_in
    if inspect.ismodule(part):
        public = [key for key in dir(stand_in) if not key.startswith("_") and callable(getattr(stand_in, key))]
        absent = [key for key in public if not hasattr(part, key)]
        if absent:
            raise TypeError(f"{stand_in!r} stands in for the module {name}, which has no {', '.join(absent)}")
        return stand_in
    if not callable(part):
        if not isinstance(stand_in, type(part)):
            raise TypeError(f"{stand_in!r} stands in for {name}, which is of type {type(part).__name__}")
        return stand_in
    if not callable(stand_in):
        raise TypeError(f"{stand_in!r} stands in for {name}, which is called")
    signature = inspect.signature(part)

    @functools.wraps(stand_in)
    def called(*arguments, **options):
        signature.bind(*arguments, **options)
        return stand_in(*arguments, **options)

    called.__signature__ = signature  # also for a stand-in of this one
    called.is_ours = True
    return called


def replace(module, name, stand_in):
    """In a script that pytest does not run, and that has no monkeypatch."""
    setattr(module, name, checked(getattr(module, name), stand_in, f"{module.__name__}.{name}"))


def is_ours(target, part):
    """Whether a part is defined in this project; of a value, whether what holds it is."""
    if getattr(part, "is_ours", False):
        return True
    try:
        file = inspect.getsourcefile(part if callable(part) else inspect.getmodule(target))
    except TypeError:  # of something that is built into Python
        return False
    return file is not None and any(folder in Path(file).resolve().parents for folder in OURS)


def watch(setattr_of_pytest):
    """`MonkeyPatch.setattr`, with a check of what stands in for a part of ours."""

    @functools.wraps(setattr_of_pytest)
    def setattr_checked(self, target, name, value=MISSING, raising=True):
        if value is MISSING:  # the target is a text
            (target, _, name), value = target.rpartition("."), name
            target = pkgutil.resolve_name(target)
        part = getattr(target, name, MISSING)
        if part is not MISSING and is_ours(target, part):
            value = checked(part, value, f"{getattr(target, '__name__', target)}.{name}")
        setattr_of_pytest(self, target, name, value, raising)

    return setattr_checked
