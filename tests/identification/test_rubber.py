"""Laws of rubber are found from tests of it: their own constants, to round-off of a search, and what cannot be used."""

import numpy as np
import pytest
from measuring import START, box_mesh, scene_of, text_of, write

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import DataError, SceneError
from fenics_rom.identification.rubber import RubberData
from fenics_rom.identification.write import FILES
from fenics_rom.mechanics.isochoric import isochoric_terms
from fenics_rom.mechanics.rubber_tests import TESTS, nominal_stress

SHEAR = 4e5  # Pa
LONGEST = {"uniaxial": 5.0, "planar": 4.0, "equibiaxial": 3.0}
CASES = {  # the truth, and constants of a scene from which a search begins; all are stresses of SHEAR, but for numbers
    "mooney_rivlin 1.6e5 0.4e5": "[1.0, 0.0]",
    "yeoh 2e5 -2e3 60": "[1.0, 0.0, 0.0]",
    "ogden 6.2e5 1.3 1.2e3 5 -1e4 -2": "[1.0, 2.0, 1.0, 4.0, -1.0, -1.0]",
    "gent 60": "[100.0]",
    "arruda_boyce 4": "[3.0]",
}


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rubber")
    box_mesh(folder)
    return folder


def scene_by(mesh, material, constants):
    more = f'large_deformation = {{ material = "{material}", constants = {constants} }}'
    return scene_of(mesh / "box.msh", START, more)


def measured(law, seed=None, tests=TESTS):
    """What the tests show, with 1 % of noise where there is a seed."""
    parts = []
    for test in tests:
        stretch = np.linspace(1, LONGEST[test], 25)[1:]
        stress = modulus(law) * nominal_stress(isochoric_terms(law), test, stretch)
        noise = 0 if seed is None else 0.01 * np.random.default_rng(seed).standard_normal(len(stress))
        parts.append(RubberData(f"{test}.csv", test, stretch, stress * (1 + noise)))
    return parts


def modulus(law):
    """Pa: what its constants make, if they are stresses."""
    name, *texts = law.split()
    values = np.array(texts, float)
    if name == "ogden":
        return float(values[::2] @ values[1::2]) / 2
    return {"mooney_rivlin": 2 * values.sum(), "yeoh": 2 * values[0]}.get(name, SHEAR)


@pytest.mark.parametrize(("law", "start"), CASES.items(), ids=lambda text: text.split()[0])
def test_constants_are_found_again(mesh, law, start):
    """Of stresses without noise: to the tolerance of the search, times how far pairs of Ogden are from one another."""
    name, *texts = law.split()
    fit = fr.fit_rubber(scene_by(mesh, name, start), measured(law))
    assert fit.shear == pytest.approx(modulus(law), rel=1e-6)
    assert fit.residual <= 1e-7 * max(part.stress.max() for part in fit.data)
    found, truth = np.array(fit.constants), np.array(texts, float)
    if name == "ogden":
        found, truth = (each.reshape(-1, 2)[each[1::2].argsort()] for each in (found, truth))
    np.testing.assert_allclose(found, truth, rtol=1e-3 if name == "ogden" else 1e-6)
    assert fit.warnings == ()
    assert fit.young == pytest.approx(2 * fit.shear * (1 + START["poisson"]), rel=1e-14)


def test_noise_is_left_over(mesh):
    """Root mean square of the residual: the noise, 1 % of each stress, within what 72 values tell of it."""
    fit = fr.fit_rubber(scene_by(mesh, "yeoh", "[1.0, 0.0, 0.0]"), measured("yeoh 2e5 -2e3 60", seed=3))
    stress = np.concatenate([part.stress for part in fit.data])
    assert fit.residual == pytest.approx(0.01 * np.sqrt(np.mean(stress**2)), rel=0.4)
    assert fit.shear == pytest.approx(SHEAR, rel=0.05)


def test_what_tests_do_not_tell_is_said(mesh):
    linear = measured("yeoh 2e5", tests=["uniaxial"])
    gent = fr.fit_rubber(scene_by(mesh, "gent", "[30.0]"), linear)
    assert "do not show at which stretch chains lock" in gent.warnings[0]
    assert "all tests are uniaxial" in gent.warnings[-1]
    softening = fr.fit_rubber(scene_by(mesh, "yeoh", "[1.0, 0.0]"), measured("yeoh 2e5 -6e3"))
    assert "uniaxial tests the law is stable from a stretch of" in softening.warnings[0]


def test_the_command_leaves_a_scene_that_has_the_law(mesh, capsys):
    text = text_of(mesh / "box.msh", START, 'large_deformation = { material = "gent", constants = [30.0] }')
    (mesh / "scene.toml").write_text(text)
    files = []
    for _, test, stretch, stress in measured("gent 60", tests=["uniaxial", "planar"]):
        files += ["--data", str(mesh / f"{test}.csv")]
        write(mesh / f"{test}.csv", ["stretch", f"{test} (MPa)"], np.stack([stretch, 1e-6 * stress], axis=1).tolist())
    with pytest.raises(SystemExit, match="0"):
        main(["identify", str(mesh / "scene.toml"), *files, "-o", str(mesh / "out")])
    assert "gent, constants = [60]" in capsys.readouterr().out
    found = fr.read_scene(mesh / "out" / "identified.toml")
    assert found.effects.large_deformation.constants == pytest.approx((60.0,), rel=1e-6)
    assert found.materials["material"].young == pytest.approx(2 * SHEAR * (1 + START["poisson"]), rel=1e-6)
    assert {path.name for path in (mesh / "out").iterdir()} == set(FILES)
    assert "| uniaxial" in (mesh / "out" / "identification.md").read_text()


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["stretch,uniaxial", "1.1,2"], "no unit; use a name and one of"),
        (["stretch,biaxial (MPa)", "1.1,2"], "use one of uniaxial \\(MPa\\)"),
        (["stretch,uniaxial (MPa)", "0,2"], "line 2, column 'stretch': 0 was given; use > 0"),
        (["stretch,uniaxial (MPa)", "1.1,2", "1.2,-1"], "line 3.* use > 0 above 1, and < 0 below 1"),
        (["stretch,uniaxial (MPa)", "1.1,2", "1.2,"], "1 stresses of stretched rubber were measured"),
        (["time (s),uniaxial (MPa)", "1.1,2"], "use 'stretch' first"),
    ],
)
def test_data_that_cannot_be_used_are_refused(mesh, tmp_path, rows, says):
    (tmp_path / "data.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(DataError, match=says):
        fr.fit_rubber(scene_by(mesh, "yeoh", "[1.0]"), [tmp_path / "data.csv"])


def test_scenes_without_such_a_law_are_refused(mesh):
    with pytest.raises(SceneError, match="by a law with constants; use mooney_rivlin, yeoh"):
        fr.fit_rubber(scene_of(mesh / "box.msh", START), measured("yeoh 1"))
    with pytest.raises(SceneError, match=r"material.*'mullins'.*softening of rubber in its first pulls"):
        scene_by(mesh, "mullins", "[]")
