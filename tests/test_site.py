"""The site: each page runs from top to bottom as a reader would type it, and the whole builds without a warning."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted(page for page in (ROOT / "docs").rglob("*.md") if "```python" in page.read_text())
BLOCK = re.compile(r"^```(toml|python|sh)\n(.*?)^```", flags=re.S | re.M)


def typed(page):
    """A page as one script: a file for each scene, which names it in its first line, Python, and commands."""
    script = ["import subprocess, sys"]
    for language, block in BLOCK.findall(page.read_text()):
        if language == "toml":
            name = re.match(r"# (\S+\.toml)", block)[1]
            script.append(f"open({name!r}, 'w').write({block!r})")
        elif language == "python":
            script.append(block)
        else:
            commands = [line.split() for line in block.splitlines() if line.startswith("fenics-rom")]
            script += [
                f"subprocess.run([sys.executable, '-m', *{['fenics_rom', *c[1:]]}], check=True)" for c in commands
            ]
    return "\n".join(script)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs_from_top_to_bottom(page, tmp_path, zoo_folder):
    (tmp_path / zoo_folder.name).symlink_to(zoo_folder)
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    run = subprocess.run([sys.executable, "-c", typed(page)], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", "-c", ROOT / "docs", ROOT, tmp_path / "site"]
    run = subprocess.run(build, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert (tmp_path / "site" / "docs" / "index.html").is_file()
