"""Writes the number of a release wherever it stands, as `python .ci/new_version.py 0.3.0`."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACES = {  # what stands around the number; of the changelog the newest section's
    "fenics_rom/version.py": r'(?<=^VERSION = ")[^"]+',
    "CHANGELOG.md": r"(?<=^## )\S+",
    "CITATION.cff": r"(?<=^version: )\S+",
    "zoo/pyproject.toml": r'(?<=^version = ")[^"]+',
    "ros/package.xml": r"(?<=^  <version>)[^<]+",
    "recipe/recipe.yaml": r'(?<=^  version: ")[^"]+',
}


def main(number):
    """Each place once."""
    if not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", number):
        sys.exit(f"use a number such as 1.0.0 or 1.0.0rc1 (got {number})")
    for file, pattern in PLACES.items():
        text, count = re.subn(pattern, number, (ROOT / file).read_text("utf-8"), count=1, flags=re.M)
        if count != 1:
            sys.exit(f"{file} has no number")
        (ROOT / file).write_text(text, "utf-8")
    print(f"{number}: {', '.join(PLACES)}. A new section of the changelog is begun by hand.")


if __name__ == "__main__":
    main(*sys.argv[1:])
