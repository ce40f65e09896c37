"""How far a long piece of work is, told while it goes on."""

from collections.abc import Callable

Report = Callable[[str, int, int], None]  # the stage, how much of it is done, and of how much


def silent(stage: str, done: int, of: int) -> None:
    """Tells nobody."""
