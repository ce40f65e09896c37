"""What a hard case claims, one row of a table each."""

from dataclasses import dataclass

from fenics_rom.io.markdown import markdown


@dataclass(frozen=True)
class Row:
    """A claim.

    Attributes:
        case: the body or the ride.
        hard: what is hard about it.
        measured: the quantity.
        value: of it.
        bound: it has to keep.
        at_least: whether that is a lower bound.
    """

    case: str
    hard: str
    measured: str
    value: float
    bound: float
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the value keeps the bound; what is not a number does not."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def cells(self) -> tuple[str, ...]:
        """As in a table."""
        side = "≥" if self.at_least else "≤"
        verdict = "holds" if self.holds else "FAILS"
        return self.case, self.hard, self.measured, f"{self.value:.2g}", f"{side} {self.bound:g}", verdict


def said(case: str, hard: str, error: str, *words: str) -> Row:
    """A claim that a message names what is wrong; the share of the words that are in it must be all.

    Args:
        case, hard: as in Row.
        error: the message; empty where none came.
        words: that it must hold.
    """
    there = sum(word in error for word in words) / len(words)
    return Row(case, hard, f"is told, with {', '.join(repr(word) for word in words)}", there, 1.0, at_least=True)


def table(rows: list[Row]) -> str:
    """All claims, in Markdown."""
    return markdown(("case", "what is hard", "measured", "value", "bound", ""), [row.cells for row in rows])
