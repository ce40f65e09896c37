"""What steps of worlds count as little: when sweeps end, what is near, and how far bodies may turn."""

TOLERANCE = 1e-15  # of the velocities: what the next sweep may change
ROUND_OFF = 1e-13  # of them: a change that is none
MOST_SWEEPS = 200
SLOW = 0.5  # of a change to the one before: sweeps that are slower are guided badly
STAGNATION = 1e-11  # of velocities: as near as round-off of large forces of joints lets them come
FEW_SWEEPS = 5  # after which W is found anew, where they are slow
PROXIMAL = 1e-6  # of each pair's own compliance, added to W where no point yields by itself

NEAR = 0.01  # of the smaller body: what is nearer is looked at in every step, besides what can be reached
SWERVES = 0.005  # of a body's size: so much farther than was foreseen it may go before others are looked for again
NO_GAP = 1e-12  # of the smaller body: gaps that are none
LARGEST = 1.0  # m: of a half-space, of how far it moves
PENETRATION_TOLERANCE = 1e-9  # of the smaller body: as deep as round-off may have put it
MISSES = 1e-11  # of the largest: by so much a force or speed may miss the piece that the law of a drive is on
MOST_CHANGES = 100  # of pieces of each drive in a try; after half of them one at a time
