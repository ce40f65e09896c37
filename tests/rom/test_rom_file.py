"""ROM and run files: what is written is read again, there is never half a file, and nothing else is taken for one."""

import os
import re
import resource
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from ranks import run_ranks
from rom_files import put, refusal, same, says, tampered, transfer, without

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FileError, RomFileError, StructureError, TrajectoryFileError
from fenics_rom.io.hdf5 import LONGEST_TEXT, content_of, sealed
from fenics_rom.io.stages import Stage
from fenics_rom.mechanics.environment import AppliedLoad, Load, Run
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.file import LONGEST

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
DATA = Path(__file__).parents[1] / "data"
KINDS = (
    *("energy", "selection", "oblique", "dense damping", "actuators and tables", "no outputs", "own matrices"),
    *("eigenvectors", "nothing measured"),
)


def own_matrices():
    """A ROM without a mesh: a row of seven masses."""
    chain = 2 * np.eye(7) - np.eye(7, k=1) - np.eye(7, k=-1)
    ends = {"first": np.eye(7)[:, :1], "last": np.eye(7)[:, 6:]}
    system = fr.System(
        mass=np.eye(7), damping=chain / 9, stiffness=chain, contacts=ends, outputs={"ends": np.eye(7)[:, ::6]}
    )
    return fr.reduce(system, order=3)


@pytest.fixture(scope="session")
def roms(plate_system, box_system):
    """One ROM of each kind that a file can hold."""
    energy, oblique = (fr.reduce(plate_system, order=4, switching=s) for s in ("energy", "oblique"))
    selection = fr.reduce(plate_system, order=4, method="eigenvector-selection")
    shaken = {
        name: replace(mode, damping=np.diag(mode.damping) + np.ones((mode.order, mode.order)))
        for name, mode in energy.contact_models.items()
    }
    ramp = Signal(np.arange(6.0).reshape(2, 3), np.array([0.0, 1.0]))
    pushes = AppliedLoad("right", None, 0.0, 0.5, ramp), AppliedLoad(None, "pull", 0.25, 1.0, Signal(np.ones(1)))
    tabled = replace(energy.environment, run=Run(0.01, 1.0, 7, pushes), source="tabled.toml")
    return {
        "energy": energy,
        "selection": selection,
        "oblique": oblique,
        "dense damping": replace(energy, contact_models=shaken),
        "actuators and tables": replace(fr.reduce(box_system, order=4), environment=tabled, warnings=("one", "two")),
        "no outputs": replace(energy, outputs={}, weighting="nodal"),
        "own matrices": own_matrices(),
        "eigenvectors": fr.reduce(plate_system, order=4, method="modal"),
        "nothing measured": fr.truncate(replace(energy, method="<lambda>", stages=()), 3),
    }


@pytest.fixture
def rom(roms):
    return roms["energy"]


@pytest.fixture
def run():
    return fr.read_trajectory(DATA / "run-1.0.h5")


@pytest.fixture
def rom_file(tmp_path, rom):
    fr.write_rom(tmp_path / "rom.h5", rom)
    return tmp_path / "rom.h5"


@pytest.fixture
def run_file(tmp_path, run):
    fr.write_trajectory(tmp_path / "run.h5", run)
    return tmp_path / "run.h5"


def group(path):
    return lambda h5: (h5.pop(path, None), h5.create_group(path, track_order=True))


def announced(path, shape, **options):
    """A change that makes an array of a size of which nothing is stored."""
    return lambda h5: (h5.pop(path), h5.create_dataset(path, shape, float, **options))


def with_mode(rom, **changes):
    """A ROM with a changed first contact mode."""
    name, mode = next(iter(rom.contact_models.items()))
    return replace(rom, contact_models={**rom.contact_models, name: replace(mode, **changes)})


# --- round trips -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_is_read_to_the_last_bit(roms, tmp_path, kind):
    fr.write_rom(tmp_path / "rom.h5", roms[kind])
    assert same(fr.read_rom(tmp_path / "rom.h5"), roms[kind])
    assert content_of(tmp_path / "rom.h5") == "rom"


