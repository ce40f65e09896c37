"""Systems from forms and from PETSc matrices: the same model as from a scene or SciPy, on one rank and on two."""

import json
from pathlib import Path

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, scene_text, sparse, write_arrays
from forms_on_ranks import ALPHA, BETA, DASHPOT, RHO, E, chain
from ranks import run_ranks

import fenics_rom as fr

RANKS = (1, 2)
LENGTHS, BRICKS = (1.0, 0.4, 0.3), (4, 2, 2)
pytestmark = [pytest.mark.ranks, pytest.mark.slow]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder of what one and two ranks made of the same box."""
    folder = tmp_path_factory.mktemp("forms")
    points, cells = box_arrays(LENGTHS, BRICKS)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    halves = {"left_half": np.flatnonzero(left), "right_half": np.flatnonzero(~left)}
    mesh = write_arrays(folder / "box.msh", points, cells, regions=halves)
    for degree in (1, 2):
        text = scene_text(mesh, degree=degree, **{"outputs.tip": 'surface = "right"'})
        (folder / f"box-{degree}.toml").write_text(text)
    for ranks in RANKS:
        made = folder / str(ranks)
        made.mkdir()
        done = run_ranks(ranks, Path(__file__).with_name("forms_on_ranks.py"), folder, made)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder


def checks(results, ranks):
    return json.loads((results / str(ranks) / "checks.json").read_text())


def transfer(rom, contact, ω):
    """Displacements of all free components by unit inputs at an angular frequency."""
    mode = rom.contact_models[contact]
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    dynamic = np.diag(mode.eigenvalues - ω**2) + 1j * ω * D
    return rom.basis @ (mode.coordinates @ np.linalg.solve(dynamic, mode.inputs))


def assert_same_model(one, other, contacts):
    """σ, and transfer functions at rest, between the lowest eigenfrequencies and on them."""
    for contact in contacts:
        σ = one.contact_models[contact].hankel_singular_values[:12]
        np.testing.assert_allclose(other.contact_models[contact].hankel_singular_values[:12], σ, rtol=2e-9)
        own = np.sqrt(one.contact_models[contact].eigenvalues[:4])
        for ω in (0.0, *own, *(own[:-1] + own[1:]) / 2):
            H = transfer(one, contact, ω)
            assert np.abs(transfer(other, contact, ω) - H).max() <= 1e-8 * np.abs(H).max(), (contact, ω)


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("degree", [1, 2])
def test_forms_of_a_scene_give_its_model(results, degree, ranks):
    scene, forms = (
        fr.read_rom(results / str(n) / f"{kind}-{degree}.h5") for kind, n in (("scene", 1), ("forms", ranks))
    )
    np.testing.assert_array_equal(forms.nodes, scene.nodes)
    np.testing.assert_array_equal(forms.free, scene.free)
    np.testing.assert_allclose(forms.node_mass, scene.node_mass, rtol=1e-12)
    np.testing.assert_allclose(
        forms.outputs["tip"] @ forms.outputs["tip"].T, scene.outputs["tip"] @ scene.outputs["tip"].T
    )
    assert_same_model(scene, forms, scene.contact_models)
    faces = [{tuple(np.roll(t, -t.argmin())) for t in rom.triangles} for rom in (scene, forms)]
    assert faces[0] == faces[1]


def scenes_parts(results):
    """M and K of the box by half, from scenes alone, which are linear in density and Young's modulus."""
    mesh = results / "box.msh"

    def matrices(left, right):
        both = {
            f"materials.{name}": f'cells = "{name}"\nyoung = {k * E}\npoisson = 0.3\ndensity = {k * RHO}'
            for name, k in (("left_half", left), ("right_half", right))
        }
        system = assembled(mesh, material=None, **both)
        return np.array([sparse(A).toarray() for A in (system.mass, system.stiffness)]), system

    whole, system = matrices(1, 1)
    left = matrices(2, 1)[0] - whole
    return left, whole - left, system


@pytest.mark.parametrize("ranks", RANKS)
def test_damping_of_each_material(results, ranks):
    (M1, K1), (M2, K2), system = scenes_parts(results)
    D = ALPHA[0] * M1 + BETA[0] * K1 + ALPHA[1] * M2 + BETA[1] * K2
    reference = fr.System(mass=M1 + M2, damping=(D + D.T) / 2, stiffness=K1 + K2, contacts=system.contacts)
    assert reference.rayleigh is None
    assert checks(results, ranks)[0]["rayleigh"]["materials"] is None
    forms = fr.read_rom(results / str(ranks) / "materials.h5")
    assert_same_model(fr.reduce(reference, order=12), forms, system.contacts)


