"""When the sweeps of a step end."""

TOLERANCE = 1e-15  # of the velocities: what the next sweep may change
ROUND_OFF = 1e-13  # of them: a change that is none
MOST_SWEEPS = 200
SLOW = 0.5  # of a change to the one before: sweeps that are slower are guided badly
PROXIMAL = 1e-6  # of each pair's own compliance, added to W where no point yields by itself
