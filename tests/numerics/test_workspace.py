"""Memory of a temporary array is lent to one at a time, and given back where the work fails."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from replant.numerics.linear_algebra import KEPT, borrowed


def test_the_same_memory_is_lent_again_and_another_one_within() -> None:
    with borrowed(30, 4) as first, borrowed(30, 4) as within:
        assert first.shape == within.shape == (30, 4)
        assert not np.shares_memory(first, within)
    with borrowed(10, 3) as again:
        assert np.shares_memory(again, first) or np.shares_memory(again, within)


def test_memory_is_given_back_where_the_work_fails() -> None:
    with pytest.raises(ZeroDivisionError), borrowed(30, 4) as first:
        _ = 1 / 0
    with borrowed(30, 4) as again:
        assert np.shares_memory(first, again)


def test_each_thread_has_its_own() -> None:
    lent = []

    def lend() -> None:
        with borrowed(30, 4) as other:
            lent.append(other)

    with borrowed(30, 4):
        pass
    thread = threading.Thread(target=lend)
    thread.start()
    thread.join()
    with borrowed(30, 4) as mine:
        assert not np.shares_memory(mine, lent[0])


def test_memory_of_a_very_large_array_is_not_kept() -> None:
    with borrowed(KEPT + 1, 1) as large:
        pass
    with borrowed(30, 4) as small:
        assert not np.shares_memory(large, small)
