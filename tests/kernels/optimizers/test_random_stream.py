"""The random stream against SplitMix64 in Python integers, and its evenness."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.kernels.optimizers.memory import draw_below
from support import references
from support.cases import every


def test_the_twin_gives_the_published_words() -> None:
    """The reference implementation's first words for the seed 1234567."""
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    assert [references.splitmix64(1234567, i) for i in range(4)] == published


@settings(deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**63 - 1), position=st.integers(0, 2**63 - 1), bound=st.integers(1, 2**31 - 1))
def test_draws_equal_the_twin(seed: int, position: int, bound: int) -> None:
    drawn = draw_below(seed, position, bound)
    assert drawn == references.draw_below(seed, position, bound)
    assert 0 <= drawn < bound


@every("bound", [2, 3, 10, 97])
@every("seed", [0, 1, 2**63 - 1])
def test_draws_are_uniform_and_independent_of_the_one_before(seed: int, bound: int) -> None:
    """Pearson's chi-square of single draws and of pairs stays within eight standard deviations of its mean.

    With f degrees of freedom its mean is f and its standard deviation sqrt(2 f).
    """
    count = max(2_000, 10 * bound**2)
    draws = np.array([draw_below(seed, i, bound) for i in range(count)])
    pairs = draws[:-1] * bound + draws[1:]
    for values, cells in ((draws, bound), (pairs, bound**2)):
        expected = values.size / cells
        chi_square = float(((np.bincount(values, minlength=cells) - expected) ** 2).sum() / expected)
        assert chi_square < cells - 1 + 8 * np.sqrt(2 * (cells - 1))
