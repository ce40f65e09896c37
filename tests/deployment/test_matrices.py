"""Files of state spaces, as NumPy and MATLAB's format read them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from test_c_source import linearised

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, StepError


def of_numpy(file):
    with np.load(file) as parts:
        return {name: parts[name] for name in parts.files}


def of_matlab(file):
    parts = {}
    for contact, fields in scipy.io.loadmat(file, simplify_cells=True)["plant"].items():
        parts |= {f"{contact}/{name}": np.asarray(part) for name, part in fields.items() if name != "switch_to"}
        parts |= {f"{contact}/switch_to/{name}": part for name, part in fields["switch_to"].items()}
    return parts


@pytest.mark.parametrize(("ending", "read"), [("npz", of_numpy), ("mat", of_matlab)])
@pytest.mark.parametrize("dt", [None, 1e-3])
def test_files_hold_state_spaces_and_the_maps_between_them(plate_rom, tmp_path, ending, read, dt):
    parts = read(fr.export(plate_rom, tmp_path / f"plant.{ending}", dt=dt))
    for contact, other in (("middle", "tip_left"), ("tip_left", "middle")):
        plant = plate_rom.state_space(contact, dt=dt)
        for name, matrix in zip("ABCD", plant, strict=True):
            np.testing.assert_array_equal(parts.pop(f"{contact}/{name}"), matrix)
        assert parts.pop(f"{contact}/dt") == plant.dt
        for what in ("states", "inputs", "outputs"):
            assert parts.pop(f"{contact}/{what}").tolist() == list(getattr(plant, what))
            assert parts.pop(f"{contact}/{what[:-1]}_units").tolist() == list(getattr(plant, what).values())
        np.testing.assert_array_equal(parts.pop(f"{contact}/switch_to/{other}"), plate_rom.switch_map(contact, other))
    assert not parts


def test_models_about_a_state_say_where(plate_rom, tmp_path, capsys):
    """Also of a run that the command line reads."""
    rom, at = linearised("large", plate_rom)
    plant = rom.state_space(at.contact, dt=5e-3, at=at)
    found = np.load(fr.export(rom, tmp_path / "plant.npz", dt=5e-3, at=at))
    for key, expected in {**dict(zip("ABCD", plant, strict=True)), **plant.about._asdict()}.items():
        np.testing.assert_array_equal(found[f"{at.contact}/{key if len(key) == 1 else f'about/{key}'}"], expected)
    assert {name.split("/")[0] for name in found} == {at.contact}
    fr.write_rom(tmp_path / "soft.h5", rom)
    fr.write_trajectory(tmp_path / "run.h5", run := fr.simulate(rom))
    model, again = str(tmp_path / "soft.h5"), tmp_path / "again.npz"
    with pytest.raises(SystemExit) as ended:
        main(["export", model, "-o", str(again), "--dt", "5e-3", "--at", str(tmp_path / "run.h5")])
    assert ended.value.code in (0, None)
    contact = run.contacts[run.contact[-1]]
    np.testing.assert_array_equal(np.load(again)[f"{contact}/A"], rom.state_space(contact, dt=5e-3, at=run).A)
    with pytest.raises(SystemExit):
        main(["export", model, "-o", str(tmp_path / "other.npz"), "--dt", "5e-3", "--at", model])
    assert "error: " in capsys.readouterr().err


def test_export_says_what_it_cannot_do(plate_rom, tmp_path, capsys):
    for chosen, error, message in (
        ({"outputs": ["top"]}, StepError, "no output 'top'; there is tip"),
        ({"what": "modes"}, FileError, "has neither shapes nor instants"),
    ):
        with pytest.raises(error, match=message):
            fr.export(plate_rom, tmp_path / "plant.npz", **chosen)
    with pytest.raises(FileError, match=r"--dt, --outputs and --at are for models of ROMs: \.npz"):
        fr.export(plate_rom, tmp_path / "plate.png", dt=1e-3)
    models = dict(zip(("tip-left", "tip_left"), plate_rom.contact_models.values(), strict=True))
    with pytest.raises(FileError, match="'tip-left' and 'tip_left' would both be called tip_left in code"):
        fr.export(replace(plate_rom, contact_models=models), tmp_path / "plant.mat")
    assert not any(tmp_path.iterdir())
    fr.write_rom(tmp_path / "plate.h5", plate_rom)
    with pytest.raises(SystemExit) as ended:
        main(["export", str(tmp_path / "plate.h5"), "-o", str(tmp_path / "plant.npz"), "--dt", "0"])
    assert ended.value.code == 1
    assert capsys.readouterr().err == "fenics-rom: error: dt = 0.0: use a finite number > 0, in s\n"
