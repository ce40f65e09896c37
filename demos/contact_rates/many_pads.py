"""What a process takes that does nothing but step very many pads: run by pad_batches.py, with NumPy and h5py alone."""

import sys
import time
import warnings
from pathlib import Path

import numpy as np

import fenics_rom as fr


def main() -> None:
    """Prints steps of a pad per second, best of four parts after one to settle, and the most memory it had, in MB."""
    rom, size, dt, largest, steps = sys.argv[1], *(float(number) for number in sys.argv[2:])
    warnings.simplefilter("ignore")
    bodies, random, rates = fr.Batch(rom, int(size), dt), np.random.default_rng(0), []
    for _ in range(5):
        seconds = 0.0
        for step in range(int(steps)):
            if step % 10 == 0:
                u = random.uniform(-largest, largest, (bodies.size, bodies.inputs))
            started = time.process_time()
            bodies.step(u)
            seconds += time.process_time() - started
        rates.append(size * steps / seconds)
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    memory = int(status["VmHWM"].split()[0]) / 1e3  # resource.getrusage would tell that of what started this, if more
    print(f"{max(rates[1:]):.0f} {memory:.0f} {np.count_nonzero(bodies.point_forces.any(axis=2)) / size:.1f}")


if __name__ == "__main__":
    main()
