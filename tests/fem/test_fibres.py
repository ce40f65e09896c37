"""Fibres, membranes and cables at full order, against closed forms of homogeneous strains."""

import numpy as np
import pytest
import scipy.optimize
from bodies import acted_on, box_arrays, box_surfaces, write_arrays

import fenics_rom as fr
from fenics_rom.errors import MeshError, SceneError

YOUNG, POISSON = 1e5, 0.4
μ, λ = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
K1, K2, κ, α = 4e4, 1.5, 0.1, 0.6
_ROLLERS = ", ".join(
    f'{{ surface = "{name}", normal = {normal} }}'
    for name, normal in (("left", [1, 0, 0]), ("front", [0, 1, 0]), ("bottom", [0, 0, 1]))
)
SYMMETRY = f"held = [{_ROLLERS}]"
HOLZAPFEL = f"""young = {YOUNG}
poisson = {POISSON}
density = 1000.0
fibres = {{ law = "holzapfel", modulus = {K1}, stiffening = {K2}, dispersion = {κ}, directions = [
    [{np.cos(α)}, {np.sin(α)}, 0], [{np.cos(α)}, {-np.sin(α)}, 0]] }}"""
NEO = 'large_deformation = { material = "neo_hookean" }\n'


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    points, cells = box_arrays((1.0, 1.0, 1.0), (1, 1, 1))
    return write_arrays(tmp_path_factory.mktemp("cube") / "cube.msh", points, cells, box_surfaces(points, cells))


def assembled(file, effects, **parts):
    contacts = '[contacts.right]\nsurface = "right"'
    return fr.assemble(acted_on(file, effects, contacts=contacts, **parts))


def first_piola(F):
    """∂W/∂F (3, 3) as textbooks print it."""
    J, inverse = np.linalg.det(F), np.linalg.inv(F).T
    P = μ * (F - inverse) + λ * np.log(J) * inverse
    C = F.T @ F
    for sign in (1, -1):
        a = np.array([np.cos(α), sign * np.sin(α), 0])
        E = κ * (np.trace(C) - 3) + (1 - 3 * κ) * (a @ C @ a - 1)
        if E > 0:
            slope = K1 * E * np.exp(K2 * E**2)
            P = P + 2 * slope * (κ * F + (1 - 3 * κ) * np.outer(F @ a, a))
    return P


@pytest.mark.parametrize(
    ("pulled", "most"), [((0,), 1.5e5), ((0, 1), 1e5), ((1,), -3e4)], ids=["uniaxial", "equibiaxial", "pressed across"]
)
def test_fibres_that_only_pull_in_homogeneous_tension(cube, pulled, most):
    """Forces on faces stretch a cube between planes of symmetry as the stationary point of its energy says."""
    faces = ("right", "back", "top")
    parts = {
        f"effects.prescribed.{faces[axis]}": f'surface = "{faces[axis]}"\nforce = {(most * np.eye(3)[axis]).tolist()}'
        for axis in pulled
    }
    parts |= {f"outputs.{name}": f'surface = "{name}"' for name in faces}
    scene = acted_on(cube, NEO, material=HOLZAPFEL, supports=SYMMETRY, run="dt = 1.0\nduration = 1.0", **parts)
    outputs = fr.simulate(scene).outputs
    found = 1 + np.array([outputs[name][-1].ravel()[axis] for axis, name in enumerate(faces)])
    target = np.array([most if axis in pulled else 0.0 for axis in range(3)])
    closed = scipy.optimize.fsolve(lambda s: np.diag(first_piola(np.diag(s))) - target, found, xtol=1e-14)
    assert np.abs(closed - 1).max() > 0.1
    np.testing.assert_allclose(found, closed, rtol=1e-8)


