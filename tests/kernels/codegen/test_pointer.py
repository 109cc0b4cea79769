"""Pointers: the number that an index names, of an array or behind a pointer; vectors at any float64."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from replant.kernels.codegen.decorators import cold, inline_llvm, inline_source, kernel, outlined
from replant.kernels.codegen.pointer import pointer
from replant.kernels.codegen.simd import LANES, vectors


@kernel
def exchange(array, start, further):
    """Add two numbers, and leave the sum where the second was."""
    first = pointer(array, start)
    second = pointer(first, further)
    second[0] += first[0]
    return first[further]


@kernel
def add_vectors(array, start):
    both = pointer(vectors(array), start)
    both[1] += both[0]
    return both.size


@kernel
def point_into_a_matrix(matrix):
    return pointer(matrix, 0)[0]


@pytest.mark.parametrize("kind", [np.float64, np.int64])
def test_a_pointer_begins_where_it_says(kind: type) -> None:
    array = np.arange(10, dtype=kind)
    assert exchange(array, 2, 3) == 7
    assert exchange(array, 5, -4) == 8, "a pointer counts on beyond its beginning, not from the end"
    np.testing.assert_array_equal(array, [0, 8, 2, 3, 4, 7, 6, 7, 8, 9])


@pytest.mark.parametrize("offset", range(LANES))
def test_vectors_may_lie_at_any_number(offset: int) -> None:
    memory = np.arange(4.0 * LANES + offset)
    array = memory[offset:].reshape(4, LANES)
    expected = array.copy()
    expected[2] += expected[1]
    assert add_vectors(array, 1) == 3
    np.testing.assert_array_equal(array, expected)


def test_a_matrix_has_rows_not_numbers() -> None:
    with pytest.raises(TypingError):
        point_into_a_matrix(np.eye(2))


def say_nothing() -> None:
    """Stand for any kernel."""


def test_inline_llvm_alone_is_forced_into_its_caller() -> None:
    assert inline_llvm(say_nothing).targetoptions["forceinline"] is True
    for how in (kernel, inline_source, outlined, cold):
        assert how(say_nothing).targetoptions["forceinline"] is False, "it would be inherited from the first caller"
