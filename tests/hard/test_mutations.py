"""The faults that mutate.py makes can be made: what each replaces is in the package, once."""

import mutate


def test_what_each_fault_replaces_is_there_once():
    package = mutate.ROOT / "fenics_rom"
    counts = {(file, right): (package / file).read_text().count(right) for file, right, _ in mutate.MUTATIONS}
    assert {fault: count for fault, count in counts.items() if count != 1} == {}
    assert all(right != wrong for _, right, wrong in mutate.MUTATIONS)


def test_what_is_copied_and_run_is_there():
    assert all((mutate.ROOT / part).exists() for part in (*mutate.COPIED, mutate.HARD[0], *mutate.RUNTIME))