def test_fibres_that_only_pull_in_simple_shear(cube):
    """Nodes bear the stress of their faces: a homogeneous deformation strains all cells alike."""
    system = assembled(cube, NEO, material=HOLZAPFEL, supports=None)
    F = np.eye(3)
    F[0, 1] = 0.4
    X = system.body.nodes
    forces = system.deformation.force(((F - np.eye(3)) @ X.T).T.ravel()).reshape(-1, 3)
    expected = first_piola(F)
    for axis, sign in ((0, 1), (1, 1), (2, 1), (0, -1)):
        on = X[:, axis] == (1.0 if sign > 0 else 0.0)
        # nodes of an edge also bear what the faces beside are pushed by, which adds up to nothing on this face
        np.testing.assert_allclose(forces[on].sum(axis=0), sign * expected[:, axis], rtol=1e-8, atol=1e-8 * μ)


PULL = "young = 1e5\npoisson = 0.3\ndensity = 1000.0\nfibres = { modulus = 5e5, %s }"


def stiffness(file, fibres, **parts):
    """K of all nodes."""
    system = assembled(file, "inertia = {}\ndamping = { beta = 1e-3 }", material=PULL % fibres, supports=None, **parts)
    K = system.stiffness @ np.eye(system.size)
    np.testing.assert_allclose(system.damping @ np.eye(system.size), 1e-3 * K, atol=1e-12 * np.abs(K).max())
    return K, system


@pytest.mark.parametrize("large", ["", NEO], ids=["small", "large"])
@pytest.mark.parametrize("degree", [1, 2])
def test_fibres_that_pull_and_push_are_transversely_isotropic_at_rest(cube, degree, large):
    """K of affine motions is the volume times the moduli, k a⊗a⊗a⊗a among them, and that of the deformation at rest."""
    K, system = stiffness(cube, "directions = [[1, 2, 2]]", degree=degree)
    a, unit = np.array([1, 2, 2]) / 3, np.eye(3)
    E, ν = 1e5, 0.3
    λ, μ = E * ν / ((1 + ν) * (1 - 2 * ν)), E / (2 * (1 + ν))
    X = system.body.nodes
    H = [np.outer(unit[i], unit[j]) for i in range(3) for j in range(3)]
    x = np.array([(X @ h.T).ravel() for h in H])
    ε = [(h + h.T) / 2 for h in H]
    C = [
        [λ * np.trace(e) * np.trace(f) + 2 * μ * (e * f).sum() + 5e5 * (a @ e @ a) * (a @ f @ a) for f in ε] for e in ε
    ]
    np.testing.assert_allclose(x @ K @ x.T, C, atol=1e-9 * E)
    if large:
        system = assembled(cube, NEO, material=PULL % "directions = [[1, 2, 2]]", supports=None, degree=degree)
        small = 1e-7 * np.random.default_rng(0).standard_normal(system.size)
        np.testing.assert_allclose(system.deformation.force(small), K @ small, atol=1e-5 * np.abs(K @ small).max())


def test_directions_of_cell_data_are_those_of_a_vector(tmp_path):
    points, cells = box_arrays((1.0, 1.0, 1.0), (1, 1, 1))
    rows = [
        *(["4 " + " ".join(map(str, cell)) for cell in cells]),
        *(f"3 {a} {b} {c}" for a, b, c in box_surfaces(points, cells)["right"]),
    ]
    right = len(rows) - len(cells)
    vectors = np.vstack([np.tile([2.0, 4.0, 4.0], (len(cells), 1)), np.zeros((right, 3))])

    def vtk(name, vectors):
        text = "# vtk DataFile Version 3.0\nbox\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        text += f"POINTS {len(points)} double\n" + "\n".join(" ".join(map(str, p)) for p in points.tolist())
        text += f"\nCELLS {len(rows)} {5 * len(cells) + 4 * right}\n" + "\n".join(rows)
        text += f"\nCELL_TYPES {len(rows)}\n" + " ".join(["10"] * len(cells) + ["5"] * right)
        text += f"\nCELL_DATA {len(rows)}\nSCALARS part int 1\nLOOKUP_TABLE default\n"
        text += " ".join(["3"] * len(cells) + ["2"] * right)
        text += "\nVECTORS fibre double\n" + "\n".join(" ".join(map(str, v)) for v in vectors.tolist()) + "\n"
        (tmp_path / name).write_text(text)
        return tmp_path / name

    groups = {"mesh.groups": "right = 2\nbody = 3"}

    def of_file(file, data="fibre"):
        return stiffness(file, f'data = ["{data}"]', **groups)[0]

    given = vtk("given.vtk", vectors)
    by_vector = stiffness(given, "directions = [[1, 2, 2]]", **groups)[0]
    np.testing.assert_allclose(of_file(given), by_vector, atol=1e-9 * np.abs(by_vector).max())
    vectors[[1, 4]] = 0.0
    with pytest.raises(SceneError, match=r"fibres of 2 of 6 cells have no direction \('fibre' is 0 .*, e.g. at \[0"):
        of_file(vtk("lacking.vtk", vectors))
    with pytest.raises(MeshError, match=r"materials\.material\.fibres\.data: .*no vectors 'thread'; there is fibre"):
        of_file(given, "thread")


