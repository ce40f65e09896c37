"""What tests/fem/test_forms.py runs under mpirun: `python forms_on_ranks.py SCENE RESULTS`.

Writes ROMs of the box of a scene, made from forms and from PETSc matrices, and checks.json with what every rank saw.
"""

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector, set_bc
from dolfinx.mesh import create_unit_square, exterior_facet_indices, locate_entities_boundary, meshtags
from mpi4py import MPI
from petsc4py import PETSc
from ufl import Identity, dx, grad, inner, sym, tr

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.dolfinx_compat import OLD, cell_constants, cell_dofs, create_cells, vector_space
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.user_matrices import spread

COMM = MPI.COMM_WORLD
E, NU, RHO = 1.0e6, 0.3, 1000.0
ALPHA, BETA = (1.0, 5.0), (1e-3, 2e-4)  # of the halves x < 0.5 and x > 0.5, 1/s and s
DASHPOT = 40.0  # on the right face, N s/m³
LEFT, RIGHT, TOP = 1, 2, 3


class Box:
    """The box of the scene, built with dolfinx alone."""

    def __init__(self, mesh_file, degree):
        self.mesh_file = mesh_file
        mesh = read_mesh(mesh_file, {})
        root = COMM.rank == 0
        cells, points = (mesh.cells, mesh.points) if root else (np.empty((0, 4)), np.empty((0, 3)))
        self.domain = create_cells(COMM, cells, points)
        self.space = vector_space(self.domain, degree)
        ends = mesh.points.max(axis=0)
        faces = {
            LEFT: lambda x: np.isclose(x[0], 0),
            RIGHT: lambda x: np.isclose(x[0], ends[0]),
            TOP: lambda x: np.isclose(x[2], ends[2]),
        }
        self.facets = {tag: locate_entities_boundary(self.domain, 2, face) for tag, face in faces.items()}
        self.areas = {RIGHT: ends[1] * ends[2], TOP: ends[0] * ends[1]}
        self.u, self.v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        dofs = fem.locate_dofs_topological(self.space, 2, self.facets[LEFT])
        self.clamp = fem.dirichletbc(np.zeros(3), dofs, self.space)

    def ds(self, tag):
        facets = np.sort(self.facets[tag])
        tags = meshtags(self.domain, 2, facets, np.full(len(facets), tag, dtype=np.int32))
        return ufl.Measure("ds", domain=self.domain, subdomain_data=tags)(tag)

    def by_half(self, left, right):
        """A coefficient with one value where x < 0.5 and another beyond."""
        function = fem.Function(cell_constants(self.domain))
        dofs = cell_dofs(function.function_space).ravel()
        middle = function.function_space.tabulate_dof_coordinates()[dofs, 0]
        function.x.array[dofs] = np.where(middle < 0.5, left, right)
        return function

    def mass(self, density=RHO):
        return density * inner(self.u, self.v) * dx

    def stiffness(self, young=E):
        μ, strain = young / (2 * (1 + NU)), sym(grad(self.u))
        stress = 2 * μ * strain + 2 * μ * NU / (1 - 2 * NU) * tr(strain) * Identity(3)
        return inner(stress, sym(grad(self.v))) * dx

    def by_material(self):
        """Damping with α and β of their own in each half."""
        α, β = self.by_half(*ALPHA), self.by_half(*BETA)
        return self.mass(α * RHO) + self.stiffness(β * E)

    def dashpots(self):
        """α M + β K and dashpots over the right face."""
        distributed = DASHPOT * inner(self.u, self.v) * self.ds(RIGHT)
        return self.mass(ALPHA[0] * RHO) + self.stiffness(BETA[0] * E) + distributed

    def resultants(self, tag):
        """Unit forces, and mean displacements, of a face."""
        ds = self.ds(tag)
        return [1 / self.areas[tag] * self.v[k] * ds for k in range(3)]

    def system(self, **parts):
        resultants = {"right": self.resultants(RIGHT), "top": self.resultants(TOP)}
        given = {"mass": self.mass(), "stiffness": self.stiffness(), "contacts": resultants, "bcs": [self.clamp]}
        return fr.assemble_forms(**given | {"outputs": {"tip": self.resultants(RIGHT)}} | parts)


