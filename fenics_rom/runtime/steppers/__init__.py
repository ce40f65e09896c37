"""The ways to take one step, behind one contract."""
