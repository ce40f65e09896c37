"""Some hundred of the cases of fuzz.py: 10,000 of a kind are `python tests/hard/fuzz.py KIND --count 10000`."""

import fuzz
import mutated_files
import mutated_meshes
import mutated_scenes
import numpy as np
import pytest

COUNTS = {"files": (60, 300), "scenes": (30, 200)}  # of cases; with --all, which has the others among them


@pytest.mark.parametrize("kind", COUNTS)
def test_mutated_input_is_refused_or_read_and_used(kind, request):
    """No crash, no hang, no error but those of this package, and nothing that fills the memory."""
    count = COUNTS[kind][request.config.getoption("--all")]
    outcomes, bad = fuzz.run(kind, count, seed=0)
    assert bad == []
    assert sum(outcomes.values()) == count
    # Else nothing behind the first check would be tested. A fifth of the scenes pass it, on any release: that all but
    # one of 60 fail it has a chance of 2e-5.
    assert outcomes["refused"] < 0.98 * count


@pytest.mark.parametrize("name", mutated_files.ORIGINALS)
def test_files_before_mutation_are_read_and_used(tmp_path, name):
    assert mutated_files.outcome(mutated_files.original(name), tmp_path) in (
        "a ROM, read, and stepped",
        "a run, read, and compared",
    )


@pytest.mark.parametrize("text", mutated_scenes.EXAMPLES.values(), ids=mutated_scenes.EXAMPLES)
def test_scenes_before_mutation_are_assembled_and_reduced(tmp_path, text):
    mutated_scenes.prepare(tmp_path)
    assert mutated_scenes.outcome(text.encode(), tmp_path) == "assembled, with a run, and reduced, and stepped"


def test_meshes_before_mutation_are_read(tmp_path):
    """Text and binary, of both versions."""
    mutated_meshes.prepare(tmp_path)
    assert len(set(mutated_meshes.originals.values())) == 4
    for content in mutated_meshes.originals.values():
        assert mutated_meshes.outcome(content, tmp_path) == "read"


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_cases_come_from_their_seed_alone(tmp_path, kind):
    module = __import__(fuzz.KINDS[kind])
    module.prepare(tmp_path)
    for number in range(20):
        pairs = ([module.mutated(np.random.default_rng([3, number])) for _ in range(2)] for _ in range(3))
        assert any(one == other for one, other in pairs)  # HDF5 notes the second, which may just have gone by
    assert module.mutated(np.random.default_rng([4, 0]))[1] != module.mutated(np.random.default_rng([3, 0]))[1]


@pytest.mark.parametrize(
    ("what", "outcome"),
    [
        ("raise KeyError", "BAD KeyError"),
        ("os.abort()", "BAD process ended by SIGABRT"),
        ("np.empty(2**33)[:] = 1", "BAD MemoryError"),
        ("time.sleep(60)", "BAD process ended by SIGALRM"),
        ("import ctypes; ctypes.string_at(0)", "BAD process ended by SIGSEGV"),
    ],
)
def test_bad_outcomes_are_seen(tmp_path, monkeypatch, what, outcome):
    """A kind of input that does it in its third case."""
    (tmp_path / "mutated_faults.py").write_text(
        "import os, time, numpy as np\n"
        "def prepare(folder): pass\n"
        "def mutated(random): return 'a number', random.integers(2)\n"
        "def outcome(case, folder):\n"
        "    outcome.calls = getattr(outcome, 'calls', 0) + 1\n"
        f"    if outcome.calls == 3: {what}\n"
        "    return 'read'\n"
    )
    (tmp_path / "faults.py").write_text(
        f"import sys\nsys.path[:0] = [{str(tmp_path)!r}, {str(fuzz.__file__).rpartition('/')[0]!r}]\n"
        "import fuzz\nfuzz.KINDS['faults'], fuzz.PATIENCE = 'mutated_faults', 1.0\nfuzz.main()\n"
    )
    monkeypatch.setattr(fuzz, "__file__", str(tmp_path / "faults.py"))
    outcomes, bad = fuzz.run("faults", 4, seed=0)
    assert len(bad) == 1
    assert bad[0].startswith("2: ")
    assert next(found for found in outcomes if found.startswith("BAD")).startswith(outcome)
    assert outcomes["read"] == 3
