"""Stepping and switching reduced models, with NumPy alone."""
