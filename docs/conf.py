"""The site: sphinx-build -W -c docs . docs/out. Its pages are those of `docs` and of the folders, where they stand."""

import re
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
project, copyright, author = "fenics_rom", "the authors of fenics_rom", "the authors of fenics_rom"
version = release = installed_version("fenics-rom")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/reference/api.rst",
    "fenics_rom/**.md",
    "demos/**.md",
    "zoo/*.md",
    "ros/*.md",
    "README.md",
    ".github/*.md",
    "CHANGELOG.md",
]
exclude_patterns = ["**/out/**", "docs/out"]
myst_heading_anchors = 5
myst_enable_extensions = ["colon_fence"]
default_role = "code"  # of docstrings
autodoc_typehints = "none"  # the signature has them
napoleon_google_docstring, napoleon_numpy_docstring, napoleon_use_ivar = True, False, True
html_theme, html_title = "furo", f"fenics_rom {release}"
html_copy_source = False


def as_text(app: Any, what: str, name: str, of: Any, options: Any, lines: list[str]) -> None:
    """Docstrings have |x| and x* of mathematics, which are no marks of reStructuredText."""
    lines[:] = [re.sub(r"([|*_])", r"\\\1", line) if ">>>" not in line else line for line in lines]


def setup(app: Any) -> None:
    """As Sphinx asks of a configuration."""
    app.connect("autodoc-process-docstring", as_text, priority=400)  # before sections are read
