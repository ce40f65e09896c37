"""Residual compliance that is kept by blocks: no less than it is, the energy account, files."""

import tracemalloc
import warnings
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, write_arrays
from in_blocks import in_blocks, made_as_a_whole, whole_part
from soft_rom import in_frame, linear, soft_rom
from test_moving_frame import reduced
from test_residual_compliance import CLOSES_TO, FLOOR, LENGTHS, MOVING, PUSH, ROUGH, Models, Reduced

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import FenicsRomWarning, RomFileError
from fenics_rom.mechanics import contact_search, kept_rows
from fenics_rom.reduction import block_compression
from fenics_rom.reduction import residual_compliance as offline
from fenics_rom.rom import block_rows
from fenics_rom.runtime.batch_contact_mode import by_axis, part_by_axis
from fenics_rom.runtime.steppers import residual_motion
from fenics_rom.runtime.steppers.compiled_step import CompiledStep

COMPILED = pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
WAYS = [pytest.param(kind, marks=COMPILED) for kind in ("single", "rollout", "batch")]


class Both:
    """A ROM whose residual compliance is kept by shapes, and the same by blocks."""

    def __init__(self, mesh):
        self.models = Models(mesh, MOVING + PUSH + FLOOR + ROUGH)
        with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
            patch.setattr(offline, "MOST_SHAPES", 12)  # else the shared basis lacks next to nothing
            patch.setattr(offline, "OVERSAMPLING", 8)
            self.by_shapes = fr.reduce(self.models.system, order=8)
            patch.setattr(offline, "MOST_ROWS", 0)
            patch.setattr(offline, "LEFT_OUT", 0.3)
            patch.setattr(block_compression, "LEAF", 4)
            self.rom = fr.reduce(self.models.system, order=8)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    path = tmp_path_factory.mktemp("blocks") / "box.msh"
    return Both(write_arrays(path, *box_arrays(LENGTHS, (6, 2, 2), shake=0.2)))


@pytest.mark.parametrize("order", [8, 3])
def test_no_contact_mode_yields_less_than_it_would(both, order):
    """Nor more than by what is told; truncated, too. That is what steps rest on: R is definite."""
    whole, blocks = (fr.truncate(rom, order) if order < 8 else rom for rom in (both.by_shapes, both.rom))
    kept = blocks.residual_compliance
    assert (kept.static.blocks[:, 4] >= 0).sum() > 1
    assert kept.factor is None
    more = kept.floor - whole.residual_compliance.floor
    assert more > 0
    for contact in whole.contact_models:
        one, other = (both.models.part(contact, rom) for rom in (whole, blocks))
        least, *_, most = np.linalg.eigvalsh(other.compliance - one.compliance)
        scale = np.abs(one.compliance).max()
        assert least >= -1e-9 * scale
        assert 1e-3 * scale < most <= 2 * more + 1e-9 * scale
        assert other.time_constant == pytest.approx(one.time_constant, rel=0.1)
        product = other.inverse_root @ other.compliance @ other.inverse_root.T
        np.testing.assert_allclose(product, np.eye(len(product)), rtol=0, atol=1e-9)


def test_account_closes_and_switches_neither_add_energy_nor_move_points(both):
    run = Reduced(both.rom)
    gap, gained, jump = run.shake(150, seed=0)
    assert run.body.ledger.contact > 0
    assert gap <= CLOSES_TO
    assert gained <= CLOSES_TO
    assert jump <= 1e-9


