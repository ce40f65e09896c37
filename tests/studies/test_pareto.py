"""The Pareto front and the choice of a model are what their definitions say, whatever was measured."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fenics_rom.studies.method_configs import select_compared_instants
from fenics_rom.studies.pareto import pareto_front, select_cheapest, select_per_decade
from fenics_rom.studies.study_results import BenchmarkRow


def row(error, dt=1e-3, rate=1e5, order=10, method="balanced"):
    return BenchmarkRow(method, order, dt, error, error, {}, error, error, error, rate, 1.0, 1000, None, None, None)


ROWS = st.lists(
    st.builds(
        row,
        error=st.floats(1e-9, 0.5),
        dt=st.sampled_from([1e-3, 2e-3, 4e-3]),
        rate=st.floats(1e3, 1e6),
        order=st.integers(1, 80),
    ),
    min_size=1,
    max_size=30,
)


def beats(a, b):
    return a.real_time >= b.real_time and a.error <= b.error and (a.real_time, a.error) != (b.real_time, b.error)


@given(ROWS)
def test_front_is_what_nothing_beats(rows):
    front = pareto_front(rows)
    for one in rows:
        unbeaten = not any(beats(other, one) for other in rows)
        assert ((one.real_time, one.error) in {(f.real_time, f.error) for f in front}) == unbeaten
    assert [f.error for f in front] == sorted((f.error for f in front), reverse=True)


@given(ROWS, st.floats(1e-9, 0.5))
def test_chosen_row_is_within_and_no_step_has_a_lower_order_within(rows, tolerance):
    chosen = select_cheapest(rows, tolerance)
    within = [r for r in rows if r.error <= tolerance]
    if not within:
        assert chosen is None
        return
    assert chosen in within
    assert chosen.order == min(r.order for r in within if r.dt == chosen.dt)


@given(ROWS)
def test_decades_hold_and_end_where_nothing_reaches(rows):
    found = select_per_decade(rows)
    for tolerance, r in found:
        assert r.error <= tolerance
    assert found
    if min(r.error for r in rows) <= 0.1:
        assert select_cheapest(rows, found[-1][0] / 10) is None
    else:
        assert select_cheapest(rows, found[-1][0] - 0.1) is None


def test_longer_step_is_chosen_for_its_speed_not_the_lower_order():
    fast, small = row(5e-4, dt=4e-3, rate=2e5, order=20), row(5e-4, dt=1e-3, rate=4e5, order=5)
    assert select_cheapest([small, fast], 1e-3) is fast
    assert select_per_decade([small, fast]) == [(1e-3, fast)]


@given(
    st.integers(1, 5000),
    st.sampled_from([(1.0,), (4.0, 2.0, 1.0), (8.0, 4.0, 2.0, 1.0, 0.5, 0.25), (3.0, 2.0, 1.0)]),
    st.integers(4, 10**6),
)
def test_runs_of_all_steps_meet_at_every_shape(count, ratios, nodes):
    dt = 1e-3
    steps = tuple(ratio * dt for ratio in ratios)
    duration, shapes = select_compared_instants(count * 24 * dt, steps, nodes)
    for step in steps:
        assert (duration / step) / shapes == pytest.approx(round(duration / step / shapes), abs=1e-6)
    assert 0.5 < duration / (count * 24 * dt) <= 1 + 1e-9
    assert shapes * nodes * 24 <= 2.1e8 or shapes == 1
