"""The filters' normal distribution against scipy's."""

import numpy as np
from scipy.special import ndtr

from msp_range.filters.runs import normal_cdf


def test_the_cumulative_probability_is_scipys_far_into_both_tails() -> None:
    z = np.linspace(-37.0, 37.0, 4001).reshape(1, -1)
    np.testing.assert_allclose(normal_cdf(z), ndtr(z), rtol=1e-13)
    assert normal_cdf(np.array([-np.inf, np.inf])).tolist() == [0.0, 1.0]
