"""Contact as numba compiles it: loops over pairs, with the law of `mechanics.contact_solver`."""
