"""Membranes in surfaces and cables along lines: affine motions, composite beams and large strains in closed form."""

import numpy as np
import pytest
import scipy.sparse
from bodies import acted_on, box_arrays, box_surfaces, write_arrays
from bricks import shaken_bricks, write_bricks

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.finite_strain.stresses import EquilibriumStresses
from fenics_rom.fem.petsc_matrix import PetscMatrix

SOFT, YOUNG, POISSON = "young = 1e5\npoisson = 0.3\ndensity = 1000.0", 1e5, 0.3
RIGHT = '[contacts.right]\nsurface = "right"'
LENGTHS = np.array([0.3, 0.1, 0.2])
SHEET = {"effects.membranes.sheet": 'surface = "top"\nstiffness = 4e3\npoisson = 0.45'}
THREADS = {
    "effects.membranes.wound": 'surface = "top"\nstiffness = 4e3\ndirections = [[3, 4, 1]]'
}  # of which 1 is aside
LINE = [[0.0, 0.02, 0.03], [0.11, 0.06, 0.1], [0.3, 0.1, 0.2]]  # ends in a corner of the box
CABLE = {"effects.cables.wire": f"points = {LINE}\nstiffness = 50.0"}


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("box")
    points, cells = box_arrays(tuple(LENGTHS), (3, 2, 2), shake=0.2)
    found = {4: write_arrays(folder / "4.msh", points, cells, box_surfaces(points, cells))}
    return found | {n: write_bricks(folder / f"{n}.msh", *shaken_bricks(tuple(LENGTHS), (3, 2, 2), n)) for n in (8, 27)}


@pytest.fixture(scope="module")
def box(boxes):
    return boxes[4]


def plane_stress(E):
    """Energy of the sheet over its area, J/m², of strains in its plane (2, 2)."""
    return 4e3 / (2 * (1 - 0.45**2)) * (0.45 * np.trace(E) ** 2 + (1 - 0.45) * (E * E).sum())


def stretch_energy(k, along, F):
    """Of threads or cables, over area or length."""
    return k / 2 * (np.linalg.norm(F @ along) / np.linalg.norm(along) - 1) ** 2


def embedded_energy(kind, F):
    """At large strains, of homogeneous deformation, J."""
    area, E = LENGTHS[0] * LENGTHS[1], (F.T @ F - np.eye(3)) / 2
    if kind == "sheet":
        return area * plane_stress(E[:2, :2])
    if kind == "threads":
        return area * stretch_energy(4e3, np.array([3.0, 4.0, 0.0]), F)
    return sum(np.linalg.norm(d) * stretch_energy(50.0, d, F) for d in np.diff(LINE, axis=0))


EMBEDDED = {"sheet": SHEET, "threads": THREADS, "cable": CABLE}
CELLS = [(4, 1, kind) for kind in EMBEDDED] + [(4, 2, kind) for kind in EMBEDDED]
CELLS += [(nodes, degree, kind) for nodes, degree in ((8, 1), (27, 2)) for kind in ("sheet", "threads")]


@pytest.mark.parametrize(("nodes", "degree", "kind"), CELLS)
def test_what_is_embedded_stores_what_its_strain_says(boxes, nodes, degree, kind):
    """Of affine motions, which all cells follow: of small strains K, with β D, and at large ones the potential."""
    effects, box, added = "inertia = {}\ndamping = { beta = 1e-3 }\n", boxes[nodes], EMBEDDED[kind]
    parts = {"contacts": RIGHT, "material": SOFT, "supports": None, "degree": degree} | added
    bare, small = (fr.assemble(acted_on(box, effects, **(parts | one))) for one in (dict.fromkeys(added), {}))
    large = fr.assemble(acted_on(box, effects + 'large_deformation = { material = "neo_hookean" }\n', **parts))
    X, rng = small.body.nodes, np.random.default_rng(0)
    for _ in range(3):
        H = rng.standard_normal((3, 3))
        x = (X @ H.T).reshape(-1, 1)
        linear = embedded_energy(kind, np.eye(3) + 1e-4 * (H + H.T) / 2) / 1e-8  # and the quadratic part in between
        linear = (linear + embedded_energy(kind, np.eye(3) - 1e-4 * (H + H.T) / 2) / 1e-8) / 2
        for matrix, scale in (("stiffness", 1.0), ("damping", 1e-3)):
            more = (x.T @ (getattr(small, matrix) @ x) - x.T @ (getattr(bare, matrix) @ x)).item() / 2
            assert more == pytest.approx(scale * linear, rel=1e-6)
        F = np.eye(3) + 0.3 * H
        E = (F.T @ F - np.eye(3)) / 2
        μ, λ = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
        lnJ = np.log(abs(np.linalg.det(F)))
        stored = np.prod(LENGTHS) * (μ * (np.trace(E) - lnJ) + λ / 2 * lnJ**2) + embedded_energy(kind, F)
        model = large.deformation.model
        found = model.elastic_energy(
            np.repeat(
                np.array([*np.diag(E), 2 * E[1, 2], 2 * E[0, 2], 2 * E[0, 1]])[:, None], len(model.points.weights), 1
            )
        )
        assert found == pytest.approx(stored, rel=1e-12)


