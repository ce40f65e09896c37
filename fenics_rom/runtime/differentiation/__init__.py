"""Exact gradients of what comes of many steps, by the adjoint of the steps that were taken."""
