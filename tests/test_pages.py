"""The pages are run: every block of Python, every command; every link, anchor, picture and file name is looked up."""

import math
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.cli import main, petsc_options
from fenics_rom.scene.effect_table import EFFECTS
from fenics_rom.studies.method_configs import METHOD_CONFIGS, STUDIED_METHODS

ROOT = Path(__file__).parent.parent
PACKAGE, DEMOS = ROOT / "fenics_rom", ROOT / "demos"
README = "README.md"
PAPER = "demos/paper/paper.md"
MOST_WORDS = 1000  # of the first page
MOST_OF_A_RELEASE = 900  # of its changes
MOST_OF_A_SENTENCE = 30
QUICK_COMMANDS = {"reduce", "simulate", "compare", "info", "plot", "export"}  # the others take minutes, or serve
PRINTED = {  # by a page's Python
    README: "supplied=",
    "demos/finger/README.md": "[",
    "fenics_rom/runtime/README.md": "(256, 2, 3)",
    "fenics_rom/system/README.md": "100 unknowns",
}


def sources(pattern):
    """Files by their names in the project; what demos wrote is left out."""
    files = [
        *ROOT.glob(pattern),
        *(ROOT / "zoo").glob(pattern),
        *(ROOT / "ros").rglob(pattern),
        *(file for folder in (PACKAGE, DEMOS, ROOT / "tests", ROOT / ".github") for file in folder.rglob(pattern)),
    ]
    names = (file.relative_to(ROOT) for file in files)
    return sorted(str(name) for name in names if "out" not in name.parts)


PAGES = sources("*.md")
TEXTS = {page: (ROOT / page).read_text() for page in PAGES}


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", TEXTS[page], flags=re.S | re.M)


def commands(page):
    """The lines of a page's commands, without comments."""
    lines = (line.split("#")[0].strip() for block in blocks(page, "sh") for line in block.splitlines())
    return [line for line in lines if line]


def prose(page):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", TEXTS[page], flags=re.S | re.M)


def links(page):
    """Targets of links and pictures."""
    text = re.sub(r"`[^`\n]*`", "", prose(page).replace("[`", "[").replace("`]", "]"))
    return re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="(.*?)"', text)


def anchors(page):
    """What a heading can be linked by."""
    headings = re.findall(r"^#+ (.*)$", prose(page), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def tables(page):
    """Markdown tables: rows as dictionaries by the first row's names."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", TEXTS[page], flags=re.M):
        heading, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines())
        found.append([dict(zip(heading, row, strict=True)) for row in rows])
    return found


def with_blocks(language):
    return [page for page in PAGES if blocks(page, language)]


def parse(command):
    """The command of `fenics-rom ...`, whose words the parser takes."""
    words, _ = petsc_options.split_words(command.split()[1:])
    main._parser().parse_args(words)
    return words[0]


def run_in(folder, *words):
    run = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, env=dict(os.environ))
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


@pytest.fixture(scope="module")
def files(tmp_path_factory, plate_system, plate_rom):
    """What pages call by name: the plate's scene, ROM and runs, and its matrices."""
    place = tmp_path_factory.mktemp("files")
    shutil.copy(ROOT / "meshes" / "plate.msh", place)
    (place / "plate.toml").write_text(PLATE.read_text().replace("../../meshes/", ""))
    fr.write_rom(place / "plate.h5", plate_rom)
    reduced = fr.simulate(plate_rom, dt=0.01)
    for name in ("run", "reduced"):
        fr.write_trajectory(place / f"{name}.h5", reduced)
    fr.write_trajectory(place / "full.h5", fr.simulate(plate_system, dt=0.01))
    s, unit = plate_system, np.eye(plate_system.size)
    for name, matrix in (("M", s.mass @ unit), ("D", s.damping @ unit), ("K", s.stiffness @ unit)):
        scipy.io.mmwrite(place / f"{name}.mtx", (matrix + matrix.T) / 2)
    scipy.io.mmwrite(place / "B.mtx", s.contacts["tip_left"])
    scipy.io.mmwrite(place / "C.mtx", s.outputs["tip"])
    return place


@pytest.fixture
def folder(request, tmp_path, zoo_folder):
    """As if in the project's root, without writing into it; the first page begins with the scene that it shows."""
    page = request.node.callspec.params["page"]
    if page == README:
        (scene,) = blocks(README, "toml")
        (tmp_path / "finger.toml").write_text(scene)
    else:
        shutil.copytree(request.getfixturevalue("files"), tmp_path, dirs_exist_ok=True)
    for name in ("demos", "meshes", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / zoo_folder.name).symlink_to(zoo_folder)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted({*with_blocks("python"), *with_blocks("sh")}))
