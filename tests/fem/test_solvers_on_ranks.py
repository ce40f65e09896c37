"""Solvers on one rank and on two: the same solutions, and the same errors on every rank."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from bodies import box_arrays, write_arrays
from ranks import run_ranks

RANKS = pytest.mark.parametrize("ranks", [1, 2])
pytestmark = pytest.mark.ranks


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What each rank of one and of two saw."""
    folder = tmp_path_factory.mktemp("solvers")
    mesh = write_arrays(folder / "box.msh", *box_arrays((1.0, 0.5, 0.5), (7, 4, 4), shake=0.2))
    script, checks = Path(__file__).with_name("solvers_on_ranks.py"), {}
    for ranks in (1, 2):
        results = folder / f"{ranks}.json"
        done = run_ranks(ranks, script, mesh, results, path=script.parents[1])
        assert done.returncode == 0, done.stdout + done.stderr
        checks[ranks] = json.loads(results.read_text())
        assert len(checks[ranks]) == ranks
    return checks


@RANKS
def test_rows_of_a_rank_are_whole_nodes(seen, ranks):
    for rank in seen[ranks]:
        assert rank["blocks"] == 3
        assert all(row % 3 == 0 for row in rank["rows"])
        assert rank["rows"][0] < rank["rows"][1]


@RANKS
def test_solutions_hold(seen, ranks):
    for rank in seen[ranks]:
        assert rank["direct"] <= 1e-10
        assert rank["complex"] <= 1e-10
        assert rank["iterative"] <= 1e-10
        assert rank["replaced"] <= 1e-10
        np.testing.assert_allclose(rank["eigenvalues"], seen[1][0]["eigenvalues"], rtol=1e-9)


@RANKS
def test_shortage_on_one_rank_is_one_for_all(seen, ranks):
    for rank in seen[ranks]:
        assert "GB on this machine and 0.001 GB are free" in rank["notice"]
        assert rank["refused"].endswith("a coarser mesh or more machines")
        assert (
            rank["notice"].partition(":")[0]
            == rank["refused"].partition(":")[0]
            == seen[ranks][0]["notice"].partition(":")[0]
        )


@RANKS
@pytest.mark.parametrize(
    ("failure", "message"),
    [("unconverged", "DIVERGED_.* after 2 iterations"), ("singular", "is it symmetric positive definite")],
)
def test_failure_is_raised_on_every_rank(seen, ranks, failure, message):
    for rank in seen[ranks]:
        assert re.search(message, rank[failure])
