"""Hexahedra, and curved cells: exact where the elements hold the field, refused where they are inside out."""

from pathlib import Path

import gmsh
import numpy as np
import pytest
from bodies import acted_on, assembled, scene_text
from bricks import hexahedra, shaken_bricks, write_bricks
from test_large_deformation import start_at
from test_mesh import write_gmsh

import fenics_rom as fr
from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.cell_points import cell_at, cell_volumes, checked_nodes
from fenics_rom.fem.facets import facet_integrals, volume_within_surface
from fenics_rom.fem.finite_strain.model import ExternalForce
from fenics_rom.fem.finite_strain.residuals import QuasiStaticResidual
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene
from fenics_rom.scene.foreign_process import in_vtk_order

LENGTHS, BRICKS = (1.0, 0.4, 0.3), (3, 2, 2)
YOUNG, POISSON, PRESSURE = 1e6, 0.3, 50.0
ROUND_OFF = 1e-10  # of solves of some hundred unknowns
KINDS = [(8, 1), (8, 2), (20, 2), (27, 2)]
POINTS = [[0.31, 0.22, 0.13], [1.0, 0.4, 0.3], [0.7, 0.1, 0.25]]
ROLLERS = "".join(
    f'\n[[supports.held]]\nsurface = "{surface}"\nnormal = {normal}'
    for surface, normal in {"left": [1, 0, 0], "front": [0, 1, 0], "bottom": [0, 0, 1]}.items()
)
PRESSED = f"dt = 1.0\nduration = 1.0\nload = [{{ actuator = 'air', force = [{PRESSURE}] }}]"


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bricks")
    return {n: write_bricks(folder / f"{n}.msh", *shaken_bricks(LENGTHS, BRICKS, n)) for n in (8, 20, 27)}


@pytest.mark.parametrize("integration", ["full", "selective"])
@pytest.mark.parametrize(("nodes", "degree"), KINDS)
def test_an_even_stress_is_exact(meshes, nodes, degree, integration):
    """A block on rollers under pressure (Irons' patch test): displacements and stress are those of the closed form."""
    tables = {"supports": f"clamped = []{ROLLERS}", "run": PRESSED, "outputs.at": f"points = {POINTS}"}
    tables |= {"readings.at": f'quantity = "stress"\npoints = {POINTS}', "readings.skin": 'quantity = "strain"'}
    pressed = 'pressure.air = { surface = "right" }'
    fields = ("principal_stress", "pressure", "energy_density") if integration == "full" else ()
    tables |= {f"readings.{quantity}": f'quantity = "{quantity}"\nsurface = "top"' for quantity in fields}
    scene = acted_on(meshes[nodes], pressed, degree=degree, integration=integration, **tables)
    run = fr.simulate(fr.assemble(scene))
    strain = -PRESSURE / YOUNG * np.array([1.0, -POISSON, -POISSON])
    found = run.outputs["at"][-1]
    assert np.abs(found.reshape(-1, 3) - strain * POINTS).max() <= ROUND_OFF * PRESSURE / YOUNG
    stress = run.readings["at"].values[-1]
    exact = np.array([-PRESSURE, 0, 0, 0, 0, 0, 0, 0, -PRESSURE, PRESSURE, 0])
    assert np.abs(stress - exact).max() <= ROUND_OFF * PRESSURE
    assert np.abs(run.readings["skin"].values[-1] - [*strain, 0, 0, 0]).max() <= ROUND_OFF * PRESSURE / YOUNG
    for name, exact in zip(fields, ([0, 0, -PRESSURE], PRESSURE / 3, PRESSURE**2 / (2 * YOUNG)), strict=False):
        values = run.readings[name].values[-1]
        assert len(values) == 2 * BRICKS[0] * BRICKS[1] * (4 if degree == 2 else 1)
        assert np.abs(values - exact).max() <= ROUND_OFF * np.abs(exact).max()


@pytest.mark.parametrize(("nodes", "degree"), KINDS)
def test_surface_and_cells_enclose_the_same(meshes, nodes, degree):
    """∫ n dA of a closed surface is 0, ∫ x·n dA/3 the volume of the cells, which fill the box."""
    of_nodes = checked_nodes(read_mesh(meshes[nodes], {}), degree)
    assert of_nodes.is_curved == (nodes > 8)
    integrals = facet_integrals(of_nodes, of_nodes.surface)
    volume, area = np.prod(LENGTHS), 2 * (1.0 * 0.4 + 1.0 * 0.3 + 0.4 * 0.3)
    assert np.abs(integrals.vectors.sum(axis=(0, 1))).max() <= 1e-14
    assert abs(integrals.shares.sum() / area - 1) <= 1e-13
    assert abs(cell_volumes(of_nodes).sum() / volume - 1) <= 1e-13
    assert abs(volume_within_surface(of_nodes, of_nodes.surface, np.array([0.3, 2.0, 1.0])) / volume - 1) <= 1e-13
    sides = np.bincount(of_nodes.owner, minlength=len(of_nodes.cells))
    assert sides.sum() == 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2)  # halves of quadrilaterals on both sides along each axis


