"""Steps of worlds as numba compiles them: loops over pairs and bodies."""
