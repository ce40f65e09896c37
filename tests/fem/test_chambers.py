"""The walls of chambers: of bricks that are cut out of a box, by what encloses them."""

import numpy as np
import pytest
from bodies import box_arrays

from fenics_rom.fem.chambers import FLAT, inner_facets

BRICKS = (12, 6, 6)


def cut(*holes, bricks=BRICKS):
    """A box of bricks of edge 1 without those in holes, each from one corner to another: points, and outward facets."""
    points, cells = box_arrays(bricks, bricks)
    middles = points[cells].mean(axis=1)
    for low, high in holes:
        cells, middles = (part[~((middles > low) & (middles < high)).all(axis=1)] for part in (cells, middles))
    faces, opposite = cells[:, [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]].reshape(-1, 3), cells.ravel()
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer = first[count == 1]
    facets = faces[outer]
    a, b, c = points[facets].swapaxes(0, 1)
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), points[opposite[outer]] - a) > 0
    facets[inward] = facets[inward][:, ::-1]
    return points, facets


def area(points, facets):
    a, b, c = points[facets].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


CHAMBER = ((2, 1, 1), (10, 5, 5))  # 8 x 4 x 4
INLET = ((-1, 2, 2), (2, 4, 4))  # 2 x 2 x 2
LUMEN = ((-1, 2, 2), (13, 4, 4))
CASES = {  # holes, area of the walls of chambers
    "solid": ((), 0),
    "closed": ((CHAMBER,), 160),
    "with an inlet, whose walls count": ((CHAMBER, INLET), 160 - 4 + 16),
    "with inlets from both sides": ((CHAMBER, INLET, ((10, 2, 2), (13, 4, 4))), 160 - 8 + 32),
    "open at one end": ((((-1, 2, 2), (8, 4, 4)),), 68),
    "from end to end": ((LUMEN,), 96),
    "two that touch along an edge": ((((2, 2, 2), (4, 4, 4)), ((4, 4, 2), (6, 5, 4))), 24 + 16),
    "three behind one another, with a channel, and slots between them": (
        (
            *(((k, 1, 1), (k + 2, 5, 5)) for k in (1, 6, 11)),
            ((-1, 2, 1), (11, 4, 2)),
            *(((k, -1, 3), (k + 1, 7, 7)) for k in (4, 9)),
        ),
        3 * 64 - 5 * 2 + 6 * 7,
    ),
    "a dimple is none": ((((4, 2, 5), (8, 4, 7)),), 0),
    "a slot is none": ((((4, -1, 1), (5, 7, 7)),), 0),
    "a groove is none": ((((-1, 2, 5), (13, 3, 7)),), 0),
}


@pytest.mark.parametrize(("holes", "walls"), CASES.values(), ids=CASES)
@pytest.mark.parametrize("turned", [False, True])
def test_walls_of_chambers_are_found_by_their_area(holes, walls, turned):
    points, facets = cut(*holes, bricks=(14, 6, 6) if len(holes) > 3 else BRICKS)
    if turned:
        points = points @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    inner, _ = inner_facets(points, facets)
    assert area(points, facets[inner]) == pytest.approx(walls, rel=1e-12)


def test_what_walls_see_is_openings_by_walls():
    """Of a box of 2 x 2 x L that is open at one end: 4/(4 + 8 L); at both 8/8 L."""
    for length, is_chamber in ((1, False), (2, True), (6, True)):
        points, facets = cut(((-1, 2, 2), (length, 4, 4)))
        inner, (hollow,) = inner_facets(points, facets)
        assert hollow.open_share == pytest.approx(4 / (4 + 8 * length), rel=1e-12)
        assert inner.any() == is_chamber
        assert len(hollow.facets) == 2 * (4 + 8 * length)
        assert inner_facets(points, facets)[1][0].middle[0] < length
    _, (through,) = inner_facets(*cut(LUMEN))
    assert through.open_share == pytest.approx(8 / (8 * BRICKS[0]), rel=1e-12)


def test_a_round_chamber_has_its_flat_ends_and_its_inlet():
    """Squares about the middle line become circles: a cylinder with 24 sides, a chamber with 16, an inlet with 8."""
    points, facets = cut(CHAMBER, INLET)
    a, b = (points[:, 1:] - 3).T
    ring, is_wide = np.maximum(np.abs(a), np.abs(b)), np.abs(a) >= np.abs(b)
    slope = np.where(is_wide, b, -a) / np.where(ring > 0, np.where(is_wide, a, b), 1)
    angle = np.pi / 4 * slope + np.where(is_wide, np.pi * (a < 0), np.pi / 2 * np.sign(b))
    points = np.column_stack([points[:, 0], ring * np.cos(angle), ring * np.sin(angle)])

    def around(sides, radius):
        return 2 * sides * radius * np.sin(np.pi / sides)

    def within(sides, radius):
        return sides / 2 * radius**2 * np.sin(2 * np.pi / sides)

    walls = 8 * around(16, 2) + 2 * within(16, 2) - within(8, 1) + 2 * around(8, 1)
    inner, hollows = inner_facets(points, facets)
    assert len(hollows) == 1
    assert hollows[0].open_share == pytest.approx(within(8, 1) / walls, rel=1e-12)
    assert area(points, facets[inner]) == pytest.approx(walls, rel=1e-12)


def test_a_rim_may_be_round_and_a_mouth_may_be_in_a_bent_side():
    """A box bent to an arc: its sides are smooth, not flat; and a rim that is drawn out, so that it is not sharp."""
    points, facets = cut(CHAMBER, ((5, 2, -1), (7, 4, 1)), bricks=(24, 6, 6))
    walls = inner_facets(points, facets)[0]
    assert area(points, facets[walls]) == pytest.approx(160 - 4 + 8, rel=1e-12)
    angle, radius = points[:, 0] / 12, 20 + points[:, 2]
    assert FLAT < 1 / 12
    bent = np.column_stack([radius * np.sin(angle), points[:, 1], radius * np.cos(angle)])
    np.testing.assert_array_equal(inner_facets(bent, facets)[0], walls)

    points, facets = cut(((-1, 2, 2), (8, 4, 4)))
    on_rim = (points[:, 0] == 0) & (np.abs(points[:, 1:] - 3).max(axis=1) == 1)
    points[on_rim, 1:] += 0.4 * (points[on_rim, 1:] - 3)  # the mouth is wider, the walls are slanted there
    beside = (points[:, 0] == 1) & (np.abs(points[:, 1:] - 3).max(axis=1) == 1)
    points[beside, 1:] += 0.1 * (points[beside, 1:] - 3)
    inner, (hollow,) = inner_facets(points, facets)
    assert inner.sum() == 2 * 68
    assert hollow.open_share < 4 * 1.4**2 / 68