@pytest.mark.parametrize(("nodes", "degree"), [(8, 1), (27, 2)])
@pytest.mark.parametrize("integration", ["full", "selective"])
def test_at_rest_the_tangent_is_the_linear_stiffness(meshes, nodes, degree, integration):
    scene = {"degree": degree, "integration": integration, "supports": None}
    system = assembled(meshes[nodes], effects="large_deformation = {}\n", **scene)
    assert system.rigid.shape[1] == 6
    model, zero = system.deformation.model, np.zeros((system.size, 1))
    dx = np.random.default_rng(1).standard_normal(zero.shape)
    equation = QuasiStaticResidual(model, start_at(system, zero), ExternalForce(zero, ()), 1.0, zero)
    expected = system.stiffness @ dx
    found = equation.apply_tangent(equation.evaluate(zero), dx)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def quarter_of_a_tube(nodes):
    """Radii 1 and 2, 1 long: two cells along the quarter circle."""
    points, cells, faces = hexahedra((1, 2, 1), nodes)
    radius, angle = 1 + points[:, 0], np.pi / 2 * points[:, 1]
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 2]]), cells, faces


def of_tetrahedra(folder):
    """The same of ten-node tetrahedra, by Gmsh."""

    def make():
        outer = gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 1, 2, angle=np.pi / 2)
        gmsh.model.occ.cut([(3, outer)], [(3, gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 1, 1))])
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0.7)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)

    write_gmsh(folder / "10.msh", make)
    return folder / "10.msh"


@pytest.mark.parametrize("nodes", [10, 20, 27])
def test_curved_cells_stay_curved(tmp_path, nodes):
    """The tube's volume, mass and area; straight cells lack a tenth of the first."""
    file = of_tetrahedra(tmp_path) if nodes == 10 else write_bricks(tmp_path / "tube.msh", *quarter_of_a_tube(nodes))
    mesh, volume, every = read_mesh(file, {}), 3 * np.pi / 4, "[contacts.all]\nnear = { point = [1, 1, 0], radius = 9 }"
    straight, curved = (checked_nodes(mesh, degree) for degree in (1, 2))
    assert curved.is_curved
    found = cell_volumes(curved).sum()
    assert cell_volumes(straight).sum() < (1 - 0.005) * volume
    assert found == pytest.approx(volume, rel=2e-3)
    assert volume_within_surface(curved, curved.surface, np.ones(3)) == pytest.approx(found, rel=1e-12)
    system = assembled(file, degree=2, supports=None, contacts=every)
    assert system.body.node_mass.sum() == pytest.approx(1000 * found, rel=1e-12)
    assert system.rigid.shape[1] == 6
    assert system.warnings == ()


def test_a_point_in_a_curved_cell_is_found(tmp_path):
    nodes = checked_nodes(read_mesh(write_bricks(tmp_path / "tube.msh", *quarter_of_a_tube(20)), {}), 2)
    for ξ in np.random.default_rng(2).random((20, 3)):
        place = nodes.kind.shapes(2, ξ)[0][0] @ nodes.coordinates[nodes.cell_nodes[1]]
        cell, found = cell_at(nodes, place, "here")
        assert cell == 1
        assert np.abs(found - ξ).max() <= 1e-10


@pytest.mark.parametrize("nodes", [20, 27])
def test_cells_that_are_inside_out_once_curved_are_refused(tmp_path, nodes):
    points, cells, faces = quarter_of_a_tube(nodes)
    points[cells[1, 8]] += [0.0, 0.9, 0.0]  # the middle of an edge, pulled past its neighbours
    file = write_bricks(tmp_path / "bent.msh", points, cells, faces)
    said = r"2 of 2 cells are inside out at points of quadrature, curved as .*, the worst around \[.*\]: .* above 0"
    with pytest.raises(MeshError, match=said):
        fr.assemble(parse_scene(scene_text(file, degree=2)))
    assert fr.assemble(parse_scene(scene_text(file, degree=1))).size  # edges are straight there


def test_cells_with_a_corner_through_the_others_are_refused(tmp_path):
    points, cells, faces = hexahedra((2, 1, 1))
    points[cells[0, 1]] = [0.05, 0.6, 0.6]
    with pytest.raises(MeshError, match=r"1 of 2 cells are inside out at points of quadrature, the worst around \[0.1"):
        fr.assemble(parse_scene(scene_text(write_bricks(tmp_path / "bent.msh", points, cells, faces))))


