"""Plots of runs and reduced models, and bodies on axes that the caller arranges."""