@pytest.mark.parametrize(
    "changes",
    [{}, {"outputs": {}}, {"warnings": ("one", "two")}, {"name": "Prüfling ☃"}, {"triangles": np.empty((0, 3), int)}],
)
def test_what_is_written_of_a_run_is_read_to_the_last_bit(tmp_path, run, changes):
    run = replace(run, **changes)
    fr.write_trajectory(tmp_path / "run.h5", run)
    assert same(fr.read_trajectory(tmp_path / "run.h5"), run)
    assert content_of(tmp_path / "run.h5") == "run"


def test_a_read_rom_runs_as_the_one_in_memory(rom, rom_file):
    runs = [fr.simulate(each, dt=0.01) for each in (rom, fr.read_rom(rom_file))]
    assert same(*(replace(run, settings={}) for run in runs))  # the settings hold the wall clock


def test_longest_scene_goes_into_a_file(tmp_path, rom):
    assert LONGEST <= LONGEST_TEXT
    rom = replace(rom, scene_text=LONGEST * "x", warnings=tuple(10 * ["w" * 1000]))
    fr.write_rom(tmp_path / "rom.h5", rom)
    assert same(fr.read_rom(tmp_path / "rom.h5"), rom)


def test_names_of_stages_are_any_text(tmp_path, rom):
    """Methods are anyone's, and so are the names of what they spend their time on."""
    stages = (Stage("modes/K⁻¹\nλ ", 0.0, 0.0), Stage("", 1e5, 2e12), Stage("", 0.25, 1.5))
    fr.write_rom(tmp_path / "rom.h5", replace(rom, stages=stages))
    assert fr.read_rom(tmp_path / "rom.h5").stages == stages


# --- formats 1.0 and 1.1 ---------------------------------------------------------------------------------------------


