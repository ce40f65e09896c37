"""Tables that can be read as they are, and pasted where Markdown is shown."""

from collections.abc import Sequence


def markdown(heading: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table with aligned columns, of as many cells in each row as in the heading."""
    cells = [[str(cell) for cell in row] for row in [heading, *rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(heading))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines) + "\n"