def chain(size):
    """M, D and K of masses between springs, two of them with dashpots to the ground: SciPy, all rows."""
    K = scipy.sparse.diags([-np.ones(size - 1), 2 * np.ones(size), -np.ones(size - 1)], [-1, 0, 1]).tocsr()
    M = scipy.sparse.diags(1 + np.arange(size) / size).tocsr()
    return M, 0.1 * M + 0.05 * K + scipy.sparse.diags(1.0 * (np.arange(size) % 13 == 0)).tocsr(), K


def distributed(*matrices):
    """PETSc matrices of SciPy ones."""
    held, _ = spread(lambda: ({str(k): matrix for k, matrix in enumerate(matrices)}, {}))
    return list(held.values())


def upper_half(mat):
    """The same matrix as PETSc keeps symmetric ones."""
    half = PETSc.Mat().createSBAIJ(mat.getSizes(), 1, nnz=9, comm=COMM)
    half.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
    for row in range(*mat.getOwnershipRange()):
        columns, values = mat.getRow(row)
        half.setValues([row], columns, values)
    half.assemble()
    return half


def as_vectors(mat, block):
    vectors = []
    for column in block.T:
        vectors.append(mat.createVecRight())
        vectors[-1].array[:] = column
    return vectors


def as_dense(mat, block):
    dense = PETSc.Mat().createDense((mat.getSizes()[0], (None, block.shape[1])), comm=COMM)
    dense.setUp()
    dense.getDenseArray()[:] = block
    dense.assemble()
    return dense


def petsc_results():
    """σ of one chain in every format, and what is found of its damping."""
    matrices = distributed(*chain(31))
    M = matrices[0]
    here = slice(*M.getOwnershipRange())
    block = np.eye(31)[here, [0, 17]]
    parts = dict(zip(("mass", "damping", "stiffness"), matrices, strict=True))
    before = [matrix.norm() for matrix in matrices]
    σ = {}
    for name, convert in {
        "aij": lambda m: m,
        "sbaij": upper_half,
        "dense": lambda m: m.convert("dense", PETSc.Mat()),
    }.items():
        σ[name] = hankel({key: convert(matrix) for key, matrix in parts.items()}, block)
    for columns in (as_vectors(M, block), as_dense(M, block), scipy.sparse.csr_matrix(block)):
        σ[type(columns).__name__] = hankel(parts, columns)
    proportional = fr.System(**parts | {"damping": None, "rayleigh": (0.1, 0.05)}, contacts={"ends": block})
    found = fr.System(**parts | {"damping": proportional.damping.mat}, contacts={"ends": block})
    (skewed,) = distributed(chain(31)[2] + 1e-12 * scipy.sparse.tril(chain(31)[2]))
    mended = fr.System(**parts | {"stiffness": skewed}, contacts={"ends": block}).stiffness.mat
    (dashpots,) = distributed(scipy.sparse.diags(1.0 * (np.arange(31) % 13 == 0)).tocsr())
    return {
        "σ": σ,
        "semi-definite": error_of(lambda: fr.System(**parts | {"damping": dashpots}, contacts={"ends": block})),
        "symmetric": [bool(mat.equal(mat.transpose(PETSc.Mat()))) for mat in (skewed, mended)],
        "rayleigh": [found.rayleigh, fr.System(**parts, contacts={"ends": block}).rayleigh],
        "untouched": before == [matrix.norm() for matrix in matrices],
    }


def hankel(matrices, columns):
    rom = fr.reduce(fr.System(**matrices, contacts={"ends": columns}), order=8)
    return rom.contact_models["ends"].hankel_singular_values[:8].tolist()


