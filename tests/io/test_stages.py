"""The stopwatch of the offline work: every second counts once, and nobody waits for a rank that has failed."""

import numpy as np
import pytest
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.io.stages import Stage, Stages, peak_memory


@pytest.fixture
def clock(monkeypatch):
    """Time that passes when it is told to, s, and memory that grows with it, a byte each second."""
    time = [0.0]

    def wait(seconds):
        time[0] += seconds

    monkeypatch.setattr("fenics_rom.io.stages.time.perf_counter", lambda: time[0])
    monkeypatch.setattr("fenics_rom.io.stages.peak_memory", lambda: time[0])
    return wait


def test_each_second_counts_once(clock):
    stages = Stages()
    clock(100)
    with stages("outer"):
        clock(1)
        with stages("inner"):
            clock(10)
            with stages("outer"):  # again, within
                clock(2)
        clock(4)
    clock(100)
    with stages("inner"):
        clock(20)
    assert stages.done == (Stage("outer", 7, 117), Stage("inner", 30, 237))


def test_earlier_stages_come_first_and_go_on(clock):
    stages = Stages(earlier=(Stage("assembly", 5, 1), Stage("solves", 3, 2)))
    with stages("solves"):
        clock(4)
    assert stages.done == (Stage("assembly", 5, 1), Stage("solves", 7, 4))


def test_memory_is_that_of_the_rank_that_has_most(clock):
    stages = Stages(largest=lambda value: max(value, 50.0))
    for name in ("small", "large"):
        with stages(name):
            clock(40)
    assert [stage.peak_memory for stage in stages.done] == [50, 80]


def test_failed_stage_asks_nothing_of_the_other_ranks(clock):
    """They may be anywhere by then; where all have failed alike, the work can go on."""
    asked = []
    stages = Stages(largest=lambda value: asked.append(value) or value)

    def fail():
        with stages("inner"):
            clock(10)
            asked.clear()
            raise ValueError("failed")

    with stages("outer"):
        clock(1)
        with pytest.raises(ValueError, match="failed"):
            fail()
        assert asked == []
        with stages("other"):
            clock(20)
        clock(2)
    assert {stage.name: stage.seconds for stage in stages.done if stage.name != "inner"} == {"outer": 13, "other": 20}


def test_peak_memory_is_in_bytes_and_stays():
    before = peak_memory()
    assert 1e7 < before < 1e11
    size = int(before) + 50_000_000  # more than has been given back before
    assert np.ones(size, dtype=np.uint8)[-1] == 1
    assert peak_memory() > before + 40_000_000


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
def test_assembly_is_the_first_stage_of_a_reduction():
    system = fr.assemble(fr.read_scene(PLATE))
    (assembly,) = system.stages
    assert assembly.name == "assembly"
    assert 0 < assembly.seconds < 60
    assert 1e7 < assembly.peak_memory <= peak_memory()
    rom = fr.reduce(system, order=3)
    assert rom.stages[0] == assembly
    assert len(rom.stages) > 3
    memory = [stage.peak_memory for stage in rom.stages]
    assert memory[-1] >= memory[0]
