"""System to ROM, with NumPy and SciPy; it sees matrices only through products, solves and sums over ranks."""
