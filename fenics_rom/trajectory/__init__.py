"""What is kept of a run: its record, its file, and the comparison of two."""
