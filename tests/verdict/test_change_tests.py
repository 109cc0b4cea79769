"""The power of a residual over its newest block, beside that of the blocks before."""

from __future__ import annotations

import numpy as np

from replant.verdict.sensor_and_excitation import _powers
from support.cases import every


@every("count", [5, 20, 32])
@every("offset", [0.0, -40.0])
def test_powers_are_those_of_whole_blocks_that_end_with_the_record(count: int, offset: float) -> None:
    """About the median of the whole; what is left over lies at the beginning, and counts in no block."""
    error = np.random.default_rng(0).standard_normal(203) * np.linspace(1.0, 3.0, 203)
    about = error - np.median(error)
    powers = [float(np.mean(np.square(about[end - count : end]))) for end in range(203, count - 1, -count)]
    last, largest, usual = _powers(error + offset, count)
    np.testing.assert_allclose(last, powers[0], rtol=1e-9)
    np.testing.assert_allclose(largest, max(powers[1:]), rtol=1e-9)
    np.testing.assert_allclose(usual, np.median(powers), rtol=1e-9)


def test_an_offset_that_stays_is_no_power() -> None:
    assert _powers(np.full(100, 7.0), 10) == (0.0, 0.0, 0.0)