def test_python_and_commands_of_a_page_run_as_printed(page, folder):
    printed = "".join(run_in(folder, "-c", python) for python in blocks(page, "python"))
    assert PRINTED.get(page, "") in printed
    for command in commands(page):
        if command.startswith("fenics-rom") and parse(command) in QUICK_COMMANDS:
            run_in(folder, "-m", "fenics_rom", *command.split()[1:])
    if page == README:
        assert {path.name for path in folder.glob("*.h5")} == {"finger.h5", "reduced.h5", "full.h5"}
        assert fr.compare(folder / "reduced.h5", folder / "full.h5")["shape"].relative < 1e-6


@pytest.mark.parametrize("page", with_blocks("sh"))
def test_commands_of_a_page_are_commands_that_there_are(page):
    for command in commands(page):
        program, *words = command.split()
        if program == "fenics-rom":
            parse(command)
        elif program == "pip":
            assert words == ["install", '"fenics-rom[live]"', "fenics-rom-zoo"], command
        elif program == "ros2":
            verb, package, launch, *given = words
            code = (ROOT / "ros" / package / "bridge.py").read_text()
            assert verb == "launch"
            assert (ROOT / "ros" / "launch" / launch).is_file()
            assert all(f'    "{each.split(":=")[0]}": ' in code for each in given), command
        elif program == "colcon":
            assert (ROOT / "ros" / words[-1]).is_dir(), command
        elif program == "bash":
            script, *demos = words
            assert (ROOT / script).is_file(), command
            assert all((DEMOS / name / f"{name}.py").is_file() for name in demos), command
        else:
            assert program == ".venv/bin/python", command
            script, *options = words
            text = (ROOT / script).read_text()
            assert all(f'"{option}"' in text for option in options if option.startswith("--")), command


@pytest.mark.parametrize("page", PAGES)
def test_commands_stand_in_blocks_that_are_run(page):
    assert not re.search(r"^    (fenics-rom|bash|python|pip|mpirun|\.venv)", prose(page), flags=re.M)
    languages = re.findall(r"^```(.*)\n(?:(?!^```)[\s\S])*?^```", TEXTS[page], flags=re.M)
    assert set(languages) <= {"python", "sh", "toml"}
    for name in re.findall(r"`bash demos/run.sh ([a-z]\w*)", TEXTS[page]):
        assert (DEMOS / name / f"{name}.py").is_file()
    for script in re.findall(r"`(?:\.venv/bin/)?python (\S+\.py)", TEXTS[page]):
        assert (ROOT / script).is_file()
    for command in re.findall(r"`fenics-rom ([a-z]\w*)", TEXTS[page]):
        assert command in main.COMMANDS or page == "CHANGELOG.md"


@pytest.mark.parametrize("page", with_blocks("toml"))
def test_scenes_of_a_page_are_of_effects_that_there_are(page):
    for block in blocks(page, "toml"):
        assert tomllib.loads(block).get("effects", {}).keys() <= EFFECTS.keys()


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for link in links(page):
        target, _, anchor = link.partition("#")
        if re.match(r"\w+:", link):
            assert re.fullmatch(r"https://[\w.-]+\.\w+(/\S*)?", link)
            continue
        file = ((ROOT / page).parent / target).resolve() if target else ROOT / page
        assert file.exists(), f"{page}: {link}"
        assert file.is_relative_to(ROOT)
        if file.suffix in (".png", ".gif"):
            assert file.stat().st_size > 10_000
        if anchor:
            assert anchor in anchors(str(file.relative_to(ROOT))), f"{page}: {link}"


def test_release_has_one_number():
    """Code, where pyproject.toml takes it from; and where `.ci/new_version.py` writes it."""
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dynamic"] == ["version"]
    for file, pattern in runpy.run_path(str(ROOT / ".ci" / "new_version.py"))["PLACES"].items():
        assert re.findall(pattern, (ROOT / file).read_text(), flags=re.M)[:1] == [fr.__version__], file


def test_recipe_of_conda_forge_asks_for_what_the_project_does():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text()
    assert f'python_min: "{project["requires-python"].removeprefix(">=")}"' in recipe
    extras = project["optional-dependencies"]
    for wanted in (*project["dependencies"], *extras["cli"], *extras["offline"]):
        package = wanted.replace(">=", " >=")
        assert f"        - {package}\n" in recipe or package.startswith(project["name"]), package


def test_article_cites_what_its_bibliography_has_and_numbers_of_the_first_page():
    paper, bibliography = TEXTS[PAPER], (ROOT / PAPER).with_name("paper.bib").read_text()
    assert {*re.findall(r"@(\w+)[\];]", paper)} == {*re.findall(r"^@\w+\{(\w+),", bibliography, flags=re.M)}
    numbers = re.findall(r"\d+,\d{3}", paper)
    assert numbers
    assert all(number in TEXTS[README] for number in numbers)
    assert 250 <= len(paper.split()) <= 1000  # as the journal asks


def test_first_page_and_what_is_new_are_short():
    for page, most in ((README, MOST_WORDS), ("CHANGELOG.md", MOST_OF_A_RELEASE)):
        text = re.sub(r"!?\[(.*?)\]\(.*?\)", r"\1", TEXTS[page]).split("\n## 0.1.0")[0]
        assert len([word for word in text.split() if re.search(r"\w", word)]) <= most