def petsc_errors():
    """What comes of matrices and columns that cannot be used."""
    M, D, K = chain(13)
    narrow = chain(12)[2]
    lower = scipy.sparse.tril(K).tocsr()
    holed = K.copy()
    holed[3, 3] = np.nan
    m, d, k, small, skew, indefinite, sinking, nan = distributed(
        M, D, K, narrow, lower, K - 0.5 * scipy.sparse.identity(13), D - scipy.sparse.identity(13), holed
    )
    empty = PETSc.Mat().createAIJ(m.getSizes(), comm=COMM)
    empty.setUp()
    alone = PETSc.Mat().createAIJ((13, 13), comm=PETSc.COMM_SELF, csr=(K.indptr, K.indices, K.data))
    start, stop = m.getOwnershipRange()
    last = COMM.rank == COMM.size - 1
    rows = stop - start
    good = np.ones((rows, 1))
    uneven = PETSc.Mat().createAIJ(((13 if last else 0, 13), (13 if last else 0, 13)), comm=COMM)
    uneven.setUp()
    uneven.assemble()
    shell = PETSc.Mat().createPython(m.getSizes(), context=object(), comm=COMM)
    shell.setUp()
    parts = {"mass": m, "damping": d, "stiffness": k, "contacts": {"tip": good}}
    wrong = {
        "unsymmetric": {"stiffness": skew},
        "indefinite": {"stiffness": indefinite},
        "negative mass": {"mass": indefinite},
        "driving": {"damping": sinking},
        "size": {"stiffness": small},
        "nan": {"mass": nan},
        "mixed": {"mass": M},
        "unassembled": {"damping": empty},
        "shell": {"damping": shell},
        "column size": {"contacts": {"tip": np.ones((rows + last, 1))}},
        "no column": {"contacts": {"tip": np.ones((rows, 0))}},
        "nan column": {"outputs": {"tip": good * (np.nan if last else 1.0)}},
        "text": {"actuators": {"tip": [["x"]] * rows if last else good}},
        "both": {"rayleigh": (0.1, 0.1)},
        "neither": {"damping": None},
        "negative rayleigh": {"damping": None, "rayleigh": (-0.1, 0.1)},
        "petsc columns": {"mass": M, "damping": D, "stiffness": K, "contacts": {"tip": as_vectors(m, good)}},
    }
    if COMM.size > 1:
        wrong |= {
            "names": {"contacts": {"tip" if last else "top": good}},
            "widths": {"contacts": {"tip": np.ones((rows, 2 if last else 1))}},
            "communicator": {"stiffness": alone},
            "layout": {"stiffness": uneven},
        }
    return {name: error_of(lambda part=part: fr.System(**parts | part)) for name, part in wrong.items()}


def form_errors(box):
    """What comes of forms and boundary conditions that cannot be used."""
    other = Box(box.mesh_file, 1)
    everywhere = exterior_facet_indices(box.domain.topology)
    inner_dofs = np.arange(box.space.dofmap.index_map.size_local + box.space.dofmap.index_map.num_ghosts)
    moved = fem.dirichletbc(
        np.array([0.0, 0.0, 1e-3]), fem.locate_dofs_topological(box.space, 2, everywhere), box.space
    )
    one = box.resultants(RIGHT)
    wrong = {
        "moved": {"bcs": [moved]},
        "all held": {"bcs": [fem.dirichletbc(np.zeros(3), inner_dofs.astype(np.int32), box.space)]},
        "no condition": {"bcs": [box.space]},
        "condition elsewhere": {"bcs": [other.clamp]},
        "no shear": {"stiffness": E * tr(grad(box.u)) * tr(grad(box.v)) * dx},
        "no form": {"stiffness": 1.0},
        "no mass": {"mass": one[0]},
        "linear": {"stiffness": one[0]},
        "bilinear": {"contacts": {"tip": [box.mass()]}},
        "space": {"stiffness": other.stiffness()},
        "empty": {"contacts": {"tip": []}},
        "no contact": {"contacts": {}},
        "number": {"contacts": {"tip": [1.0]}},
        "unsymmetric": {"stiffness": box.stiffness() + E * inner(grad(box.u)[0, 1], box.v[0]) * dx},
        "outputs": {"outputs": {"tip": one[:2]}},
        "both": {"damping": box.mass()},
    }
    return {
        name: error_of(lambda part=part: box.system(**{"rayleigh": (1.0, 1e-3)} | part)) for name, part in wrong.items()
    }


