"""Free bodies at run time: falling, spinning, switching; displacements along rigid motions, which no energy sees."""

import copy
import pickle
import warnings
from dataclasses import replace

import h5py
import numpy as np
import pytest
from bodies import assembled, box_arrays, write_arrays
from linear_roms import random_free
from test_energy_laws import CLOSES_TO, NONE_ADDED, rough_ride

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, StepError, StructureError
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.mechanics.linearity import SurfaceStrainPeak
from fenics_rom.rom.rom import check_rom
from fenics_rom.runtime.linearity_monitor import ReducedGauges, gauge_basis
from fenics_rom.runtime.steppers.midpoint import FusedMidpoint, StagedMidpoint

GRAVITY = 9.81


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    """A free box, n = 135, without damping of its rigid motions, and its weight as an actuator."""
    mesh = write_arrays(tmp_path_factory.mktemp("free") / "box.msh", *box_arrays((1.0, 0.4, 0.3), (4, 2, 2), shake=0.2))
    system = assembled(mesh, supports=None, damping="beta = 1e-3", **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    down = np.tile([0.0, 0.0, -GRAVITY], len(system.body.nodes))[:, None]
    return replace(system, actuators={"weight": system.mass @ down})


@pytest.fixture(scope="module")
def rom(system):
    return fr.reduce(system, order=20)


def excited(rom, contact, seed=0, dt=1e-3):
    """A body somewhere, moving."""
    body = fr.Simulator(rom, dt)
    body.switch(contact)
    random = np.random.default_rng(seed)
    body.state = 1e-3 * random.standard_normal((2, rom.contact_models[contact].order))
    return body


@pytest.mark.parametrize("h", [1e-4, 1e-2, 0.5])
def test_fall_is_a_parabola(rom, h):
    """The midpoint rule is exact for a constant force, and a weight strains nothing."""
    body = fr.Simulator(rom, h)
    for _ in range(150):
        body.step([0.0, 0.0, 0.0, 1.0])
    t = 150 * h
    exact = np.array([0.0, 0.0, -GRAVITY / 2 * t**2])
    assert np.abs(body.displacement() - exact).max() <= 1e-12 * GRAVITY / 2 * t**2
    assert np.abs(body.velocity() - [0, 0, -GRAVITY * t]).max() <= 1e-12 * GRAVITY * t
    mass = 1000 * 1.0 * 0.4 * 0.3
    assert body.energy == pytest.approx(mass / 2 * (GRAVITY * t) ** 2, rel=1e-12)
    assert body.ledger.supplied == pytest.approx(body.energy, rel=1e-12)


def test_momenta_stay_without_forces(rom, system):
    """Of translation and of rotation, over steps of any size and switches between them."""
    body = excited(rom, "right")
    random = np.random.default_rng(1)
    (s, _), names, time = body.state, list(rom.contact_models), 0.0
    W = rom.basis @ rom.contact_models["right"].coordinates
    before = system.rigid.T @ (system.mass @ (W @ body.state[1][:, None]))[:, 0]
    np.testing.assert_allclose(body.state[1][:6], before, atol=1e-14)
    velocity, start, energy = body.state[1][:6], s[:6], body.energy
    for step in range(2000):
        body.dt = 10 ** random.uniform(-5, -2)
        body.step(np.zeros(body.inputs))
        time += body.dt
        if step % 3 == 0:
            body.switch(names[step % 2])
        assert body.energy <= energy * (1 + 1e-13)
        energy = body.energy
    assert np.abs(body.state[1][:6] - velocity).max() <= 1e-12 * np.abs(velocity).max()
    assert np.abs(body.state[0][:6] - start - time * velocity).max() <= 1e-12 * np.abs(start + time * velocity).max()


@pytest.mark.parametrize("dense", [False, True])
def test_switch_carries_rigid_motions_over_exactly(dense):
    rom = random_free(3, (30, 12, 5), dense)
    body, random = excited(rom, "mode0"), np.random.default_rng(2)
    for _ in range(50):
        (q, r), before = body.state, body.energy
        body.switch(f"mode{random.integers(3)}")
        q2, r2 = body.state
        np.testing.assert_array_equal(q2[:6], q[:6])
        np.testing.assert_array_equal(r2[:6], r[:6])
        assert body.energy <= before * (1 + NONE_ADDED)
        body.step(random.standard_normal(2))


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("size", [8, 100])
def test_account_closes_for_free_bodies(size, dense):
    """In both forms of the step, with dampers that couple rigid and elastic motions."""
    rom = random_free(size, (size, size // 2), dense, k=size)
    form = StagedMidpoint if size > 90 else FusedMidpoint
    assert type(fr.Simulator(rom, 1e-3)._stepper.kernel) is form
    account = rough_ride(rom, 500, seed=size)
    assert account.gap <= CLOSES_TO * account.scale
    assert account.largest_gain <= NONE_ADDED


def test_reduced_run_follows_the_full_order(system):
    """At an order that holds all but the smallest σ, under a force that strains and carries the body away."""
    rom = fr.reduce(system, order=100)
    body, full = fr.Simulator(rom, 1e-3), FullOrderStepper(system, 1e-3)
    for step in range(400):
        u = np.array([np.sin(0.02 * step), 0.3, np.cos(0.05 * step), 0.1])
        body.step(u)
        full.step_under(system.input_matrix("right") @ u)
    gap = np.abs(body.displacement() - full.displacement())
    moved = np.abs(full.displacement()).max()
    assert gap.max() <= 1e-6 * np.ptp(full.displacement(), axis=0).max()
    assert moved > 50 * np.ptp(full.displacement(), axis=0).max()
    assert body.energy == pytest.approx(full.energy, rel=1e-9)
    assert body.ledger.supplied == pytest.approx(full.ledger.supplied, rel=1e-9)
    full.close()


def test_rigid_displacements_are_saved_restored_copied_and_reset(rom):
    body = excited(rom, "top")
    for _ in range(40):
        body.step([0.0, 0.1, 0.2, 0.01])
    snapshot, shape = body.save(), body.displacement()
    for other in (copy.copy(body), copy.deepcopy(body), pickle.loads(pickle.dumps(body))):
        np.testing.assert_array_equal(other.displacement(), shape)
        other.step([1.0, 0.0, 0.0, 0.0])
        np.testing.assert_array_equal(body.displacement(), shape)
    for ledger in (True, False):
        other = fr.Simulator(rom, 1e-3, ledger=ledger)
        snapshot = replace(snapshot, sums=snapshot.sums if ledger else None)
        for back in (other.reset, lambda other=other, start=snapshot: other.restore(start)):
            other.switch("top" if back == other.reset else "right")
            for _ in range(9):  # the last of them are not booked when going back
                other.step([9.0, 9.0, 9.0, 0.0])
            back()
            exact = 0 * shape if back == other.reset else shape
            np.testing.assert_array_equal(other.displacement(), exact)
            before = other.state[0][:6]
            for name in ("right", "top", "right"):
                other.switch(name)
                np.testing.assert_array_equal(other.state[0][:6], before)
    held = snapshot.stepper._replace(rigid_displacement=np.empty(0))
    with pytest.raises(StepError, match="another ROM"):
        fr.Simulator(rom, 1e-3).restore(replace(snapshot, stepper=held))


def test_state_can_be_set_between_steps(rom):
    one, other = excited(rom, "right"), excited(rom, "right", seed=5)
    for _ in range(7):
        other.step([1.0, 1.0, 1.0, 0.0])
    other.state = one.state
    for body in (one, other):
        for _ in range(40):
            body.step([0.1, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(one.displacement(), other.displacement())


def test_reading_changes_no_bit(rom):
    one, other = excited(rom, "right"), excited(rom, "right")
    for _ in range(100):
        one.step([0.1, 0.2, 0.3, 0.4])
        one.displacement("tip")
        other.step([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(one.displacement(), other.displacement())


def test_input_that_is_refused_moves_nothing(rom):
    body = excited(rom, "right")
    for _ in range(5):
        body.step([0.1, 0.0, 0.0, 0.0])
    before = body.displacement()
    with pytest.raises(StepError, match="step overflows"):
        body.step([1e308, 0.0, 0.0, 1e308])
    np.testing.assert_array_equal(body.displacement(), before)


@pytest.mark.parametrize("every", [1, 7])
def test_rollout_is_stepping(rom, every):
    random = np.random.default_rng(0)
    u, contacts = random.standard_normal((100, 4)), ["right"] * 33 + ["top"] * 67
    one, other = excited(rom, "right"), excited(rom, "right")
    tip = one.rollout(u, contact=contacts, every=every)["tip"]
    seen = []
    for step in range(100):
        other.switch(contacts[step])
        other.step(u[step])
        if (step + 1) % every == 0:
            seen.append(other.displacement("tip"))
    np.testing.assert_allclose(tip, seen, rtol=1e-12)
    assert one.energy == pytest.approx(other.energy, rel=1e-12)
    assert one.rollout(u, contact="top", outputs=[]) == {}


@pytest.mark.parametrize(("dtype", "accuracy"), [(np.float64, 1e-12), (np.float32, 1e-4)])
@pytest.mark.parametrize("dense", [False, True])
def test_batch_is_many_simulators(dense, dtype, accuracy):
    rom, random = random_free(1, (20, 9), dense), np.random.default_rng(4)
    bodies, singles = fr.Batch(rom, 6, 1e-3, dtype=dtype, ledger=True), [fr.Simulator(rom, 1e-3) for _ in range(6)]
    for step in range(120):
        if step % 11 == 10:
            names = [f"mode{k}" for k in random.integers(2, size=6)]
            bodies.switch(names)
            for body, name in zip(singles, names, strict=True):
                body.switch(name)
        if step == 60:
            bodies.dt = 3e-3
            for body in singles:
                body.dt = 3e-3
        u = random.standard_normal((6, 2))
        bodies.step(u)
        for body, force in zip(singles, u, strict=True):
            body.step(force)
    shapes = np.array([body.displacement("all") for body in singles])
    assert np.abs(bodies.displacement("all") - shapes).max() <= accuracy * np.abs(shapes).max()
    np.testing.assert_allclose(bodies.energy, [body.energy for body in singles], rtol=10 * accuracy)
    q, r = bodies.state(2)
    other = fr.Batch(rom, 1, 2e-3, dtype=dtype)
    other.switch(str(bodies.contact[2]))
    other.set_state(q, r)
    np.testing.assert_allclose(other.displacement("all")[0], shapes[2], atol=accuracy * np.abs(shapes).max())


def test_large_rotations_are_told_though_no_energy_bounds_them(rom, system):
    """Slow ones, too; and a fall, however far, is none."""
    mode, rows = rom.contact_models["right"], gauge_basis(rom)
    assert ReducedGauges(rows @ mode.coordinates, mode.eigenvalues).safe_energy == 0.0
    spin = np.cross([0.0, 0.0, 0.01], system.body.nodes).reshape(-1, 1)
    body, r = fr.Simulator(rom, 0.1), np.zeros(mode.order)
    r[:6] = (system.rigid.T @ (system.mass @ spin))[:, 0]
    body.state = np.zeros(mode.order), r
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for _ in range(400):
            body.step(np.zeros(4))
    assert [w.category for w in told] == [FenicsRomWarning]
    assert str(told[0].message).startswith("the surface is turned by 0.20")
    assert 0.3 < body.surface_peak.rotation <= 0.4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        body = fr.Simulator(rom, 0.1)
        for _ in range(100):
            body.step([0.0, 0.0, 0.0, 1.0])
    assert body.surface_peak.rotation <= 1e-9


def test_translations_alone_leave_the_safe_energy_as_it_is(rom, system):
    mode, rows = rom.contact_models["right"], gauge_basis(rom)
    shifts = np.tile(np.eye(3), (len(system.body.nodes), 1))
    moves = gauge_basis(replace(rom, basis=shifts))
    elastic = (rows @ mode.coordinates)[:, 6:]
    alone = ReducedGauges(elastic, mode.eigenvalues[6:])
    with_shifts = ReducedGauges(np.hstack([moves, elastic]), np.concatenate([np.zeros(3), mode.eigenvalues[6:]]))
    assert 0 < with_shifts.safe_energy == pytest.approx(alone.safe_energy, rel=1e-12)
    assert with_shifts.read(np.array([5.0, 5.0, 5.0] + [0.0] * (mode.order - 6))) == pytest.approx((0, 0), abs=1e-9)
    assert with_shifts.largest_change(np.zeros(mode.order - 3), np.full(3, 5.0)) == pytest.approx(0.0, abs=1e-9)


def test_a_rigid_rotation_changes_severity_as_the_surface_sees_it(rom, system):
    mode = rom.contact_models["right"]
    gauge = ReducedGauges(gauge_basis(rom) @ mode.coordinates, mode.eigenvalues)
    spin = np.cross([0.01, -0.02, 0.03], system.body.nodes).reshape(-1, 1)
    s = (system.rigid.T @ (system.mass @ spin))[:, 0]
    severity = SurfaceStrainPeak(*gauge.read(np.concatenate([s, np.zeros(mode.order - 6)]))).severity
    assert 0.1 < severity == pytest.approx(gauge.largest_change(np.zeros(mode.order), s), rel=1e-9)


def test_lower_orders_keep_the_rigid_motions(rom, system):
    small = check_rom(fr.truncate(rom, 7))
    again = fr.truncate(fr.truncate(rom, 15), 7)
    direct = fr.reduce(system, order=7)
    for name, mode in small.contact_models.items():
        assert (mode.order, mode.rigid) == (13, 6)
        assert not mode.eigenvalues[:6].any()
        np.testing.assert_array_equal(mode.coordinates[:, :6], np.eye(len(rom.stiffness))[:, :6])
        np.testing.assert_allclose(mode.inputs[:6], rom.contact_models[name].inputs[:6], rtol=1e-14)
        np.testing.assert_allclose(mode.eigenvalues, again.contact_models[name].eigenvalues, rtol=1e-10)
        σ = mode.hankel_singular_values
        assert small.validation[name]["neglected"] == pytest.approx(σ[7:].sum() / σ.sum(), rel=1e-12)
        np.testing.assert_allclose(mode.eigenvalues[6:], direct.contact_models[name].eigenvalues[6:], rtol=1e-8)
    assert fr.truncate(rom, 20).contact_models["top"] is rom.contact_models["top"]
    with pytest.raises(StructureError, match="use 1 to 20"):
        fr.truncate(rom, 21)
    dense = random_free(0, (20, 9), True)
    for mode, whole in zip(fr.truncate(dense, 4).contact_models.values(), dense.contact_models.values(), strict=True):
        np.testing.assert_allclose(mode.damping[:6, :6], whole.damping[:6, :6], rtol=1e-12)


def test_files_keep_them_and_refuse_others(rom, tmp_path, capsys):
    from fenics_rom.cli.display import print_rom

    file = tmp_path / "free.h5"
    fr.write_rom(file, rom)
    body, other = fr.Simulator(rom, 1e-3), fr.Simulator(fr.read_rom(file), 1e-3)
    for simulator in (body, other):
        simulator.rollout(np.ones((10, 4)))
    np.testing.assert_array_equal(other.displacement(), body.displacement())
    print_rom(rom, file)
    assert "20 + 6 rigid" in capsys.readouterr().out
    with h5py.File(file) as h5:
        assert not h5["stiffness"][:6].any()


def with_first(rom, **parts):
    name, mode = next(iter(rom.contact_models.items()))
    return replace(rom, contact_models=rom.contact_models | {name: replace(mode, **parts)})


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda rom: replace(rom, stiffness=rom.stiffness[::-1]), "shared stiffness is not positive definite"),
        (lambda rom: replace(rom, stiffness=rom.stiffness - 1e-9 * (rom.stiffness == 0)), "least κ = -1e-09"),
        (lambda rom: replace(rom, stiffness=0 * rom.stiffness), "least κ = 0"),
        (
            lambda rom: with_first(
                rom, eigenvalues=np.where(np.arange(26) == 6, 0, rom.contact_models["right"].eigenvalues)
            ),
            "least eigenvalue 0 is not positive",
        ),
        (
            lambda rom: with_first(rom, eigenvalues=np.maximum(rom.contact_models["right"].eigenvalues, 1e-3)),
            "does not begin with the 6 rigid motions",
        ),
        (
            lambda rom: with_first(rom, coordinates=rom.contact_models["right"].coordinates + 1e-14),
            "does not begin with the 6 rigid motions",
        ),
    ],
)
def test_zeros_that_are_no_rigid_motions_are_refused(rom, broken, message):
    with pytest.raises(StructureError, match=message):
        check_rom(broken(rom))
