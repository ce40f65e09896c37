"""Rates beside those of another commit: each version steps its own package, and nothing of it stays."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = Path("demos", "rates", "beside_commit.py")
pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")


def git(folder, *arguments):
    named = {f"GIT_{who}_{what}": "test" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    ran = subprocess.run(["git", *arguments], cwd=folder, env=os.environ | named, capture_output=True, check=True)
    return ran.stdout.decode()


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A repository of one commit, which has this package and what the script takes of demos."""
    folder = tmp_path_factory.mktemp("project")
    demos = ("rates", "contact_rates", "bending", "plate", "swing", "spin", "gripper")
    for part in ("fenics_rom", "meshes", *(f"demos/{name}" for name in demos)):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "out"))
    git(folder, "init", "--quiet")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--no-gpg-sign", "--message", "All of it")
    return folder


@pytest.fixture
def beside(project, tmp_path):
    """Runs the script of the repository; nothing stays of that, neither files nor changes."""

    def run(*arguments, folder=project):
        command = [sys.executable, folder / SCRIPT, "--quick", *arguments]
        quiet = {"TMPDIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(ROOT)}
        before = git(project, "status", "--porcelain")
        ran = subprocess.run(command, capture_output=True, text=True, env=os.environ | quiet)
        assert not list(tmp_path.glob("fenics-rom-*"))
        assert git(project, "status", "--porcelain") == before
        return ran

    yield run
    git(project, "checkout", "--quiet", ".")


def change(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def rows(ran):
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in ran.stdout.splitlines() if "|" in line][2:]


@pytest.mark.slow
def test_a_commit_steps_as_itself(beside):
    ran = beside("HEAD", "pad, random", "batch, 8 points, at rest", "arm, neo_hookean")
    assert "not committed" not in ran.stdout
    names = "pad, random pushes", "batch, 8 points, at rest", "arm, neo_hookean, order 8"
    for name, (case, before, now, *numbers, difference) in zip(names, rows(ran), strict=True):
        assert case == name
        assert before == now
        assert all(float(number.replace(",", "")) > 0 for number in numbers)
        assert difference == "0e+00"


@pytest.mark.slow
def test_now_is_what_is_not_committed_yet(beside, project):
    change(project / "fenics_rom/runtime/moving_body.py", "field = super().disp", "field = 3 * super().disp")
    ran = beside("HEAD", "pad, at rest")
    assert ", with changes that are not committed\n" in ran.stdout
    assert rows(ran)[0][-1] == "2e+00"


@pytest.mark.slow
def test_a_commit_may_have_a_model_of_its_own(beside):
    ((_, before, now, *_, difference),) = rows(beside("HEAD", "pad, at rest", "--own", "10"))
    assert (before, now) == ("16", "30")
    assert 0 < float(difference) < 1


@pytest.mark.slow
def test_a_version_that_cannot_step_is_named(beside, project):
    change(project / "fenics_rom/runtime/joint_bodies.py", "self.dt = dt", "raise RuntimeError('broken')")
    ran = beside("HEAD", "batch, 8 points, at rest")
    assert ran.returncode == 1
    assert "RuntimeError: broken" in ran.stderr
    assert "error: the package of now cannot step 'batch, 8 points, at rest'; why, stands above" in ran.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "there is no commit 'nowhere' here"),
        (["HEAD", "boat"], "no case is called boat; there are: pad, at rest; pad, sticks; "),
    ],
)
def test_what_there_is_not_is_a_clear_error(beside, arguments, said):
    ran = beside(*arguments)
    assert ran.returncode == 1
    assert ran.stderr.startswith(f"error: {said}")


def test_without_a_repository_is_a_clear_error(beside, project, tmp_path):
    for folder in (tmp_path / "copy", project / "inner"):
        shutil.copytree(project / "demos", folder / "demos")
    ran = beside("HEAD", folder=tmp_path / "copy")
    assert ran.returncode == 1
    assert ran.stderr.startswith("error: fatal: not a git repository")
    ran = beside("HEAD", folder=project / "inner")
    shutil.rmtree(project / "inner")
    assert ran.returncode == 1
    assert "is not a Git repository of its own" in ran.stderr


def test_without_git_is_a_clear_error(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    ran = subprocess.run([sys.executable, ROOT / SCRIPT, "HEAD"], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (1, "error: there is no git on this machine\n")
