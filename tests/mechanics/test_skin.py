"""How deep something is in a body: beside closed forms, and beside a dense search that knows nothing of the method."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces

from fenics_rom.errors import FenicsRomWarning, StepError
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.mechanics.skin import UNTOUCHED, MovedIntruder, Skin
from fenics_rom.mechanics.skin_path import Instant, Placement
from fenics_rom.mechanics.skin_watch import FIRST_LOOK, LOOK_INTERVAL, SkinWatch
from fenics_rom.world import shapes

LENGTHS = np.array([1.0, 0.4, 0.3])
BRICKS = (10, 4, 3)  # of 0.1 m
SPACING = 0.1 / np.sqrt(2)  # from the middle of the longest sides
POINTS, CELLS = box_arrays(tuple(LENGTHS), BRICKS)
FACES = box_surfaces(POINTS, CELLS)


def outward(triangles):
    corners = POINTS[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = ((corners.mean(axis=1) - LENGTHS / 2) * normals).sum(axis=1) < 0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def skin(covered=("bottom",), held=("left",)):
    movable = np.ones(len(POINTS), dtype=bool)
    for name in held:
        movable[FACES[name]] = False
    surfaces = {name: np.unique(FACES[name]) for name in covered}
    return Skin(POINTS, outward(np.concatenate(list(FACES.values()))), surfaces, movable)


BODY = skin()


def found(intruder, body=BODY, **more):
    return {part: (depth, place) for depth, place, part, _ in body.intrusions(body.coordinates, intruder, **more)}


def test_spacing_is_the_farthest_a_place_is_from_the_nodes():
    np.testing.assert_allclose(BODY.spacing, SPACING, rtol=1e-12)


@pytest.mark.parametrize(
    ("intruder", "depth", "place"),
    [
        (HalfSpace((0, 0, 0.18), (0, 0, -1)), 0.12, None),
        (Sphere((0.53, 0.21, 0.4), 0.16), 0.06, (0.53, 0.21, 0.3)),  # over no node
        (Sphere((0.53, 0.21, 0.27), 0.16), 0.19, (0.53, 0.21, 0.3)),  # its centre is inside
        (Sphere((0.53, 0.21, 0.22), 0.02), 0.10, (0.53, 0.21, 0.3)),  # all of it, between nodes
        (Capsule((0.53, -1, 0.38), (0.53, 1, 0.38), 0.11), 0.03, None),
        (Capsule((0.53, 0.21, 0.25), (0.53, 0.21, 0.8), 0.02), 0.07, (0.53, 0.21, 0.3)),  # stuck in
        (Box((0.53, 0.21, 0.4), (0.3, 0.2, 0.26)), 0.03, None),
        (Box((0.53, 0.21, 0.3), (0.005, 2.0, 2.0)), 0.0025, None),  # a blade that cuts it in two
        (Box((0.53, 0.21, 0.3), (0.3, 0.2, 0.01), (0.0, np.pi / 2, 0.0)), 0.12, None),  # edgewise, half way in
    ],
)
def test_depth_is_that_of_the_closed_form(intruder, depth, place):
    told = found(intruder)[UNTOUCHED]
    assert told[0] == pytest.approx(depth, rel=1e-6)
    if place is not None:
        np.testing.assert_allclose(told[1], place, atol=1e-9)


def test_what_is_displaced_is_where_it_was_moved_to():
    offset = np.array([0.2, -0.1, 0.05])
    there, moved = Sphere((0.53, 0.21, 0.27), 0.16), MovedIntruder(Sphere((0.33, 0.31, 0.22), 0.16), offset)
    assert found(moved)[UNTOUCHED][0] == pytest.approx(found(there)[UNTOUCHED][0], rel=1e-12)


def test_what_touches_or_is_kept_out_is_not_told():
    assert not found(HalfSpace((0, 0, 0.3), (0, 0, -1)))
    assert not found(HalfSpace((0, 0, 0.3 - 0.09 * SPACING), (0, 0, -1)))  # as deep as a coarse mesh explains
    assert not found(Sphere((0.53, 0.21, -0.15), 0.16))  # between contact points, no deeper than these are apart
    assert not found(HalfSpace((0.01, 0, 0), (1, 0, 0)))  # where it is held, at the left
    assert not found(Sphere((0.5, 0.2, 2.0), 0.5))


def test_what_comes_through_between_contact_points_is_told_by_their_name():
    assert list(found(Sphere((0.55, 0.23, 0.03), 0.02))) == ["bottom"]
    assert not found(HalfSpace((0, 0, 0.06), (0, 0, 1)), skin(tuple(FACES)))
    assert set(found(HalfSpace((0, 0, 0.08), (0, 0, 1)), skin(tuple(FACES)))) <= set(FACES)
    assert found(HalfSpace((0, 0, 0.08), (0, 0, 1)), skin(tuple(FACES)))


def test_springs_let_all_of_the_skin_as_deep_as_contact_points_are():
    pressed = HalfSpace((0, 0, 0.06), (0, 0, 1))
    assert UNTOUCHED not in found(pressed, springs=True)
    assert found(pressed)  # by nothing but round-off are they as deep with the rigid law


def test_depth_is_what_a_dense_search_finds_of_any_shape_anywhere():
    """Never more, and to 0.15 of the spacing no less, of shapes that hold no ball inside of the body."""
    random = np.random.default_rng(1)
    body, none = skin(covered=(), held=()), 0
    n = 24
    weights = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]) / n
    places = (weights @ body.coordinates[body.triangles]).reshape(-1, 3)
    for _ in range(60):
        at, turn, size = random.uniform(-0.1, LENGTHS + 0.1), random.standard_normal(3), random.uniform(0.05, 0.3)
        for shape in (
            Sphere(at, size),
            Capsule(at, at + 0.3 * turn, size / 2),
            Box(at, random.uniform(0.1, 0.5, 3), turn),
        ):
            if body.contain(body.coordinates, shape.core[1]).any():
                continue
            dense = -shape.distance(places)[0].min()
            told = found(shape, body).get(UNTOUCHED)
            if told is None:
                none += 1
                assert dense <= 0.25 * SPACING
            else:
                assert dense - 0.15 * SPACING <= told[0] <= dense + SPACING / n
    assert none > 10


def test_points_are_inside_where_the_box_is():
    points = np.random.default_rng(0).uniform(-0.2, LENGTHS + 0.2, (200, 3))
    np.testing.assert_array_equal(
        BODY.contain(BODY.coordinates, points), ((points > 0) & (points < LENGTHS)).all(axis=1)
    )


@pytest.mark.parametrize(
    "shape",
    [
        HalfSpace((0, 0, 0), (0, 0, 1)),
        Sphere((1, 2, 3), 0.2),
        Capsule((1, 2, 3), (2, 1, 0), 0.2),
        Box((1, 2, 3), (0.3, 0.5, 0.2), (0.3, 1.0, -0.4)),
        shapes.HalfSpace(),
        shapes.Sphere(0.2),
        shapes.Capsule(0.2, 0.5),
        shapes.Cylinder(0.2, 0.5),
        shapes.Cylinder(0.4, 0.1),
        shapes.Box((0.3, 0.5, 0.2)),
        shapes.Hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]),
    ],
    ids=str,
)
def test_a_shape_holds_the_balls_of_its_core(shape):
    radius, centres = shape.core
    assert radius > 0
    assert np.isinf(radius) == (not len(centres))
    if len(centres):
        assert shape.distance(centres)[0].max() <= -radius * (1 - 1e-12)


def placed(places):
    return Placement(places[BODY.few_rows], lambda: places)


def look(watch, step, height):
    places = watch.skin.coordinates
    ball = {"obstacle 'ball'": MovedIntruder(Sphere((0.53, 0.21, height), 0.16), np.zeros(3))}
    watch.look(step, 0.1 * step, Instant(placed(places), ball), None)


def test_what_goes_in_deeper_is_told_once_and_kept():
    watch = SkinWatch(skin())
    look(watch, 0, 0.5)
    with pytest.warns(FenicsRomWarning, match=r"'ball' is 60 mm inside the body at \[0.53, 0.21, 0.3\] m.* bottom"):
        look(watch, 1, 0.40)
    look(watch, 2, 0.42)  # no more warnings, which would be errors here
    look(watch, 3, 0.39)
    (message,) = watch.messages
    assert "was up to 70 mm inside the body" in message
    assert "from t = 0.1 s on" in message
    watch.begin((), 0)
    assert not watch.messages


def test_looks_are_near_one_another_at_first_and_then_every_so_many_steps():
    watch, looks = SkinWatch(skin()), []
    for step in range(500):
        if step >= watch.next_look:
            looks.append(step)
            watch.look(step, 0.0, Instant(placed(BODY.coordinates), {}), None)
    assert looks[:4] == [FIRST_LOOK, 2 * FIRST_LOOK, 4 * FIRST_LOOK, 8 * FIRST_LOOK]
    assert set(np.diff(looks[4:])) == {LOOK_INTERVAL}


def test_what_stands_still_is_looked_at_in_few_places_only():
    watch, asked = SkinWatch(skin()), []
    places = watch.skin.coordinates
    for height in (0.47, 0.47, 0.4699, 0.48):
        ball = {"ball": MovedIntruder(Sphere((0.53, 0.21, height), 0.16), np.zeros(3))}
        body = Placement(places[watch.skin.few_rows], lambda h=height: asked.append(h) or places)
        watch.look(0, 0.0, Instant(body, ball), None)
    assert asked == [0.47, 0.48]


def test_what_went_through_between_two_looks_is_told_where_it_was():
    """A small ball from far above the box to far below, in one stride."""
    watch, ball = SkinWatch(skin()), Sphere((0.53, 0.21, 0.0), 0.02)
    at = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    above, below = (Instant(placed(BODY.coordinates), {"ball": MovedIntruder(ball, each)}) for each in at)
    watch.look(8, 0.0, above, None)
    with pytest.warns(FenicsRomWarning, match="ball is"):
        watch.look(9, 0.1, below, above)


def test_what_is_far_from_all_nodes_but_inside_is_looked_at():
    few = BODY.coordinates[BODY.few_rows]
    for shape, may in ((Sphere((0.5, 0.2, 0.15), 0.01), True), (Sphere((0.5, 0.2, 1.5), 0.01), False)):
        assert BODY.may_meet(few, np.full(len(few), 10.0), shape) == may


def test_a_start_inside_is_refused():
    watch = SkinWatch(skin())
    with pytest.raises(StepError, match=r"'wall' is 0\.12 m inside the body at .* name this surface .* bottom"):
        watch.check_start(BODY.coordinates, {"obstacle 'wall'": HalfSpace((0, 0, 0.18), (0, 0, -1))})
    watch.check_start(BODY.coordinates, {"obstacle 'wall'": HalfSpace((0, 0, 0.3), (0, 0, -1))})


def test_what_is_left_out_is_not_told():
    body = skin()
    block = Box((1.0, 0.2, 0.15), (0.1, 0.6, 0.6))  # around the right end
    assert found(block, body)
    body.leave_out(block.distance(body.coordinates)[0])
    assert not found(block, body)
    assert found(Sphere((0.3, 0.2, 0.4), 0.16), body)
