"""What is kept of a run: the trajectory, its file, and the comparison of two."""