def test_files_of_format_1_0_load_for_ever():
    """Written by release 0.1.0: a box of two bricks at order 4, everything that a scene can hold in it, and its run.

    To be read by every release that reads format 1, and never to be written anew: a change of the format that
    needs that is format 2.
    """
    rom, run = fr.read_rom(DATA / "rom-1.0.h5"), fr.read_trajectory(DATA / "run-1.0.h5")
    assert rom.contacts == {"right": 3, "corner": 1}
    assert rom.actuators == {"pull": 1}
    assert {name: rows.shape for name, rows in rom.outputs.items()} == {"tip": (6, 8), "face": (3, 8)}
    assert rom.environment.effects == {"inertia": "", "damping": "alpha 1 1/s, beta 0.001 s"}
    assert any(load.signal.times is not None for load in rom.environment.run.loads)
    assert rom.name == run.name == "box"
    assert run.steps == 40
    assert run.balance_error < 3e-14
    assert (rom.method, rom.stages) == ("balanced", ())
    for validation in rom.validation.values():
        assert validation["transfer_error"] is None
        assert 0 < validation["static_error"] < 0.1
        assert 0 < validation["neglected"] < 0.1
    again = fr.simulate(rom)
    np.testing.assert_allclose(again.snapshots, run.snapshots, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(again.outputs["tip"], run.outputs["tip"], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(again.energy, run.energy, rtol=1e-9, atol=1e-15)


def test_roms_of_format_1_1_load_for_ever():
    """Written on the way to release 0.2.0: the same box at order 8, in eigenvectors and static shapes.

    With a validation, and with what it cost. As those of format 1.0, it is never to be written anew.
    """
    rom = fr.read_rom(DATA / "rom-1.1.h5")
    assert (rom.name, rom.method) == ("box", "modal+static")
    assert [stage.name for stage in rom.stages][:2] == ["assembly", "factorisation of K"]
    assert all(stage.seconds > 0 and stage.peak_memory > 1e6 for stage in rom.stages)
    for name, validation in rom.validation.items():
        mode = rom.contact_models[name]
        assert len(mode.hankel_singular_values) == 0
        assert len(mode.frequencies) == len(mode.transfer_errors) > 2
        assert validation["neglected"] is None
        assert 0 < validation["static_error"] < validation["transfer_error"] < 0.1
    assert fr.simulate(rom).balance_error < 3e-14


def test_selection_of_eigenvectors_was_a_switching_in_format_1(tmp_path):
    file = tmp_path / "rom.h5"
    file.write_bytes((DATA / "rom-1.1.h5").read_bytes())
    with h5py.File(file, "r+") as h5:
        h5.attrs["switching"], h5.attrs["method"] = np.bytes_("modal"), np.bytes_("balanced")
        chosen = b'method = "balanced"\nswitching = "modal"'
        text = h5.attrs["scene"].replace(b'method = "modal+static"', chosen)
        h5.attrs["scene"] = np.bytes_(text)
    content = file.read_bytes()
    file.write_bytes(sealed(content) + content[512:])
    rom = fr.read_rom(file)
    assert (rom.method, rom.switching) == ("eigenvector-selection", "energy")
    assert 'method = "eigenvector-selection"' in rom.scene_text


def test_files_of_format_1_2_load_for_ever():
    """Written on the way to release 0.2.0: a free box of 0.12 m³ on a rough floor; never to be written anew."""
    rom, run = fr.read_rom(DATA / "rom-1.2.h5"), fr.read_trajectory(DATA / "run-1.2.h5")
    assert (rom.rigid, rom.contact_models["bottom"].order, rom.loads, rom.actuators) == (
        6,
        12,
        {"gravity": 1},
        {"back": 1},
    )
    assert len(rom.contact_models["bottom"].contact_points) == 6
    assert run.effects == ("inertia", "damping", "gravity", "pressure", "contact", "friction")
    assert run.profile.keys() == {"switching", "gravity", "inertia, damping, elasticity", "contact, friction"}
    np.testing.assert_allclose(run.forces["floor"][-1], [0, 0, 1000 * 0.12 * 9.81], atol=1e-6)
    again = fr.simulate(rom)
    # Until an obstacle stops it: since then what it stops comes to rest on its surface, and not where it was stopped.
    before = slice(np.flatnonzero(run.forces["floor"].any(axis=1))[0])
    np.testing.assert_allclose(again.outputs["tip"][before], run.outputs["tip"][before], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(again.forces["floor"][-1], run.forces["floor"][-1], atol=1e-6)
    assert again.contact_account.keys() == run.contact_account.keys()


def test_files_of_format_2_load_for_ever():
    """Written on the way to 0.2.0: a rubber box, bent by its cable, then by air, on a rough floor."""
    rom, run = fr.read_rom(DATA / "rom-2.8.h5"), fr.read_trajectory(DATA / "run-2.8.h5")
    assert (rom.deformation.law, list(rom.actuators)) == ("neo_hookean", ["air", "cable"])
    assert run.effects == ("inertia", "damping", "pressure", "tendon", "large_deformation", "contact", "friction")
    assert run.forces["floor"].any()
    assert run.balance_error < 3e-14
    again = fr.simulate(rom, stepper="linearly-implicit")  # whose viscosity resists J'/J since, which the run's did not
    np.testing.assert_allclose(again.snapshots, run.snapshots, rtol=0, atol=3e-3 * abs(run.snapshots).max())
    np.testing.assert_allclose(
        again.forces["floor"], run.forces["floor"], rtol=0, atol=1e-2 * run.forces["floor"].max()
    )


def test_later_minor_version_loads(rom_file, rom):
    tampered(rom_file, lambda h5: h5.attrs.update(format_version=np.bytes_("2.9"), remark=np.bytes_("new")))
    assert same(fr.read_rom(rom_file), rom)


# --- never half a file -----------------------------------------------------------------------------------------------


@contextmanager
def disk_of(size):
    """Files can have that many bytes, as if the disk were full then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class Interrupted(dict):
    """Outputs that somebody presses Ctrl-C at."""

    def items(self):
        raise KeyboardInterrupt


@pytest.mark.parametrize("size", [0, 300, 3000, 20_000])
def test_full_disk_leaves_the_old_file(rom, rom_file, size):
    before = rom_file.read_bytes()
    with disk_of(size), pytest.raises(FileError) as caught:
        fr.write_rom(rom_file, replace(rom, name="new"))
    assert str(caught.value) == f"{rom_file}: cannot be written: File too large"
    assert rom_file.read_bytes() == before
    assert list(rom_file.parent.iterdir()) == [rom_file]


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"nodes": np.full((3, 3), np.nan)}, FileError),
        ({"stiffness": -np.ones(8)}, StructureError),
        ({"outputs": Interrupted(tip=None)}, KeyboardInterrupt),
    ],
)
def test_failed_writing_leaves_the_old_file(rom, rom_file, changes, error):
    before = rom_file.read_bytes()
    with pytest.raises(error):
        fr.write_rom(rom_file, replace(rom, **changes))
    assert rom_file.read_bytes() == before
    assert list(rom_file.parent.iterdir()) == [rom_file]


def test_new_file_replaces_the_old_one(rom, rom_file):
    fr.write_rom(rom_file, replace(rom, name="new"))
    assert fr.read_rom(rom_file).name == "new"
    assert list(rom_file.parent.iterdir()) == [rom_file]


def test_place_that_cannot_be_written_to_is_told(tmp_path, rom):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for place, reason in (
        (tmp_path / "none" / "rom.h5", f"folder {tmp_path / 'none'} does not exist"),
        (tmp_path, "it is a folder or a device"),
        (pipe, "it is a folder or a device"),  # as /dev/null is, which root could replace by a file
        (tmp_path / (300 * "x"), "File name too long"),
    ):
        with pytest.raises(FileError) as caught:
            fr.write_rom(place, rom)
        assert str(caught.value) == f"{place}: cannot be written: {reason}"
    assert list(tmp_path.iterdir()) == [pipe]
    assert pipe.is_fifo()


@pytest.mark.parametrize(("uses_mpi", "written"), [("from mpi4py import MPI", 1), ("", 2)])
@pytest.mark.ranks
def test_of_the_ranks_of_a_program_the_first_alone_writes(tmp_path, uses_mpi, written):
    """Two programs that know nothing of each other are no ranks, whoever launched them."""
    script = f"""
import os, fenics_rom as fr
rom = fr.read_rom({str(DATA / "rom-1.0.h5")!r})
{uses_mpi}
fr.write_rom(f"{{os.getpid()}}.h5", rom)
"""
    done = run_ranks(2, "-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("*.h5"))) == written


def test_callers_can_tell_files_of_roms_and_runs_apart(tmp_path, rom):
    for read, error in (
        (fr.read_rom, RomFileError),
        (fr.read_trajectory, TrajectoryFileError),
        (content_of, FileError),
    ):
        with pytest.raises(FileError) as caught:
            read(tmp_path / "none.h5")
        assert type(caught.value) is error
    with pytest.raises(RomFileError):
        fr.write_rom(tmp_path, rom)


# --- damage ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "read"),
    [
        *((f"rom-{version}.h5", fr.read_rom) for version in ("1.0", "1.1", "1.2")),
        *((f"run-{version}.h5", fr.read_trajectory) for version in ("1.0", "1.2")),
    ],
)
class TestDamage:
    """HDF5 itself crashes on some damaged files, so these must not reach it."""

    def test_no_changed_byte_goes_unnoticed(self, tmp_path, name, read):
        whole, random, file = (DATA / name).read_bytes(), np.random.default_rng(7), tmp_path / name
        for at in [*range(0, 140), *random.integers(140, len(whole), 200)]:
            damaged = bytearray(whole)
            damaged[at] ^= 1 << random.integers(8)
            file.write_bytes(damaged)
            assert refusal(read, file) in (
                "is damaged: its content is not what was written (the checksum differs)",
                "is not a fenics-rom file",
            )

    def test_truncated_file_is_refused(self, tmp_path, name, read):
        whole, file = (DATA / name).read_bytes(), tmp_path / name
        for length in [0, 1, 10, 100, 511, 512, 513, *range(600, len(whole), 700), len(whole) - 1]:
            file.write_bytes(whole[:length])
            assert "is damaged" in refusal(read, file) or length <= 10
        file.write_bytes(whole + b"\0")
        assert "is damaged" in refusal(read, file)

    def test_resealed_garbage_is_refused(self, tmp_path, name, read):
        """A seal keeps accidents out, not malice; what HDF5 cannot make sense of is refused after it, too."""
        whole, file = (DATA / name).read_bytes(), tmp_path / name
        for content in (whole[:512], whole[:520], whole[:512] + bytes(5000), whole[:5000]):
            file.write_bytes(sealed(content) + content[512:])
            assert "cannot be read: " in refusal(read, file)


@pytest.mark.parametrize("content", [b"", b"name = 'plate'\n", b"\x89HDF\r\n\x1a\n" + bytes(2000)])
@pytest.mark.parametrize("read", [fr.read_rom, fr.read_trajectory, content_of])
def test_other_files_are_refused(tmp_path, content, read):
    file = tmp_path / "some.h5"
    file.write_bytes(content)
    assert refusal(read, file) == "is not a fenics-rom file"


@pytest.mark.parametrize("read", [fr.read_rom, fr.read_trajectory, content_of])
def test_no_file_is_told(tmp_path, read):
    assert refusal(read, tmp_path / "none.h5") == "not found"
    assert refusal(read, tmp_path) == "is a folder or a device"


def test_a_rom_is_no_run_and_a_run_no_rom():
    assert refusal(fr.read_rom, DATA / "run-1.0.h5") == "is a run; use a ROM"
    assert refusal(fr.read_trajectory, DATA / "rom-1.0.h5") == "is a ROM; use a run"


# --- files that are not what they say --------------------------------------------------------------------------------

MODE = "contact_models/tip_left"
LIES = {
    "is not a fenics-rom file": says(format="other"),
    "has format version 3.0; this release reads 1 and 2.x": says(format_version="3.0"),
    "is a film; use a ROM": says(content="film"),
    "/environment has 'wind', which acts and which this release does not know": lambda h5: h5.create_group(
        "environment/wind"
    ),
    "no weighting 'volume'; there is mass, nodal, outputs": says(weighting="volume"),
    "hankel_singular_values has unit 's^2/kg^1/2', not 's^2/kg'": says(weighting="nodal"),
    "no switching 'enrgy'; there is energy, oblique; did you mean 'energy'?": says(switching="enrgy"),
    "left_inverse goes with oblique switching, and only with it": says(switching="oblique"),
    "contact mode 'tip_left': left_inverse goes with oblique": put(f"{MODE}/left_inverse", np.ones((4, 8))),
    "attribute 'name' of / is missing or not text": lambda h5: h5.attrs.pop("name"),
    "attribute 'scene' of / is missing or not text": lambda h5: h5.attrs.update(scene=1),
    "attribute 'name' of / is not UTF-8": says(name=b"\xfc"),
    "/basis is missing": without("basis"),
    f"/{MODE}/inputs is missing": without(f"{MODE}/inputs"),
    "/outputs is missing": without("outputs"),
    "/contact_models is missing": lambda h5: (h5.pop("contact_models"), h5.update(contact_models=[1.0])),
    "/environment: no contact_switching 'manual'; there is automatic, scene": lambda h5: h5["environment"].attrs.update(
        contact_switching=np.bytes_("manual")
    ),
    "/environment/run/dt is missing": without("environment/run/dt"),
    "unexpected more in /": put("more", [1.0]),
    f"unexpected more in /{MODE}": put(f"{MODE}/more", [1.0]),
    "unexpected 7 in /environment/run": put("environment/run/7", np.eye(2)),
    "/environment/loads/wind/columns is missing": group("environment/loads/wind"),
    "/environment/obstacles/wind: no shape 'cone'": lambda h5: h5.create_group(
        "environment/obstacles/wind"
    ).attrs.update(shape=np.bytes_("cone")),
    "/free has shape (180,); use ('n',) with n = 5": put("basis", np.ones((5, 8))),
    "/stiffness has shape (7,); use ('k',) with k = 8": put("stiffness", np.ones(7)),
    "/free has 2 dimensions, not 1": put("free", lambda free: free[None]),
    "/nodes has shape (66, 2); use ('N', 3) with 3 = 3": put("nodes", np.ones((66, 2))),
    f"/{MODE}/directions has shape (3, 3); use ('m', 'm') with m = 4": put(f"{MODE}/directions", np.eye(3)),
    "/node_mass holds numbers that are not finite": put("node_mass", lambda mass: mass * np.nan),
    f"/{MODE}/damping holds numbers that are not finite": put(f"{MODE}/damping", np.full(4, np.inf)),
    "/stiffness is not an array of real numbers": put("stiffness", np.arange(8)),
    "/node_mass is not an array of real numbers": put("node_mass", np.ones(66, np.float32)),
    "/nodes is not an array of real numbers": put("nodes", np.bytes_("soft")),
    "/basis is not an array of real numbers": group("basis"),
    "/free is not an array of whole numbers": put("free", np.arange(180.0)),
    "/nodes has unit 'mm', not 'm'": put("nodes", np.ones((66, 3)), unit="mm"),
    "attribute 'unit' of /nodes is missing or not text": lambda h5: h5["nodes"].attrs.pop("unit"),
    "/basis says it has 64000000000000 bytes, but fewer are stored": announced("basis", (10**12, 8)),
    "/basis says it has 73786976294838206464 bytes": announced("basis", (2**61, 4), chunks=(1, 4)),
    "shared stiffness is not positive definite: least κ = 0": put("stiffness", np.zeros(8)),
    "contact mode 'tip_left': least eigenvalue -1 is not positive": put(f"{MODE}/eigenvalues", [-1.0, 1, 2, 3]),
    "not orthonormal in stiffness: off by 9.9e-03, at most 1e-10 is good": put(
        f"{MODE}/eigenvalues", lambda γ: 1.01 * γ
    ),
    "not orthonormal in mass: off by 2.0e-02, at most 1e-10 is good": put(f"{MODE}/coordinates", lambda C: 1.01 * C),
    "not orthonormal in mass: off by inf": put(f"{MODE}/coordinates", np.full((8, 4), 1e200)),
    "contact mode 'tip_left': directions are not orthonormal: off by 3": put(f"{MODE}/directions", 2 * np.eye(4)),
    "damping is not positive semi-definite, least -1": put(f"{MODE}/damping", -np.ones(4)),
    "damping is not positive semi-definite, least -2": put(f"{MODE}/damping", -2 * np.eye(4)),
    "contact mode 'tip_left': damping is not symmetric": put(f"{MODE}/damping", np.eye(4) + np.eye(4, k=1) / 9),
    "'tip_left': Hankel singular values must be positive": put(f"{MODE}/hankel_singular_values", [-1.0]),
    "/contact_models/middle/hankel_singular_values is empty": put(
        "contact_models/middle/hankel_singular_values", np.empty(0)
    ),
    "attribute 'method' of / is missing or not text": lambda h5: h5.attrs.update(method=1),
    f"/{MODE}/frequencies is empty": lambda h5: [
        put(f"{MODE}/{name}", lambda there: there[:0])(h5) for name in ("frequencies", "transfer_errors")
    ],
    "contact mode 'tip_left': frequencies and transfer_errors go together": without(f"{MODE}/frequencies"),
    "'tip_left': frequencies and transfer_errors go together": without(f"{MODE}/transfer_errors"),
    f"/{MODE}/transfer_errors has shape (2,); use ('f',) with f = 3": lambda h5: [
        put(f"{MODE}/frequencies", [1.0, 2.0, 3.0])(h5),
        put(f"{MODE}/transfer_errors", [0.1, 0.2])(h5),
    ],
    f"/{MODE}/frequencies has unit 'Hz', not 'rad/s'": put(f"{MODE}/frequencies", [1.0], unit="Hz"),
    f"/{MODE}/transfer_errors holds numbers that are not finite": put(f"{MODE}/transfer_errors", lambda e: np.nan * e),
    "'tip_left': frequencies must be positive, in ascending order": put(f"{MODE}/frequencies", lambda ω: ω - ω[0]),
    "frequencies must be positive, in ascending": put(f"{MODE}/frequencies", lambda ω: ω[::-1]),
    "contact mode 'tip_left': an error is negative": put(f"{MODE}/transfer_errors", lambda errors: -errors),
    "'tip_left': an error is negative": put(f"{MODE}/static_error", [-1e-9]),
    "/offline is missing": lambda h5: (h5.pop("offline"), h5.update(offline=[1.0])),
    "unexpected 99 in /offline": put("offline/99", [1.0, 1.0], unit="s, B"),
    "/offline/0 has shape (3,); use (2,)": put("offline/0", np.ones(3)),
    "/offline/0 has unit 's', not 's, B'": put("offline/0", np.ones(2), unit="s"),
    "attribute 'name' of /offline/0 is missing or not text": put("offline/0", np.ones(2)),
    "/offline has a negative time or memory": lambda h5: h5["offline/0"].write_direct(np.array([-1.0, 1.0])),
    "/offline has a negative time": lambda h5: h5["offline/0"].write_direct(np.array([1.0, -1.0])),
    "/free does not name components among 198, in ascending order": put("free", lambda free: free[::-1]),
    "/free does not name components among 198": put("free", lambda free: free + 99),
    "/triangles name nodes beyond 66": put("triangles", lambda triangles: triangles + 1),
    "/node_mass has negative masses": put("node_mass", -np.ones(66)),
    "an output does not have three rows a point": put("outputs/tip", np.ones((4, 8))),
    "an output does not have three rows": put("outputs/tip", np.ones((0, 8))),
    "/free does not name components among 180": lambda h5: [
        put(name, lambda there: there[:0])(h5) for name in ("nodes", "node_mass", "triangles")
    ],
    "contact mode 'tip_left' has fewer input columns than the actuators": put("actuators/pull", [4]),
    "an actuator or a load has a negative number of columns": put("actuators/pull", [-1]),
    "holds no contact modes, or an empty one": group("contact_models"),
}
RUN_LIES = {
    "/times does not increase, or is empty": put("times", np.zeros(41)),
    "/snapshot_times does not increase, or is empty": put("snapshot_times", [0.4, 0.3, 0.2, 0.1]),
    "/contact names contact modes beyond 2": put("contact", np.full(41, 2)),
    "/contact names contact modes": put("contact", np.full(41, -1)),
    "/triangles name nodes beyond 12": put("triangles", lambda triangles: triangles + 1),
    "/node_mass has negative masses": put("node_mass", -np.ones(12)),
    "/energy has shape (20,); use ('S',) with S = 41": put("energy", np.ones(20)),
    "/energy holds numbers that are not finite": put("energy", np.full(41, np.nan)),
    "/energy has unit 'mJ', not 'J'": put("energy", np.ones(41), unit="mJ"),
    "/outputs/tip has shape (20, 2, 3); use": put("outputs/tip", np.ones((20, 2, 3))),
    "/settings/dt is missing": without("settings/dt"),
    "unexpected more in /settings": put("settings/more", [1.0]),
    "is a ROM; use a run": says(content="rom"),
}


@pytest.mark.parametrize(("message", "lie"), LIES.items(), ids=LIES)
def test_rom_file_that_is_not_what_it_says_is_refused_with_the_reason(rom_file, message, lie):
    assert message in refusal(fr.read_rom, tampered(rom_file, lie))


@pytest.mark.parametrize(("message", "lie"), RUN_LIES.items(), ids=RUN_LIES)
def test_run_file_that_is_not_what_it_says_is_refused_with_the_reason(run_file, message, lie):
    assert message in refusal(fr.read_trajectory, tampered(run_file, lie))


BAD_ROMS = {
    "/basis holds numbers that are not finite": lambda rom: replace(rom, basis=rom.basis * np.nan),
    "/node_mass has shape": lambda rom: replace(rom, nodes=rom.nodes[1:]),
    "no switching 'free'": lambda rom: replace(rom, switching="free"),
    "/triangles name nodes beyond 66": lambda rom: replace(rom, triangles=rom.triangles + 99),
    "name 'a/b': use letters, digits, _ and -": lambda rom: replace(
        rom, contact_models={"a/b": rom.contact_models["middle"]}
    ),
    "name '': use letters, digits, _ and -": lambda rom: replace(rom, outputs={"": rom.outputs["tip"]}),
    "the loads of the environment are {'gravity': 1}": lambda rom: replace(
        rom, environment=replace(rom.environment, loads={"gravity": Load(1, None)})
    ),
    "/environment/loads/gravity/values holds numbers": lambda rom: replace(
        rom, environment=replace(rom.environment, loads={"gravity": Load(1, Signal(np.array([np.nan])))})
    ),
    "text 'scene' has 60001 bytes": lambda rom: replace(rom, scene_text=(LONGEST_TEXT + 1) * "x"),
    "/contact_models/tip_left/inputs has shape (3, 3)": lambda rom: with_mode(rom, inputs=np.ones((3, 3))),
    "damping is not positive semi-definite": lambda rom: with_mode(rom, damping=-np.ones(4)),
    "directions are not orthonormal": lambda rom: with_mode(rom, directions=np.ones((4, 4))),
    "/contact_models/tip_left/static_error holds numbers": lambda rom: with_mode(rom, static_error=np.nan),
    "frequencies and transfer_errors go together": lambda rom: with_mode(rom, frequencies=np.empty(0)),
    "/transfer_errors has shape (7,)": lambda rom: with_mode(rom, transfer_errors=np.ones(7)),
    "frequencies must be positive, in": lambda rom: with_mode(
        rom, frequencies=-rom.contact_models["tip_left"].frequencies
    ),
    "Hankel singular values must be positive": lambda rom: with_mode(rom, hankel_singular_values=np.zeros(4)),
    "/offline/0 holds numbers": lambda rom: replace(rom, stages=(Stage("assembly", np.inf, 1.0),)),
    "/offline has a negative": lambda rom: replace(rom, stages=(Stage("assembly", -1.0, 1.0),)),
}


@pytest.mark.parametrize(("message", "spoil"), BAD_ROMS.items(), ids=BAD_ROMS)
def test_what_would_not_be_read_is_not_written(tmp_path, rom, message, spoil):
    with pytest.raises(FenicsRomError, match=re.escape(message)):
        fr.write_rom(tmp_path / "rom.h5", spoil(rom))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"energy": np.full(41, np.inf)}, "/energy holds numbers that are not finite"),
        ({"contact": np.full(41, 9)}, "/contact names contact modes beyond 2"),
        ({"times": np.zeros(41)}, "/times does not increase"),
        ({"contacts": ("a\nb", "c")}, "name 'a\\nb': use letters"),
    ],
)
def test_what_would_not_be_read_of_a_run_is_not_written(tmp_path, run, changes, message):
    with pytest.raises(FileError, match=re.escape(message)):
        fr.write_trajectory(tmp_path / "run.h5", replace(run, **changes))
    assert not any(tmp_path.iterdir())


# --- lower orders ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 3, 7, 12, 20])
def test_order_k_of_a_stored_rom_is_the_reduction_to_order_k(plate_system, plate_rom, tmp_path, order):
    fr.write_rom(tmp_path / "rom.h5", plate_rom)
    stored, direct = fr.truncate(fr.read_rom(tmp_path / "rom.h5"), order), fr.reduce(plate_system, order=order)
    for name, mode in direct.contact_models.items():
        assert stored.contact_models[name].order == mode.order == order
        np.testing.assert_array_equal(stored.contact_models[name].hankel_singular_values, mode.hankel_singular_values)
        np.testing.assert_allclose(stored.contact_models[name].eigenvalues, mode.eigenvalues, rtol=1e-8)
        gap = np.abs(transfer(stored, name) - transfer(direct, name)).max()
        assert gap <= 1e-8 * np.abs(transfer(direct, name)).max()  # κ spans six decades
    fr.write_rom(tmp_path / "lower.h5", stored)  # it has all the structure of a ROM
    assert same(fr.read_rom(tmp_path / "lower.h5"), stored)


def test_lower_order_of_a_lower_order_is_that_order(plate_rom):
    once, twice = fr.truncate(plate_rom, 5), fr.truncate(fr.truncate(plate_rom, 11), 5)
    np.testing.assert_allclose(transfer(twice, "middle"), transfer(once, "middle"), rtol=1e-7, atol=1e-12)


def test_dense_damping_is_truncated_as_its_diagonal(plate_rom):
    dense = {name: replace(mode, damping=np.diag(mode.damping)) for name, mode in plate_rom.contact_models.items()}
    lower = [fr.truncate(rom, 6) for rom in (plate_rom, replace(plate_rom, contact_models=dense))]
    assert lower[1].contact_models["middle"].damping.shape == (6, 6)
    np.testing.assert_allclose(*(transfer(rom, "middle") for rom in lower), rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "order", "message"),
    [
        ("energy", 0, "order 0: use 1 to 4, the largest order in the ROM"),
        ("energy", 5, "order 5: use 1 to 4, the largest order in the ROM"),
        ("oblique", 2, "a ROM with oblique switching cannot be truncated; reduce to that order instead"),
    ],
)
def test_order_that_is_not_there_is_told(roms, kind, order, message):
    with pytest.raises(StructureError, match=message):
        fr.truncate(roms[kind], order)