@pytest.mark.parametrize(
    "page", [*PAGES, *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs").rglob("*.md")))]
)
def test_sentences_are_short(page):
    text = re.sub(r"^```.*?^```", "", (ROOT / page).read_text(), flags=re.S | re.M)
    text = re.sub(r"^(?:[|#]|    |:::).*$", "\n", re.sub(r"!?\[(.*?)\]\(.*?\)", r"[\1]", text), flags=re.M)
    for paragraph in re.split(r"\n\s*\n|\n *[-*\d]+[. ]", text):
        for sentence in re.split(r"(?<=[.!?:;])\s+", paragraph):
            assert len([word for word in sentence.split() if re.search(r"\w", word)]) <= MOST_OF_A_SENTENCE, sentence


def test_every_folder_has_its_page_and_every_page_is_reached():
    folders = [Path(file).parent for file in sources("__init__.py") if not file.startswith("ros/")]  # it has one page
    assert {f"{folder}/README.md" for folder in folders} <= set(PAGES)
    assert {f"demos/{script.parent.name}/README.md" for script in DEMOS.glob("*/*.py")} <= set(PAGES)
    reached, ahead = set(), [README]
    while ahead:
        page = ahead.pop()
        reached.add(page)
        targets = {((ROOT / page).parent / link.partition("#")[0]).resolve() for link in links(page)}
        targets = {target / README if target.is_dir() else target for target in targets}
        ahead += [p for p in PAGES if (ROOT / p) in targets and p not in reached]
    assert reached == set(PAGES)


@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith("fenics_rom/")])
def test_files_that_a_page_of_the_package_names_are_there(page):
    for name in re.findall(r"`([a-z\d_/.]+\.py)`", TEXTS[page]):
        bases = ((ROOT / page).parent, PACKAGE, ROOT)
        in_tests = (ROOT / "tests").rglob(Path(name).name)
        assert any((base / name).is_file() for base in bases) or any(in_tests), name


def test_walks_name_what_stands_in_their_files():
    steps = re.findall(r"^\d\. \[(.*?)\]\(\1\): (.*)$", TEXTS["fenics_rom/README.md"], flags=re.M)
    assert len(steps) >= 30
    code = "".join((ROOT / file).read_text() for file in sources("*.py"))
    for file, text in steps:
        names = [name for name in re.findall(r"`([^`]+)`", text) if re.fullmatch(r"[\w.]+(\(.*\))?", name)]
        words = [re.sub(r"\(.*\)", "", name).split(".")[-1] for name in names]
        assert all(re.search(rf"\b{word}\b", code) for word in words), (file, words)
        if words:
            assert re.search(rf"\b{words[0]}\b", (PACKAGE / file).read_text()), (file, words[0])


@pytest.mark.slow
def test_plate_demo_keeps_its_claims():
    printed = run_in(ROOT, str(DEMOS / "plate" / "plate.py"))
    assert "FAILS" not in printed
    out = {path.name for path in (DEMOS / "plate" / "out").iterdir()}
    assert out >= {
        "plate.h5",
        "full.h5",
        "reduced.h5",
        "study.md",
        "speed.png",
        "table_1.md",
        "energy.png",
        "shapes.png",
    }


def step_seconds(text):
    value, unit = text.split()
    return float(value) * {"ms": 1e-3, "µs": 1e-6}[unit]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_what_accuracy_costs_is_what_a_short_study_finds(tmp_path):
    plate = tables("demos/plate/README.md")
    (costs,) = (table for table in plate if {"for", "method", "order", "step", "error"} <= table[0].keys())
    assert costs in tables(README)
    (reduction,) = (table for table in plate if {"order", "balanced", "POD"} <= table[0].keys())
    method_of = {config.label: name for name, config in METHOD_CONFIGS.items()}
    costs = [row for row in costs if step_seconds(row["step"]) >= 1e-3]  # the rest takes longer
    assert len(costs) >= 3
    orders = {int(row["order"]) for row in costs} | {28}
    steps = {step_seconds(row["step"]) for row in costs}
    scene = fr.read_scene(PLATE)
    rows = fr.study(scene, tmp_path, methods=STUDIED_METHODS, orders=sorted(orders), steps=sorted(steps)).rows
    for row in costs:
        key, dt = (method_of[row["method"]], int(row["order"])), step_seconds(row["step"])
        (measured,) = (r for r in rows if (r.method, r.order) == key and math.isclose(r.dt, dt))
        assert float(row["error"]) == pytest.approx(measured.error, rel=0.1)
        assert measured.error <= float(row["for"])
    for row in reduction:
        if int(row["order"]) in orders:
            for label, name in method_of.items():
                if label in row:
                    (measured, *_) = (r for r in rows if (r.method, r.order) == (name, int(row["order"])))
                    assert float(row[label]) == pytest.approx(measured.reduction, rel=0.1)
