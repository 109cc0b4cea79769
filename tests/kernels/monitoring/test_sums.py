"""The sums of outputs and errors that a verdict without raw samples is made from."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.monitoring.scatter import follow
from replant.kernels.schema import Doubt, SumsSlots


def test_of_a_short_record_they_are_its_mean_its_variance_and_the_mean_square_of_its_errors() -> None:
    y, error = 5.0 + np.random.default_rng(0).standard_normal((2, 300))
    sums = SumsSlots.zeros({})
    for each in zip(y.tolist(), error.tolist(), strict=True):
        follow(sums, *each, Doubt.NONE, False)
    found = sums.count, sums.output_mean, sums.output_power, sums.error_power
    assert found == pytest.approx((300, y.mean(), y.var(), np.mean(error**2)), rel=1e-12)


def test_what_is_doubted_missing_or_at_rest_takes_no_part_and_missing_ones_are_counted() -> None:
    sums = SumsSlots.zeros({})
    follow(sums, 1.0, 2.0, Doubt.NONE, False)
    before = sums.reals.copy()
    for number in (1, 2):
        follow(sums, 9.0, 9.0, Doubt.MISSING, False)
        assert sums.missing == number
    follow(sums, 9.0, 9.0, Doubt.OUTLIER, False)
    follow(sums, 9.0, 9.0, Doubt.NONE, True)
    np.testing.assert_array_equal(sums.reals, before)
