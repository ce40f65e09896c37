"""Steps as numba compiles them."""