def test_tangents_of_what_is_embedded_are_those_of_its_forces(box):
    """K of a strained state times a change is the change of the force, by products and as a matrix."""
    effects = 'large_deformation = { material = "neo_hookean" }\n'
    parts = {"contacts": RIGHT, "material": SOFT, "degree": 2, "integration": "selective"} | SHEET | THREADS | CABLE
    system = fr.assemble(acted_on(box, effects, **parts))
    model, rng, t = system.deformation.model, np.random.default_rng(0), 1e-6
    x, dx = (size * rng.standard_normal(system.size) for size in (2e-3, 1.0))
    slope = (system.deformation.force(x + t * dx) - system.deformation.force(x - t * dx)) / (2 * t)
    H, dH = (model.points.gradients(model.nodal_field(each[:, None])) for each in (x, dx))
    stresses = EquilibriumStresses(model.material, H)
    product = model.internal_force(stresses.jvp(dH))[:, 0]
    np.testing.assert_allclose(product, slope, atol=1e-6 * np.abs(slope).max())
    matrix = system.deformation.stepper(1e-3)._matrix.consistent(
        stresses, scipy.sparse.csr_matrix((model.unknowns.components,) * 2)
    )
    np.testing.assert_allclose(PetscMatrix(matrix) @ dx[:, None], product[:, None], atol=1e-10 * np.abs(product).max())


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    points, cells = box_arrays((0.2, 0.01, 0.02), (12, 1, 2))
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", points, cells, box_surfaces(points, cells))


def composite(k, y):
    """EI, N m², of a section of w × h with a line of stiffness k, N, at a height y, about the neutral axis of both."""
    w, h, E = 0.01, 0.02, 1e5
    axis = (E * w * h * h / 2 + k * y) / (E * w * h + k)
    return E * w * h * (h**2 / 12 + (h / 2 - axis) ** 2) + k * (y - axis) ** 2


@pytest.mark.parametrize("stiff", [1.0, 1e2, 1e5], ids="{:g} times the beam".format)
@pytest.mark.parametrize("kind", ["sheet", "threads", "cable"])
def test_beams_with_inextensible_parts_bend_as_composite_ones(beam, kind, stiff):
    """Within 1 % of what Timoshenko's beam of the composite section says, however stiff what is embedded is."""
    k = stiff * 20.0  # of the beam's E A, N
    added, y = {
        "sheet": ({"effects.membranes.s": f'surface = "bottom"\nstiffness = {k / 0.01}\npoisson = 0.0'}, 0.0),
        "threads": (
            {"effects.membranes.s": f'surface = "bottom"\nstiffness = {k / 0.01}\ndirections = [[1, 0, 0]]'},
            0.0,
        ),
        "cable": ({"effects.cables.s": f"points = [[0, 0.005, 0.003], [0.2, 0.005, 0.003]]\nstiffness = {k}"}, 0.003),
    }[kind]
    load = {"effects.prescribed.end": 'surface = "right"\nforce = [0, 0, 1e-4]', "run": "dt = 1.0\nduration = 1.0"}
    scene = acted_on(
        beam,
        "",
        contacts=RIGHT,
        material="young = 1e5\npoisson = 0.0\ndensity = 1000.0",
        degree=2,
        **{"outputs.tip": 'surface = "right"'},
        **load,
        **added,
    )
    tip = fr.simulate(scene).outputs["tip"][-1].ravel()[2]
    expected = 1e-4 * (0.2**3 / (3 * composite(k, y)) + 0.2 / (5 / 6 * 5e4 * 2e-4))
    assert tip == pytest.approx(expected, rel=0.01)


def test_cables_in_other_cells_are_refused(boxes):
    with pytest.raises(
        FenicsRomError, match=r"wire: cables are computed in straight tetrahedra; .*8\.msh are hexahedra"
    ):
        fr.assemble(acted_on(boxes[8], "inertia = {}\n", contacts=RIGHT, **CABLE))


@pytest.mark.parametrize(
    ("added", "says"),
    [
        (
            {"effects.cables.wire": "points = [[0, 0.05, 0.1], [0.4, 0.05, 0.1]]\nstiffness = 1.0"},
            r"effects.cables.wire.points\[0\]: the line leaves the body from \[0.3, 0.05, 0.1\] to \[0.4, 0.05, 0.1\]",
        ),
        (
            {"effects.membranes.wound": 'surface = "top"\nstiffness = 1.0\ndirections = [[0, 0, 1]]'},
            r"effects.membranes.wound: fibres of \d+ of \d+ points of the surface have no direction",
        ),
        ({"effects.membranes.wound": 'surface = "lid"\nstiffness = 1.0\npoisson = 0.3'}, "no surface 'lid'; there is"),
    ],
)
def test_what_cannot_be_embedded_is_refused_with_where(box, added, says):
    with pytest.raises(FenicsRomError, match=says):
        fr.assemble(acted_on(box, "inertia = {}\n", contacts=RIGHT, **added))
