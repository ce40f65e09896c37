"""A reduction that is stopped goes on from the last finished contact mode, and from nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, FileError
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.reduction import kept_solves
from fenics_rom.reduction.checkpoint import remove_checkpoint
from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.reduce import BY_NAME
from fenics_rom.system.protocols import EXACT

CHOICES = {
    "closed form": {},
    "krylov": {"lyapunov": "krylov"},
    "selection": {"lyapunov": "krylov", "method": "eigenvector-selection"},
    "adi": {"lyapunov": "adi"},
}


class Stopped(Exception):
    """What ends a run."""


@pytest.fixture
def stopped(box_system, tmp_path, monkeypatch):
    """Runs a reduction that ends when one of the two contact modes is finished, and returns its checkpoint."""

    def run(**choices):
        def one(problem):
            yield next(balanced(problem))
            raise Stopped

        with monkeypatch.context() as patch:
            patch.setitem(BY_NAME, choices.get("method", "balanced"), one)
            with pytest.raises(Stopped):
                fr.reduce(box_system, checkpoint=tmp_path / "partial", **{"order": 6} | choices)
        return tmp_path / "partial"

    return run


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_stopped_run_goes_on(box_system, stopped, monkeypatch, choices):
    folder = stopped(**choices)
    assert [file.name for file in folder.iterdir()] == ["0.h5"]
    left = []

    def noting(problem):
        left.append(problem.contacts)
        yield from balanced(problem)

    monkeypatch.setitem(BY_NAME, choices.get("method", "balanced"), noting)
    rom = fr.reduce(box_system, order=6, checkpoint=folder, resume=True, **choices)
    assert left == [("top",)]
    assert {file.name for file in folder.iterdir()} == {"0.h5", "1.h5"}
    for name, mode in fr.reduce(box_system, order=6, **choices).contact_models.items():
        σ = mode.hankel_singular_values[:6]
        np.testing.assert_allclose(rom.contact_models[name].eigenvalues, mode.eigenvalues, rtol=1e-8)
        np.testing.assert_allclose(rom.contact_models[name].hankel_singular_values[:6], σ, rtol=1e-8)
        assert rom.contact_models[name].static_error == pytest.approx(mode.static_error, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("solves", [1, 4])
def test_a_run_goes_on_within_a_contact_mode(box_system, tmp_path, monkeypatch, solves):
    """What was solved for is not solved again, and the ROM is the same to the last bit; later files are removed."""
    monkeypatch.setattr(kept_solves, "SECONDS", 0.0)
    choices = {"order": 6, "lyapunov": "krylov"}
    expected, done, solve = fr.reduce(box_system, **choices), [], PetscFactor.solve

    def counted(self, block, accuracy=EXACT):
        done.append(block.shape[1])
        return solve(self, block, accuracy)

    def stopping(self, block, accuracy=EXACT):
        if len(done) == solves:
            raise Stopped
        return counted(self, block, accuracy)

    folder = tmp_path / "partial"
    with monkeypatch.context() as patch:
        patch.setattr(PetscFactor, "solve", stopping)
        with pytest.raises(Stopped):
            fr.reduce(box_system, checkpoint=folder, **choices)
    assert {file.name for file in folder.iterdir()} == {f"solve-{k}.h5" for k in range(solves)}
    counts = []
    for resume in (True, False):
        done.clear()
        with monkeypatch.context() as patch:
            patch.setattr(PetscFactor, "solve", counted)
            rom = fr.reduce(box_system, checkpoint=folder if resume else tmp_path / "other", resume=resume, **choices)
        counts.append(len(done))
        np.testing.assert_array_equal(rom.basis, expected.basis)
    assert counts[1] - counts[0] == solves
    remove_checkpoint(folder)
    assert not folder.exists()


def test_eigenpairs_are_found_with_a_factor_whose_solves_are_kept(box_system, tmp_path):
    rom = fr.reduce(box_system, method="modal", order=2, checkpoint=tmp_path / "partial")
    np.testing.assert_array_equal(rom.basis, fr.reduce(box_system, method="modal", order=2).basis)


def test_solves_of_another_matrix_are_done_again(box_system, tmp_path, monkeypatch):
    monkeypatch.setattr(kept_solves, "SECONDS", 0.0)
    folder, choices = tmp_path / "partial", {"order": 6, "lyapunov": "krylov"}
    with monkeypatch.context() as patch:
        patch.setattr("fenics_rom.reduction.reduce._truncated", stop)
        with pytest.raises(Stopped):
            fr.reduce(box_system, checkpoint=folder, **choices)
    assert list(folder.glob("solve-*.h5"))
    other = with_scaled_stiffness(box_system)
    rom = fr.reduce(other, checkpoint=folder, resume=True, **choices)
    np.testing.assert_array_equal(rom.basis, fr.reduce(other, **choices).basis)


def stop(*_):
    raise Stopped


def test_without_resume_it_starts_anew(box_system, stopped):
    folder = stopped(tolerance=1e-3, order=None)
    fr.reduce(box_system, order=6, checkpoint=folder)
    assert fr.reduce(box_system, order=6, checkpoint=folder, resume=True).contact_models["top"].order == 6


def test_what_another_rank_has_not_removed_yet_is_not_read(box_system, stopped, monkeypatch):
    folder = stopped()
    monkeypatch.setattr("fenics_rom.reduction.checkpoint.remove_checkpoint", lambda folder: None)
    begun = []
    fr.reduce(box_system, order=6, checkpoint=folder, report=lambda stage, done, of: begun.append((stage, done)))
    assert ("contact modes", 0) in begun


def test_what_a_checkpoint_wrote_is_removed_and_nothing_else(stopped):
    folder = stopped()
    (folder / ".1.h5.x1y2.part").write_text("half a file")
    (folder / "note.txt").write_text("not ours")
    remove_checkpoint(folder)
    assert [file.name for file in folder.iterdir()] == ["note.txt"]
    (folder / "note.txt").unlink()
    remove_checkpoint(folder)
    assert not folder.exists()


@pytest.mark.parametrize("name", ["1.h5", "run-0.h5"])
def test_a_file_of_somebody_s_that_is_called_like_a_part_is_kept(box_system, stopped, name):
    folder = stopped()
    run = (Path(__file__).parents[1] / "data" / "run-1.2.h5").read_bytes()
    (folder / name).write_bytes(run)
    with pytest.raises(FileError, match=f"holds '{name}', which no reduction left; give another folder"):
        fr.reduce(box_system, order=6, checkpoint=folder)
    remove_checkpoint(folder)
    assert [file.name for file in folder.iterdir()] == [name]
    assert (folder / name).read_bytes() == run


def test_messages_are_told_again(box_system, stopped):
    with pytest.warns(FenicsRomWarning, match="order 500 was asked for"):
        whole = fr.reduce(box_system, order=500)
    with pytest.warns(FenicsRomWarning, match="order 500 was asked for"):
        rom = fr.reduce(box_system, order=500, checkpoint=stopped(order=500), resume=True)
    assert rom.warnings == whole.warnings
    assert len(rom.warnings) == 2


def test_there_need_be_nothing_to_resume(box_system, tmp_path):
    fr.reduce(box_system, order=6, checkpoint=tmp_path / "partial", resume=True)
    assert {file.name for file in (tmp_path / "partial").iterdir()} == {"0.h5", "1.h5"}


def with_scaled_stiffness(system):
    matrix = system.stiffness.mat.copy()
    matrix.scale(1.000001)
    return replace(system, stiffness=PetscMatrix(matrix))


@pytest.mark.parametrize("what", ["order", "inputs", "stiffness", "outputs"])
def test_a_checkpoint_of_something_else_is_refused(box_system, stopped, what):
    folder, order, other = stopped(), 6, box_system
    if what == "order":
        order = 7
    elif what == "inputs":
        other = replace(box_system, contacts={name: 2 * B for name, B in box_system.contacts.items()})
    elif what == "outputs":
        other = replace(box_system, outputs={"new": box_system.contacts["top"]})
    else:
        other = with_scaled_stiffness(box_system)
    with pytest.raises(FileError, match="was made from another system or with other choices"):
        fr.reduce(other, order=order, checkpoint=folder, resume=True)
    assert (folder / "0.h5").exists()


def test_a_damaged_checkpoint_is_refused(box_system, stopped):
    part = stopped() / "0.h5"
    content = bytearray(part.read_bytes())
    content[2000] ^= 1
    part.write_bytes(content)
    with pytest.raises(FileError, match=r"0\.h5: is damaged"):
        fr.reduce(box_system, order=6, checkpoint=part.parent, resume=True)


def test_a_checkpoint_needs_a_place(box_system, tmp_path):
    with pytest.raises(FileError, match="cannot be made: folder"):
        fr.reduce(box_system, order=6, checkpoint=tmp_path / "nowhere" / "partial")
