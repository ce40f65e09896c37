"""Soft bodies for fenics_rom: `fr.load("finger")` reads one, and `fr.zoo()` tells of all."""