@pytest.mark.parametrize("ranks", RANKS)
def test_dashpots_on_a_face(results, ranks):
    (M1, K1), (M2, K2), system = scenes_parts(results)
    M, K, nodes = M1 + M2, K1 + K2, system.body.nodes
    face = np.zeros((len(nodes), len(nodes)))
    for t in box_surfaces(*box_arrays(LENGTHS, BRICKS))["right"]:
        area = np.linalg.norm(np.cross(*(nodes[t[1:]] - nodes[t[0]]))) / 2
        face[np.ix_(t, t)] += area / 12 * (1 + np.eye(3))
    D = ALPHA[0] * M + BETA[0] * K + DASHPOT * np.kron(face, np.eye(3))[np.ix_(system.body.free, system.body.free)]
    reference = fr.reduce(fr.System(mass=M, damping=D, stiffness=K, contacts=system.contacts), order=12)
    forms = fr.read_rom(results / str(ranks) / "dashpots.h5")
    assert_same_model(reference, forms, system.contacts)
    kept = fr.read_rom(results / str(ranks) / "kept.h5")
    assert len(kept.nodes) == 0
    assert len(kept.free) == 3 * len(nodes)
    σ = reference.contact_models["top"].hankel_singular_values[:12]
    np.testing.assert_allclose(kept.contact_models["top"].hankel_singular_values[:12], σ, rtol=1e-9)


@pytest.mark.parametrize("ranks", RANKS)
def test_petsc_matrices_of_every_kind_are_the_scipy_model(results, ranks):
    M, D, K = chain(31)
    ends = np.eye(31)[:, [0, 17]]
    reference = fr.reduce(fr.System(mass=M, damping=D, stiffness=K, contacts={"ends": ends}), order=8)
    σ = reference.contact_models["ends"].hankel_singular_values[:8]
    for rank in checks(results, ranks):
        found = rank["petsc"]
        assert len(found["σ"]) == 6
        for kind, values in found["σ"].items():
            np.testing.assert_allclose(values, σ, rtol=1e-9, err_msg=kind)
        assert found["rayleigh"][0] == pytest.approx((0.1, 0.05), rel=1e-12)
        assert found["rayleigh"][1] is None
        assert found["untouched"]
        assert found["semi-definite"] == ["none", ""]
        assert found["symmetric"] == [False, True]
        assert rank["rayleigh"]["forms-1"] == [1.0, 1e-3]


@pytest.mark.parametrize("ranks", RANKS)
def test_plane_scalar_model_has_no_nodes(results, ranks):
    one = checks(results, 1)[0]["membrane"]
    for rank in checks(results, ranks):
        found = rank["membrane"]
        assert (found["size"], found["nodes"]) == (11 * 9, 0)
        assert found["outputs"][0] == 1
        assert found["lowest"] == pytest.approx(2 * np.pi**2, rel=0.01)
        np.testing.assert_allclose(found["σ"], one["σ"], rtol=1e-9)


