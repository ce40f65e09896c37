"""Products of multigrid as numba compiles them: sparse matrices of blocks times many columns at once."""
