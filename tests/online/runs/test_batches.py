"""However a record comes, it is cut into the same batches."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as some

from replant.online.runs.run import Arrays, batched


@given(some.lists(some.integers(0, 30), max_size=12), some.integers(1, 25))
def test_batches_are_of_one_size_and_lose_nothing(lengths: list[int], size: int) -> None:
    u = np.arange(float(sum(lengths)))
    ends = np.cumsum([0, *lengths])
    parts = [(u[begin:end], -u[begin:end]) for begin, end in pairwise(ends)]
    found = list(batched(parts, size))
    np.testing.assert_array_equal(np.concatenate([u for u, _ in found]), u)
    np.testing.assert_array_equal(np.concatenate([y for _, y in found]), -u)
    assert all(part.size == size for part, _ in found[:-1])
    assert found[-1][0].size in (range(1, size + 1) if u.size else (0,))


def test_arrays_are_a_source() -> None:
    source = Arrays(np.arange(5.0), np.ones(5))
    assert source.samples == 5
    assert [u.size for u, _ in source.batches()] == [5]
    assert [u.size for u, _ in source.batches()] == [5]  # and can be gone through again
