"""The release: pyproject.toml takes it from here; the changelog and CITATION.cff say the same, and a test looks."""

VERSION = "0.2.0"
