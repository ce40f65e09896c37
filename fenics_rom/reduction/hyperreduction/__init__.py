"""Reduction of bodies that deform largely: one basis, few points with positive weights, and forces that follow."""
