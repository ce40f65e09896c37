"""The table of demos, and the first steps, which run from the mesh to the address of the live view."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import fenics_rom as fr

DEMOS = Path(__file__).parents[2] / "demos"
TABLE = (DEMOS / "README.md").read_text()


def test_every_demo_is_in_the_table():
    rows = re.findall(r"^\| \[(\w+)\]\((\w+)/README\.md\) \|(.*)\|(.*)\|(.*)\| (`.*) \|$", TABLE, flags=re.M)
    folders = {path.parent.name for path in DEMOS.glob("*/*.py")}
    assert sorted(name for name, *_ in rows) == sorted(folders)
    for name, link, picture, shows, takes, run in rows:
        assert name == link
        assert f"bash demos/run.sh {name}" in run or f"demos/{name}/" in run
        assert len(shows) > 20
        assert re.fullmatch(r" (\d+|some) (s|min) ", takes)
        if picture.strip():
            assert (DEMOS / re.search(r'src="(.*?)"', picture)[1]).stat().st_size > 10_000


def test_pictures_are_made_by_commands_that_there_are():
    script = (DEMOS / "pictures.sh").read_text()
    made = re.findall(r"^fenics_rom (?:export|plot) .* -o (\S+)", script, flags=re.M)
    assert made
    for picture in made:
        assert (DEMOS.parent / picture).is_file()


@pytest.mark.slow
def test_first_steps_lead_to_the_live_view(tmp_path):
    fast = tmp_path / "first_steps.py"
    text = (DEMOS / "first_steps.py").read_text()
    fast.write_text(text.replace('"tongue.gif")', '"tongue.gif", seconds=0.2)').replace("0.008", "0.02"))
    hears = "import runpy, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "  # in a job, too
    command = [sys.executable, "-u", "-c", f"{hears}runpy.run_path(sys.argv[1], run_name='__main__')", str(fast)]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        said = []
        for line in run.stdout:
            said.append(line)
            if "End with Ctrl-C" in line:
                break
        time.sleep(1.0)  # so that it steps
        run.send_signal(signal.SIGINT)
        try:
            _, errors = run.communicate(timeout=60)
        finally:
            run.kill()
    assert run.returncode == 0, errors
    assert re.search(r"tongue: http://127\.0\.0\.1:\d+/\S+/", "".join(said))
    error, speed = map(float, next(line for line in said if re.match(r"\S+e-\d+ \S+$", line)).split())
    assert error < 1e-3
    assert speed > 1
    made = {path.name for path in (tmp_path / "first_steps").iterdir()}
    assert made == {"tongue.msh", "tongue.toml", "tongue.h5", "modes.png", "tongue.gif", "run.pdf"}
    assert fr.read_rom(tmp_path / "first_steps" / "tongue.h5").contact_models.keys() == {"tip", "middle"}