def test_bodies_of_a_batch_have_it_along_other_axes(both):
    """By axis, and what switches need of it; those with blocks are stepped one after another."""
    axes = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    part = both.models.part("right", both.by_shapes)
    turned, by_rows = part_by_axis(part, axes), by_axis(np.eye(len(part.compliance)), axes)
    scale = np.abs(part.compliance).max()
    np.testing.assert_allclose(turned.compliance, by_rows @ part.compliance @ by_rows.T, rtol=0, atol=1e-14 * scale)
    product = turned.inverse_root @ turned.compliance @ turned.inverse_root.T
    np.testing.assert_allclose(product, np.eye(len(product)), rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def many_points(tmp_path_factory):
    path = tmp_path_factory.mktemp("many") / "box.msh"
    contacts = "[contacts.all]\nnear = { point = [0.2, 0.1, 0.05], radius = 1.0 }"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(offline, "MOST_SHAPES", 12)
        patch.setattr(offline, "OVERSAMPLING", 8)
        mesh = write_arrays(path, *box_arrays(LENGTHS, (16, 8, 4), shake=0.1))
        return Models(mesh, MOVING + PUSH + FLOOR + ROUGH, contacts=contacts).rom


def pushed(rom, kind):
    """Displacements of a body, and forces on its points, under pushes that others follow in every step."""
    signals = {
        "push": lambda t: [20 * np.sin(700 * t), 5.0, -40 * np.cos(300 * t)],
        "floor": lambda t: [0.05 * np.sin(20 * t), 0.0, 0.004 * np.sin(60 * t) ** 2],
    }
    with numpy_alone() if "NumPy" in kind else nullcontext():
        if "batch" in kind:
            bodies, moved = fr.Batch(rom, size=2, dt=1e-3, signals=signals, ledger=True), []
            for _ in range(60):
                bodies.step(np.zeros(3))
                moved.append(bodies.displacement("tip"))
            return np.array(moved), bodies.dissipated_in_contact
        body, told = fr.Simulator(rom, dt=1e-3, signals=signals), []
        if kind == "rollout":
            body.rollout(np.zeros((30, 3)))
        for _ in range(60):
            body.step()
            told.append(np.concatenate([1e3 * body.displacement(), body.contact_forces()]))
        return np.array(told), body.ledger.contact


@pytest.mark.parametrize(
    "kind", ["single", "rollout", "batch", "by blocks", "NumPy", "little room, NumPy", "NumPy batch"]
)
def test_steps_are_those_of_the_whole(both, kind, monkeypatch):
    """Forces and motion, whether rows of the points that touch are kept, or there is little room for them, or none.

    1e-10 is what forces may lack of the velocities that they stop (1e-12), a hundred times.
    """
    with monkeypatch.context() as patch:
        patch.setattr(residual_motion, "residual_part", whole_part)
        expected, taken = pushed(both.rom, kind)
    if kind == "by blocks":
        monkeypatch.setattr(CompiledStep, "keep_rows", lambda step: None)
    if "little" in kind:
        monkeypatch.setattr(block_rows, "MOST", 4)
        monkeypatch.setattr(kept_rows, "AT_ONCE", 4)
    found, _ = pushed(both.rom, kind)
    assert np.max(taken) > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


FALLING = """inertia = {}
damping = { alpha = 0.0, beta = 2e-5 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
friction.coefficient = 0.4
contact.obstacles.floor = { shape = "half-space", point = [0.0, 0.0, -0.002], normal = [0.0, 0.0, 1.0] }"""
OTHERS = {
    "large": lambda: soft_rom(order=8, contact=True, touched_from=0.05),
    "large, carried": lambda: in_frame(soft_rom(order=8, contact=True, touched_from=0.05)),
    "carried": lambda: linear(in_frame(soft_rom(order=8, contact=True, touched_from=0.05))),
    "without inertia": lambda: linear(soft_rom(order=8, contact=True, touched_from=0.05, inertia=False)),
}


@pytest.fixture(scope="module")
def falling(tmp_path_factory):
    """A free beam above a floor."""
    parts = {"effects": FALLING, "contacts": '[contacts.bottom]\nsurface = "bottom"'}
    return reduced(tmp_path_factory.mktemp("falling"), order=10, **parts)


def pressed(rom):
    """Places and forces of a body that is pressed on the floor, and gaps of its account, as shares of its size."""
    body, told = fr.Simulator(rom, dt=1e-3), []
    if body.pose is not None and not body.is_carried:
        body.place(body.pose._replace(velocity=np.array([0.3, 0.0, -0.5]), angular_velocity=np.array([0.5, 2.0, 0.0])))
    start = peak = body.energy
    for step in range(60):
        force = np.zeros(body.inputs)
        force[:3] = np.array([0.1, 0.05, -0.6]) * (step < 40)
        body.step(force)
        peak = max(peak, body.energy)
        told.append(np.concatenate([1e3 * body.displacement(), body.contact_forces()]))
    account = body.ledger
    size = max(peak, abs(account.supplied), account.dissipated)
    gap = body.energy - start - account.supplied + account.dissipated + account.numerical
    return np.array(told), len(body.contact_points), abs(gap) / size


@pytest.mark.parametrize("way", [pytest.param("compiled", marks=COMPILED), "NumPy"])
@pytest.mark.parametrize("kind", [*OTHERS, "free"])
def test_other_steps_are_those_of_the_whole(falling, kind, way, monkeypatch):
    """To what sweeps and searches leave of forces, 1e-12 of velocities in each of 60 steps; accounts close."""
    rom = in_blocks(falling if kind == "free" else OTHERS[kind]())
    with numpy_alone() if way == "NumPy" else nullcontext():
        with monkeypatch.context() as patch:
            patch.setattr(residual_motion, "residual_part", whole_part)
            expected, _, _ = pressed(rom)
        monkeypatch.setattr(block_rows.BlockRows, "whole", made_as_a_whole)
        monkeypatch.setattr(contact_search, "MANY", 2)  # points that are near: others are reached, too
        found, points, gap = pressed(rom)
    assert np.abs(expected[-30:, -points:]).max() > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert gap <= CLOSES_TO


@pytest.mark.parametrize("kind", [*WAYS, "NumPy"])
def test_no_operator_of_many_points_is_made_as_a_whole(many_points, kind, monkeypatch):
    """A body with 405 points is made and pushed about in less memory than one array (3P, 3P) takes.

    Its basis is small, and rows are kept of 32 points: of thousands of points both are small beside that array. In
    NumPy the 100 pairs that touch have matrices of their own, which take as much.
    """
    rom = many_points
    monkeypatch.setattr(block_rows, "MOST", 32)
    monkeypatch.setattr(kept_rows, "AT_ONCE", 32)
    pushed(rom, kind)  # what is compiled, and made once
    tracemalloc.start()
    try:
        _, taken = pushed(rom, kind)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.max(taken) > 0
    whole = 8 * (3 * len(rom.residual_compliance.static.order)) ** 2
    assert peak < (2 if kind == "NumPy" else 1) * whole


def test_files_have_the_blocks_and_refuse_those_that_do_not_fit(both, tmp_path, capsys):
    path, kept = tmp_path / "rom.h5", both.rom.residual_compliance
    fr.write_rom(path, both.rom)
    assert fr.read_rom(path) == both.rom
    with pytest.raises(SystemExit, match="0"):
        main(["info", str(path)])
    assert "contact points, " in (told := " ".join(capsys.readouterr().out.split()))
    assert f"MB in blocks, to {kept.floor:.1e} m/N" in told
    one_less = replace(kept.static, values=kept.static.values[1:])
    for broken, said in (
        (replace(kept, static=one_less), "/residual_compliance/static: values are"),
        (replace(kept, static=None), "factor or static is missing, or there are both"),
        (replace(kept, factor=both.by_shapes.residual_compliance.factor), "or there are both"),
    ):
        with pytest.raises(RomFileError, match=said):
            fr.write_rom(path, replace(both.rom, residual_compliance=broken))
