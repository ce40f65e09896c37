"""The examples of own matrices are run as they are printed; each ends in checks of its own."""

from pathlib import Path

import pytest
from ranks import run_ranks

FOLDER = Path(__file__).parents[2] / "demos" / "own_matrices"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py") if path.name != "checks.py")
LONG = "forms_beam.py"
PARALLEL = [LONG, "petsc_rope.py"]


def by_length(scripts):
    return [pytest.param(script, marks=pytest.mark.slow if script == LONG else ()) for script in scripts]


def assert_checks_held(done, ranks):
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("energy account closes to") == 1
    assert f"on {ranks} ranks" in done.stdout or ranks == 1


@pytest.mark.parametrize("script", by_length(SCRIPTS))
def test_example_keeps_its_claims(script):
    assert_checks_held(run_ranks(1, FOLDER / script), 1)


@pytest.mark.parametrize("script", by_length(PARALLEL))
@pytest.mark.ranks
def test_example_keeps_its_claims_on_two_ranks(script):
    assert_checks_held(run_ranks(2, FOLDER / script), 2)


def test_every_example_is_known():
    assert SCRIPTS == ["abaqus_rotor.py", "forms_beam.py", "matrix_market.py", "petsc_rope.py", "scipy_rope.py"]
    assert set(PARALLEL) < set(SCRIPTS)