def test_directions_of_an_xdmf_file_are_those_of_a_vector(tmp_path):
    points, cells = box_arrays((1.0, 1.0, 1.0), (1, 1, 1))

    def item(values, kind):
        numbers = " ".join(map(str, values.ravel().tolist()))
        shape = " ".join(map(str, values.shape))
        return f'<DataItem Dimensions="{shape}" NumberType="{kind}" Format="XML">{numbers}</DataItem>'

    (tmp_path / "cube.xdmf").write_text(
        '<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">'
        f'<Topology TopologyType="Tetrahedron" NumberOfElements="{len(cells)}">{item(cells, "Int")}</Topology>'
        f'<Geometry GeometryType="XYZ">{item(points, "Float")}</Geometry>'
        f'<Attribute Name="fibre" AttributeType="Vector" Center="Cell">'
        f"{item(np.tile([1.0, 2.0, 2.0], (len(cells), 1)), 'Float')}</Attribute></Grid></Domain></Xdmf>"
    )
    contacts = "[contacts.right]\nplane = { point = [1, 0, 0], normal = [1, 0, 0] }"
    parts = {"contacts": contacts, "supports": None}
    found, given = (
        fr.assemble(acted_on(tmp_path / "cube.xdmf", "inertia = {}\n", material=PULL % fibres, **parts))
        for fibres in ('data = ["fibre"]', "directions = [[1, 2, 2]]")
    )
    K, expected = (system.stiffness @ np.eye(system.size) for system in (found, given))
    np.testing.assert_allclose(K, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("of", ["fibres", "cable"])
def test_derivatives_by_parameters_refuse_fibres(cube, of):
    cable = {"effects.cables.wire": "points = [[0, 0, 0], [1, 1, 1]]\nstiffness = 1.0"} if of == "cable" else {}
    material = PULL % "directions = [[1, 2, 2]]" if of == "fibres" else "young = 1e5\npoisson = 0.3\ndensity = 1000.0"
    scene = acted_on(cube, "inertia = {}\n", material=material, run="dt = 1e-3\nduration = 1e-2", **cable)
    with pytest.raises(SceneError, match="use bodies without fibres, membranes and cables"):
        fr.differentiate_scene(scene, lambda outputs, energies: (0.0, {}, None))


@pytest.mark.parametrize(
    ("fibres", "says"),
    [
        ('data = ["fibre"]', "has no vectors 'fibre' of its cells, nor any; use cell data"),
        (
            "helix = { axis = [0, 0, 1], point = [0.5, 0.25, 0.0], angle = 0.3 }",
            "fibres of 1 of 6 places have no direction",
        ),
    ],
)
def test_fibres_without_a_direction_are_refused(cube, fibres, says):
    with pytest.raises((SceneError, MeshError), match=says):
        stiffness(cube, fibres)
