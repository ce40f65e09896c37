"""A run beyond what its model was trained on says so wherever its numbers are shown."""

from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.rom.deformation import TrainingRange

SAYS = "input 'cable' reached 1.2 N, 6 times the 0.2 N of training"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A ROM trained to 0.2 N, scenes that pull with that and six times as much, and their runs."""
    folder, rom = tmp_path_factory.mktemp("beyond"), soft_rom()
    seen = TrainingRange({"air": 1.0, "cable": 0.2}, {"tip": 1.0, "middle": 1.0}, np.ones(36), 0.0)
    rom = replace(rom, deformation=replace(rom.deformation, trained=seen))
    fr.write_rom(folder / "rom.h5", rom)
    for name, force in (("within", 0.2), ("beyond", 1.2)):
        text = rom.scene_text + f'[[run.load]]\nactuator = "cable"\nforce = [{force}]\n'
        (folder / f"{name}.toml").write_text(text)
    return folder


def said(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert ended.value.code == 0
    return capsys.readouterr().out


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_simulate_info_compare_and_plot_say_it(files, capsys):
    for name in ("within", "beyond"):
        text = said(capsys, "simulate", files / "rom.h5", "--scene", files / f"{name}.toml", "-o", files / f"{name}.h5")
        assert (SAYS in text) == (name == "beyond")
    assert SAYS in said(capsys, "info", files / "beyond.h5")
    assert SAYS not in said(capsys, "info", files / "within.h5")
    text = said(capsys, "compare", files / "beyond.h5", files / "within.h5")
    assert any(f"{files / 'beyond.h5'}: beyond what" in line and SAYS in line for line in text.splitlines())
    text = said(capsys, "plot", files / "beyond.h5", files / "within.h5", "-o", files / "runs.svg")
    assert f"beyond: beyond what the model was trained on: {SAYS}" in text
    drawn = (files / "runs.svg").read_text()
    assert "beyond: beyond its training" in drawn
    assert "within: beyond its training" not in drawn