def error_of(work):
    """Kind and text of the error that `work` raises here."""
    try:
        work()
    except FenicsRomError as error:
        return [type(error).__name__, str(error)]
    return ["none", ""]


def membrane():
    """A scalar model in the plane: σ and sizes."""
    domain = create_unit_square(COMM, 6, 5)
    space = (fem.FunctionSpace if OLD else fem.functionspace)(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    domain.topology.create_connectivity(1, 2)
    rim = fem.locate_dofs_topological(space, 1, exterior_facet_indices(domain.topology))
    system = fr.assemble_forms(
        mass=u * v * dx,
        damping=0.1 * u * v * dx,
        stiffness=inner(grad(u), grad(v)) * dx,
        contacts={"all": v * dx},
        outputs={"mean": [v * dx]},
        bcs=[fem.dirichletbc(PETSc.ScalarType(0), rim, space)],
    )
    rom = fr.reduce(system, order=4)
    return {
        "size": system.size,
        "nodes": len(rom.nodes),
        "σ": rom.contact_models["all"].hankel_singular_values[:4].tolist(),
        "lowest": float(rom.contact_models["all"].eigenvalues[0]),
        "outputs": list(rom.outputs["mean"].shape),
    }


def roller(box):
    """Free components, and those pushed on top, where the left face slides in its plane and the right one is held."""
    sliding = fem.locate_dofs_topological(box.space.sub(0), 2, box.facets[LEFT])
    held = fem.locate_dofs_topological(box.space, 2, box.facets[RIGHT])
    bcs = [
        fem.dirichletbc(PETSc.ScalarType(0), sliding, box.space.sub(0)),
        fem.dirichletbc(np.zeros(3), held, box.space),
    ]
    system = box.system(rayleigh=(1.0, 1e-3), bcs=bcs)
    pushed = system.algebra.gather(system.contacts["top"]) > 1e-6
    return {"free": system.body.free.tolist(), "pushed": pushed.tolist()}


def kept_rows(box):
    """The box with dashpots as PETSc matrices, its clamp kept in them as rows of unit diagonals."""
    matrices = {}
    for name, form in {"mass": box.mass(), "damping": box.dashpots(), "stiffness": box.stiffness()}.items():
        matrices[name] = assemble_matrix(fem.form(form), bcs=[box.clamp])
        matrices[name].assemble()
    columns = []
    for form in box.resultants(TOP):
        columns.append(assemble_vector(fem.form(form)))
        columns[-1].ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        set_bc(columns[-1], [box.clamp])
    return fr.System(**matrices, contacts={"top": columns})


def main(folder, results):
    warnings.simplefilter("ignore")
    boxes = {degree: Box(folder / "box.msh", degree) for degree in (1, 2)}
    box = boxes[1]
    systems = {f"scene-{degree}": fr.assemble(fr.read_scene(folder / f"box-{degree}.toml")) for degree in boxes}
    systems |= {f"forms-{degree}": boxes[degree].system(rayleigh=(1.0, 1e-3)) for degree in boxes}
    systems |= {
        "materials": box.system(damping=box.by_material()),
        "dashpots": box.system(damping=box.dashpots()),
        "kept": kept_rows(box),
    }
    near = {name: system.stiffness.mat.getNearNullSpace() for name, system in systems.items()}
    for name, system in systems.items():
        rom = fr.reduce(system, order=12)
        if COMM.rank == 0:
            fr.write_rom(results / f"{name}.h5", rom)
    checks = {
        "rayleigh": {name: system.rayleigh for name, system in systems.items()},
        "multigrid": {
            name: [systems[name].stiffness.mat.getBlockSize(), len(near[name].getVecs())]
            for name in ("forms-1", "forms-2", "materials", "dashpots")
        },
        "petsc": petsc_results(),
        "petsc errors": petsc_errors(),
        "form errors": form_errors(box),
        "membrane": membrane(),
        "roller": roller(box),
    }
    everyone = COMM.gather(checks, root=0)
    if COMM.rank == 0:
        (results / "checks.json").write_text(json.dumps(everyone))


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:]))