def test_collapsed_cells_are_refused(tmp_path):
    points, cells, _ = hexahedra((1, 1, 1))
    cells[0, 6] = cells[0, 5]
    with pytest.raises(MeshError, match=r"1 of 1 cells have a node twice, e.g. cell 0; hexahedra that are collapsed"):
        read_mesh(write_bricks(tmp_path / "wedge.msh", points, cells, {}), {})


def numbers(rows):
    return " ".join(map(str, np.asarray(rows).ravel().tolist()))


def write_vtk(path, points, cells, faces):
    """The faces of the right side have the tag 7, cells the tag 8."""
    solid, flat = {8: (12, 9), 20: (25, 23), 27: (29, 28)}[cells.shape[1]]
    every = [[len(nodes), *nodes] for nodes in (*cells.tolist(), *faces["right"].tolist())]
    counts = len(cells), len(faces["right"])
    kinds, tags = ([of_cells] * counts[0] + [of_faces] * counts[1] for of_cells, of_faces in ((solid, flat), (8, 7)))
    path.write_text(
        f"# vtk DataFile Version 3.0\nb\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(points)} double\n"
        f"{numbers(points)}\nCELLS {sum(counts)} {sum(map(len, every))}\n{' '.join(map(numbers, every))}\n"
        f"CELL_TYPES {sum(counts)}\n{numbers(kinds)}\nCELL_DATA {sum(counts)}\nSCALARS part int 1\n"
        f"LOOKUP_TABLE default\n{numbers(tags)}\n"
    )


def write_xdmf(path, points, cells, faces):
    """The same."""
    names = {8: ("Hexahedron", "Quadrilateral"), 20: ("Hexahedron_20", "Quadrilateral_8")}
    names |= {27: ("Hexahedron_27", "Quadrilateral_9"), 6: ("Wedge", "Triangle")}
    names |= {15: ("Wedge_15", "Triangle_6"), 18: ("Wedge_18", "Triangle_6")}
    geometry = f"<Geometry>{item(points, 'Float')}</Geometry>"
    grids = [
        f'<Grid Name="{name}"><Topology TopologyType="{kind}">{item(rows, "Int")}</Topology>{geometry}'
        f'<Attribute Center="Cell" Name="{name}">{item(np.full(len(rows), tag), "Int")}</Attribute></Grid>'
        for name, kind, rows, tag in zip(
            ("cells", "faces"), names[cells.shape[1]], (cells, faces["right"]), (8, 7), strict=True
        )
    ]
    path.write_text(f"<Xdmf><Domain>{''.join(grids)}</Domain></Xdmf>")


def item(rows, kind):
    shape = " ".join(map(str, np.shape(rows)))
    return f'<DataItem Dimensions="{shape}" NumberType="{kind}" Format="XML">{numbers(rows)}</DataItem>'


@pytest.mark.parametrize("nodes", [8, 20, 27])
@pytest.mark.parametrize(("ending", "write"), [(".vtk", write_vtk), (".xdmf", write_xdmf)])
def test_the_same_hexahedra_come_from_any_format(tmp_path, meshes, nodes, ending, write):
    points, cells, faces = shaken_bricks(LENGTHS, BRICKS, nodes)
    write(tmp_path / f"box{ending}", points, in_vtk_order(cells), faces)
    mesh, of_gmsh = read_mesh(tmp_path / f"box{ending}", {"right": 7, "body": 8}), read_mesh(meshes[nodes], {})
    one, other = (checked_nodes(each, 2) for each in (mesh, of_gmsh))
    assert np.abs(one.coordinates - other.coordinates).max() <= 1e-15
    np.testing.assert_array_equal(one.cell_nodes, other.cell_nodes)
    np.testing.assert_array_equal(mesh.surface("right"), of_gmsh.surface("right"))
    np.testing.assert_array_equal(mesh.region("body"), np.arange(len(cells)))


