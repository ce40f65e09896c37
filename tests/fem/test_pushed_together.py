"""Contact modes that are pushed at the same time: sums of responses, full order and reduced, and what is refused."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

LENGTHS = (0.3, 0.03, 0.02)
ALONE = '[contacts.right]\nsurface = "right"\n[contacts.top]\nsurface = "top"\nforce = "normal"\n'
BOTH = ALONE + '[contacts.both]\ntogether = ["right", "top"]\n'
RIGHT = '{ contact = "right", stop = 0.03, force = [0.0, 0.02, 0.03] }'
TOP = '{ contact = "top", start = 0.01, stop = 0.05, force = [0.05] }'


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *box_arrays(LENGTHS, (4, 1, 1)))


def scene_of(mesh, loads, contacts=BOTH, frame="fixed", **parts):
    text = scene_text(
        mesh,
        material="young = 5e5\npoisson = 0.3\ndensity = 1100.0",
        damping="alpha = 0.5, beta = 2e-4",
        contacts=contacts,
        run=f"dt = 2e-3\nduration = 0.06\nsnapshots = 30\nload = [{', '.join(loads)}]",
        **{"outputs.tip": "points = [[0.3, 0.03, 0.02]]"},
        **parts,
    )
    return parse_scene(f'frame = "{frame}"\n{text}')


def test_responses_of_a_linear_body_add_up(mesh):
    """Right alone, top alone, and both with a part of the time in which both are pushed."""
    both, *alone = (fr.simulate(fr.assemble(scene_of(mesh, loads))) for loads in ((RIGHT, TOP), (RIGHT,), (TOP,)))
    together = sum(run.snapshots for run in alone)
    assert abs(both.snapshots - together).max() <= 1e-12 * abs(together).max()
    assert {both.contacts[number] for number in both.contact} == {"right", "both"}


@pytest.mark.parametrize("frame", ["fixed", "moving"])
def test_reduced_body_in_all_modes_does_what_full_order_does(mesh, frame):
    system = fr.assemble(scene_of(mesh, (RIGHT, TOP), frame=frame))
    runs = fr.simulate(system), fr.simulate(fr.reduce(system, order=system.size, method="modal"))
    assert fr.compare(runs[1], runs[0])["shape"].relative < 1e-9
    assert all(run.balance_error < 1e-11 for run in runs)


@pytest.mark.parametrize("frame", ["fixed", pytest.param("moving", marks=pytest.mark.slow)])
def test_body_that_bends_far_is_pushed_as_by_an_actuator_beside_one_contact_mode(mesh, frame):
    """Which has the same forces in other columns; the reduced body comes near that, by its training under both."""
    bent = {"effects.large_deformation": 'material = "st_venant_kirchhoff"'}
    loads = RIGHT.replace("[0.0, 0.02, 0.03]", "[0.0, 1.0, 1.5]"), TOP.replace("[0.05]", "[4.0]")
    system = fr.assemble(scene_of(mesh, loads, frame=frame, **bent))
    right, top = ALONE.split("[contacts.top]")
    beside = scene_of(
        mesh,
        (loads[0], loads[1].replace("contact", "actuator")),
        frame=frame,
        contacts=f"{right}[actuators.top]{top}",
        **bent,
    )
    full, other = fr.simulate(system), fr.simulate(fr.assemble(beside))
    assert np.abs(full.snapshots).max() > 0.01
    np.testing.assert_allclose(full.snapshots, other.snapshots, rtol=0, atol=1e-9 * np.abs(other.snapshots).max())
    reduced = fr.simulate(fr.reduce(system, order=20))
    assert fr.compare(reduced, full)["shape"].relative < 0.02
    assert reduced.balance_error < 1e-11


def test_inputs_have_the_names_of_their_contact_modes(mesh, tmp_path):
    system = fr.assemble(scene_of(mesh, (RIGHT, TOP)))
    rom = fr.reduce(system, order=12)
    fr.write_rom(tmp_path / "beam.h5", rom)
    named, placed = (fr.Simulator(fr.read_rom(tmp_path / "beam.h5"), 1e-3) for _ in range(2))
    for body in (named, placed):
        body.switch("both")
    for step in range(20):
        named.step(top=[0.05 * step], right=[0.0, 0.02, 0.03])
        placed.step([0.0, 0.02, 0.03, 0.05 * step])
    np.testing.assert_array_equal(named.state[0], placed.state[0])
    assert rom.input_columns("both") == {"right": 3, "top": 1}


@pytest.mark.parametrize(
    ("contacts", "loads", "said"),
    [
        (
            ALONE,
            (RIGHT, TOP),
            r"at 0.01 s 'right' and 'top' are pushed at the same time.*together = \[\"right\", \"top\"\]",
        ),
        (BOTH.replace('"top"]', '"roof"]'), (RIGHT,), "contacts.both.together: .*'roof'"),
        (BOTH.replace('"top"]', '"right"]'), (RIGHT,), "every contact mode once"),
        (BOTH + '[contacts.all]\ntogether = ["both", "top"]\n', (RIGHT,), "'both' is made of others"),
        (BOTH + 'force = "wrench"\n', (RIGHT,), "contacts.both.force: is that of each of right, top"),
        (BOTH + 'surface = "top"\n', (RIGHT,), "contacts.both"),
        (
            BOTH + '[actuators.hand]\ntogether = ["right", "top"]\n',
            (RIGHT,),
            "actuators.hand.together: goes with contacts",
        ),
    ],
)
def test_what_cannot_be_pushed_together_is_a_clear_error(mesh, contacts, loads, said):
    with pytest.raises(SceneError, match=said):
        scene_of(mesh, loads, contacts=contacts)
