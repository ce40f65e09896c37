"""Hard cases stay numerically stable, or say why not.

    python demos/hard_cases/hard_cases.py             # some minutes
    python demos/hard_cases/hard_cases.py --quick     # coarser meshes and shorter runs: less than a minute

Each module beside this one is one kind of hard case: nearly incompressible or contrasting materials; slender bodies,
bad cells and far-off sizes; no damping and much; bodies that are free or held in part; one to two hundred contact
modes; orders beyond what is there; steps over nine decades, spikes and a million switches; single precision. Every
claim has a bound. The table of all of them is written to out/hard_cases.md, with --quick to out/quick/hard_cases.md.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import cases_contact
import cases_damping
import cases_material
import cases_order
import cases_precision
import cases_shape
import cases_steps
import cases_support
from rows import Row, table

from fenics_rom.errors import FenicsRomWarning

OUT = Path(__file__).parent / "out"
KINDS = {
    "Materials": cases_material,
    "Shapes": cases_shape,
    "Damping": cases_damping,
    "Supports": cases_support,
    "Contact modes": cases_contact,
    "Orders": cases_order,
    "Steps": cases_steps,
    "Single precision": cases_precision,
}


def main() -> None:
    """Runs all cases; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarser meshes and shorter runs")
    quick = parser.parse_args().quick
    out = OUT / "quick" if quick else OUT
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # what matters of them is in the table
    rows: list[Row] = []
    for title, kind in KINDS.items():
        start = time.perf_counter()
        found = list(kind.rows(quick))
        rows += found
        print(f"{title}, {time.perf_counter() - start:.0f} s\n\n{table(found)}", flush=True)
    (out / "hard_cases.md").write_text(table(rows))
    failing = sum(not row.holds for row in rows)
    print(f"{len(rows) - failing} of {len(rows)} claims hold")
    sys.exit(1 if failing else 0)


if __name__ == "__main__":
    main()
