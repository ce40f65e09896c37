"""Data like those of a silicone beam with a weight at its tip: intervals hold the truth; `beam_seeds.py` counts it."""

import pytest
from beam_seeds import NOISE, found, holding


@pytest.mark.slow
def test_a_beam_with_a_weight_is_told_by_its_first_fifth_of_a_second(tmp_path):
    sought = ["young", "density", "beta"]
    (result,) = found(tmp_path, [1], 0.2, sought)
    assert holding(result) == sought
    assert result.noise == pytest.approx(NOISE, rel=0.15)
