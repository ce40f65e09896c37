"""The table of demos, and the first steps, which run from the mesh to the address of the live view."""

import re
import runpy
from pathlib import Path

import pytest

import fenics_rom as fr
from fenics_rom.visualization.viewer import view as view_module

DEMOS = Path(__file__).parents[2] / "demos"
TABLE = (DEMOS / "README.md").read_text()


def test_every_demo_is_in_the_table():
    rows = re.findall(r"^\| \[(\w+)\]\((\w+)\) \|(.*)\|(.*)\|(.*)\| (`.*) \|$", TABLE, flags=re.M)
    folders = {path.parent.name for path in DEMOS.glob("*/*.py")}
    assert sorted(name for name, *_ in rows) == sorted(folders)
    for name, link, picture, shows, time, run in rows:
        assert name == link
        assert f"bash demos/run.sh {name}" in run or f"demos/{name}/" in run
        assert len(shows) > 20
        assert re.fullmatch(r" (\d+|some) (s|min) ", time)
        if picture.strip():
            assert (DEMOS / re.search(r'src="(.*?)"', picture)[1]).stat().st_size > 10_000


def test_pictures_are_made_by_commands_that_there_are():
    script = (DEMOS / "pictures.sh").read_text()
    made = re.findall(r"^fenics_rom (?:export|plot) .* -o (\S+)", script, flags=re.M)
    assert made
    for picture in made:
        assert (DEMOS.parent / picture).is_file()


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.slow
def test_first_steps_lead_to_the_live_view(tmp_path, monkeypatch, capsys):
    shown = []
    monkeypatch.setattr(view_module, "view", lambda files: shown.extend(files))
    monkeypatch.chdir(tmp_path)
    script = DEMOS / "first_steps.py"
    fast = tmp_path / "first_steps.py"
    fast.write_text(script.read_text().replace('"tongue.gif")', '"tongue.gif", seconds=0.2)').replace("0.008", "0.02"))
    runpy.run_path(str(fast))
    assert shown == [Path("first_steps/tongue.h5")]
    error, speed = map(float, capsys.readouterr().out.splitlines()[-1].split())
    assert error < 1e-3
    assert speed > 1
    made = {path.name for path in (tmp_path / "first_steps").iterdir()}
    assert made == {"tongue.msh", "tongue.toml", "tongue.h5", "modes.png", "tongue.gif", "run.pdf"}
    assert fr.read_rom("first_steps/tongue.h5").contact_models.keys() == {"tip", "middle"}
