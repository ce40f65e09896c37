"""Identification: the material and damping of a scene that fit measured marker displacements best."""