@pytest.mark.parametrize(("nodes", "degree"), [(8, 1), (27, 2)])
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_an_even_contact_pressure_is_exact(meshes, tmp_path, nodes, degree, model):
    """Held on top and pressed from below by d, without Poisson's effect: E d / H at every node, and on the surface."""
    floor = 'contact.obstacles.floor = { shape = "half-space", point = [0, 0, 0], normal = [0, 0, 1] }'
    tables = {"supports": 'clamped = ["top"]', "readings.sole": 'quantity = "contact_pressure"\nof = "sole"'}
    tables |= {"readings.at": 'quantity = "stress"\npoints = [[0.31, 0.22, 0.13]]', "effects": floor}
    material = f"young = {YOUNG}\npoisson = 0.0\ndensity = 1000.0"
    sole = '[contacts.sole]\nsurface = "bottom"'
    scene = parse_scene(scene_text(meshes[nodes], degree=degree, material=material, contacts=sole, **tables))
    system, signals = fr.assemble(scene), {"floor": lambda t: [0.0, 0.0, 1e-3 * t]}
    if model == "full":
        body = FullOrderSimulator(system, 1.0, scene.environment, signals)
    else:
        fr.write_rom(tmp_path / "rom.h5", fr.reduce(system, order=len(system.contact_points["sole"]) * 3))
        body = fr.Simulator(fr.read_rom(tmp_path / "rom.h5"), 1.0, signals=signals)
    body.step(np.zeros(0))
    pressure = YOUNG * 1e-3 / LENGTHS[2]
    assert np.abs(body.reading("sole") / pressure - 1).max() <= 1e-6
    below = np.isclose(system.body.nodes[:, 2], 0.0)
    assert np.abs(body.contact_pressure()[below] / pressure - 1).max() <= 1e-6
    assert np.abs(body.reading("at")[0, [2, 8, 9]] / pressure - [-1, -1, 1]).max() <= 1e-6


def test_fields_of_a_reduced_body_are_those_of_full_order_and_are_exported(meshes, tmp_path):
    """A body that deforms by a few percent: Cauchy's stresses, and energy by volume at rest."""
    quantities = ("principal_stress", "pressure", "energy_density", "von_mises_stress", "surface_stress")
    tables = {f"readings.{quantity}": f'quantity = "{quantity}"\nsurface = "left"' for quantity in quantities}
    tables["run"] = 'dt = 1.0\nduration = 1.0\nload = [{ contact = "right", force = [0.0, 0.0, 300.0] }]'
    tables["contacts"] = '[contacts.right]\nsurface = "right"\nforce = "resultant"'
    scene = acted_on(meshes[8], 'large_deformation = { material = "neo_hookean" }', **tables)
    run = fr.simulate(fr.assemble(scene))
    fr.write_trajectory(tmp_path / "run.h5", run)
    kept = fr.read_trajectory(tmp_path / "run.h5").readings
    principal, pressure, energy, von_mises, stress = (kept[quantity].values[-1] for quantity in quantities)
    tensors = stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    assert np.abs(np.linalg.eigvalsh(tensors)[:, ::-1] - principal).max() <= ROUND_OFF * np.abs(principal).max()
    assert np.abs(kept["surface_stress"].sizes[-1] - von_mises).max() <= ROUND_OFF * von_mises.max()
    assert np.abs(pressure + principal.mean(axis=1)).max() <= ROUND_OFF * np.abs(principal).max()
    differences = principal - np.roll(principal, 1, axis=1)
    assert np.abs(von_mises - np.sqrt((differences**2).sum(axis=1) / 2)).max() <= ROUND_OFF * von_mises.max()
    assert energy.min() > 0
    assert kept["principal_stress"].sizes[-1].max() == np.abs(principal).max()
    fr.export(run, tmp_path / "run.vtu")
    text = (tmp_path / "run.vtu").read_bytes()
    for quantity in quantities:
        assert f'Name="reading.{quantity}"'.encode() in text


REFUSED = {
    ("selective", 'quantity = "pressure"'): r"quantity = 'pressure': with mesh.integration = 'selective' changes of",
    ("full", "effects.cables.wire = { points = [[0.1, 0.1, 0.1], [0.9, 0.1, 0.1]], stiffness = 1.0 }"): (
        r"effects.cables.wire: cables are computed in straight tetrahedra; .* are hexahedra"
    ),
}


@pytest.mark.parametrize(("given", "said"), REFUSED.items(), ids=range(len(REFUSED)))
def test_what_hexahedra_do_not_have_is_told(meshes, given, said):
    integration, what = given
    tables = {"readings.skin": what} if what.startswith("quantity") else {}
    effects = what.removeprefix("effects.") if what.startswith("effects") else ""
    with pytest.raises(SceneError, match=said):
        fr.assemble(acted_on(meshes[8], effects, integration=integration, **tables))


@pytest.mark.parametrize(("integration", "rise"), [("full", (0.2, 0.5)), ("selective", (0.94, 1.0))])
def test_hexahedra_of_degree_1_lock_unless_integrated_selectively(monkeypatch, integration, rise):
    """Cook's membrane, ν = 0.4999, of 8 x 8 x 1 cells: its corner rises by 6.9."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "demos" / "benchmarks"))
    from rubber import cook_of

    assert rise[0] < cook_of((8, 8, 1), integration, 8, 1)[1] / 6.9 < rise[1]