@pytest.mark.parametrize("ranks", RANKS)
def test_single_components_can_be_held(results, ranks):
    nodes = fr.read_rom(results / "1" / "scene-1.h5").nodes
    moves = np.ones((len(nodes), 3), dtype=bool)
    moves[np.isclose(nodes[:, 0], 0), 0] = False
    moves[np.isclose(nodes[:, 0], 1)] = False
    found, free = checks(results, ranks)[0]["roller"], np.flatnonzero(moves)
    assert found["free"] == free.tolist()
    on_top = np.isclose(nodes[free // 3, 2], LENGTHS[2])
    np.testing.assert_array_equal(found["pushed"], on_top[:, None] & (free[:, None] % 3 == np.arange(3)))


@pytest.mark.parametrize("ranks", RANKS)
def test_multigrid_is_told_of_nodes_and_rigid_motions(results, ranks):
    for rank in checks(results, ranks):
        assert rank["multigrid"] == {"forms-1": [3, 6], "forms-2": [3, 6], "materials": [3, 6], "dashpots": [3, 6]}


def test_factor_that_has_no_room_leaves_a_warning(monkeypatch):
    """Definiteness is told by factors; larger models must not be refused for want of memory."""
    from fenics_rom.fem import user_matrices
    from fenics_rom.fem.direct import MemoryShortage

    def no_room(matrix):
        error = MemoryShortage.__new__(MemoryShortage)
        error.shortage = "the factor would need 1 TB"
        raise error

    monkeypatch.setattr(user_matrices, "PetscFactor", no_room)
    matrices, _ = user_matrices.spread(lambda: (dict(zip(("mass", "damping", "stiffness"), chain(9), strict=True)), {}))
    system = fr.System(**matrices, contacts={"tip": np.ones((9, 1))})
    assert system.warnings == tuple(
        f"{name}: whether it is positive {kind} was not checked: the factor would need 1 TB"
        for name, kind in (("mass", "definite"), ("stiffness", "definite"), ("damping", "semi-definite"))
    )


PETSC_ERRORS = {
    "unsymmetric": "stiffness is not symmetric: |A - Aᵀ| = 4.9e+00, |A| = 8.0e+00",
    "indefinite": "stiffness is not positive definite: mumps could not factor a matrix of 13 unknowns",
    "negative mass": "mass is not positive definite",
    "driving": "damping is not positive semi-definite",
    "size": "stiffness has shape (12, 12); use (13, 13)",
    "nan": "mass holds numbers that are not finite",
    "mixed": "but others are PETSc matrices; use all of them or none",
    "unassembled": "damping is not assembled; call its assemble()",
    "shell": "damping is of type python, which PETSc cannot convert to AIJ",
    "column size": ", columns), the rows of this rank",
    "no column": ", 0); use (",
    "nan column": "outputs['tip'] holds numbers that are not finite",
    "text": "actuators['tip'] cannot be read as columns: could not convert",
    "both": "both damping and rayleigh given; use one of them",
    "neither": "neither damping nor rayleigh given; use one of them",
    "negative rayleigh": "rayleigh = (-0.1, 0.1): use two finite numbers (α, β) from 0",
    "petsc columns": "contacts['tip'] is of PETSc, but the matrices are not",
}
ON_TWO_RANKS = {
    "names": "contacts: the ranks give different names",
    "widths": "contacts['tip']: the ranks give different numbers of columns, [1, 2]",
    "communicator": "stiffness is on another communicator than mass",
    "layout": "but mass has rows 0 to 7; use the same (rank 0)",
}
FORM_ERRORS = {
    "moved": "bcs: a Dirichlet condition has the value 0.001; use 0",
    "all held": "bcs: every degree of freedom is constrained",
    "no condition": "bcs[0] is a FunctionSpace; use Dirichlet conditions of dolfinx",
    "condition elsewhere": "bcs[0] is of another function space than mass",
    "no shear": "stiffness is not positive definite",
    "no form": "stiffness is a float; use a UFL form",
    "no mass": "mass is no UFL form with two arguments; use a bilinear form",
    "linear": "stiffness has 1 argument; use a bilinear form",
    "bilinear": "contacts['tip'][0] has 2 arguments; use a linear form",
    "space": "stiffness is of another function space than mass",
    "empty": "contacts['tip'] has no forms; use one for each column",
    "no contact": "contacts: at least one contact mode is needed",
    "number": "contacts['tip'][0] is a float; use a UFL form",
    "unsymmetric": "stiffness is not symmetric: |A - Aᵀ| = ",
    "outputs": "outputs['tip'] has 2 forms; on a body with nodes",
    "both": "both damping and rayleigh given",
}


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("kind", ["petsc", "form"])
def test_what_cannot_be_used_is_refused_on_all_ranks(results, ranks, kind):
    expected = {"petsc": PETSC_ERRORS | (ON_TWO_RANKS if ranks > 1 else {}), "form": FORM_ERRORS}[kind]
    seen = [rank[f"{kind} errors"] for rank in checks(results, ranks)]
    assert len(seen) == ranks
    assert all(rank == seen[0] for rank in seen)
    assert seen[0].keys() == expected.keys()
    for name, said in expected.items():
        assert seen[0][name][0] == "StructureError", (name, seen[0][name])
        assert said in seen[0][name][1], name
