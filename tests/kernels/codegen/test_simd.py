"""Vectors beside NumPy: what a kernel makes of sixteen numbers at once, and lane by lane."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba import TypingError, njit

from replant.kernels.codegen.simd import (
    LANES,
    all_within,
    load,
    prefetch,
    vectors,
)
from replant.kernels.schema import LINE

generator = np.random.default_rng(5)
A, B = generator.standard_normal((2, 3, LANES))
A[0, 1], A[0, 2], A[1, 0], B[1, 0], A[2, 3] = np.nan, np.inf, -0.0, 0.0, -np.inf

#: Each works on floats and on vectors.
OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "sum": lambda a, b: a + b,
    "difference": lambda a, b: a - b,
    "product": lambda a, b: a * b,
    "quotient": lambda a, b: a / b,
    "negative": lambda a, b: -a,
    "larger": lambda a, b: max(a, b),
    "with a number on the left": lambda a, b: 2.0 / (1.0 + b) - (3.0 - b) * 0.1,
    "with a number on the right": lambda a, b: (a * 2.0 - 1.0) / 3.0 + 0.5,
    "larger than a number": lambda a, b: max(a, 0.25),
    "root": lambda a, b: math.sqrt(a * a + b * b),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_each_lane_gets_the_bits_of_a_float(name: str) -> None:
    operation = njit(error_model="numpy")(OPERATIONS[name])

    @njit(error_model="numpy")
    def of_vectors(a, b, result):  # type: ignore[no-untyped-def]
        a, b, result = vectors(a), vectors(b), vectors(result)
        for i in range(a.size):
            result[i] = operation(a[i], b[i])

    result = np.zeros_like(A)
    of_vectors(A, B, result)
    expected = np.array([[operation(a, b) for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)])
    np.testing.assert_array_equal(result, expected)
    np.testing.assert_array_equal(np.signbit(result)[~np.isnan(expected)], np.signbit(expected)[~np.isnan(expected)])


def test_a_sum_that_begins_as_a_number_becomes_a_vector() -> None:
    @njit
    def total(a, result):  # type: ignore[no-untyped-def]
        a, result, running = vectors(a), vectors(result), 0.0
        for i in range(a.size):
            running += a[i]
        result[0] = running if a.size > 0 else 1.0

    result = np.zeros((1, LANES))
    total(B, result)
    np.testing.assert_array_equal(result[0], B[0] + B[1] + B[2])
    total(B[:0], result)
    np.testing.assert_array_equal(result[0], np.ones(LANES))


def test_the_vectors_of_an_array_are_the_same_memory_row_by_row() -> None:
    @njit
    def copy_last_row(a):  # type: ignore[no-untyped-def]
        rows = vectors(a)
        rows[0][1:] = rows[a.shape[0] - 1][1:]
        return rows.shape, rows[1:].size

    array = np.arange(4.0 * 3 * LANES).reshape(4, 3, LANES)
    before = array.copy()
    assert copy_last_row(array) == ((4, 3), 9)
    np.testing.assert_array_equal(array[0, 1:], before[3, 1:])
    np.testing.assert_array_equal(array[0, 0], before[0, 0])
    np.testing.assert_array_equal(array[1:], before[1:])


@pytest.mark.parametrize("array", [np.zeros((LANES, 3)).T, np.zeros((3, LANES), np.float32)], ids=["order", "type"])
def test_only_contiguous_float64_can_be_seen_as_vectors(array: np.ndarray) -> None:
    with pytest.raises(TypingError):
        njit(lambda a: vectors(a).size)(array)


@pytest.mark.parametrize("lane", [0, LANES // 2, LANES - 1])
@pytest.mark.parametrize(
    ("value", "expected"), [(2.0, True), (-2.0, True), (-2.1, False), (np.inf, False), (np.nan, False)]
)
def test_every_lane_counts_for_all_within(lane: int, value: float, expected: bool) -> None:
    @njit
    def ask(a):  # type: ignore[no-untyped-def]
        return all_within(vectors(a)[0], 2.0)

    array = np.ones((1, LANES))
    array[0, lane] = value
    assert ask(array) == expected


def test_neighbours_in_a_row_are_loaded_in_their_order() -> None:
    @njit
    def take(a, row, column, result):  # type: ignore[no-untyped-def]
        vectors(result)[0] = load(a, row, column)

    array, result = np.arange(3.0 * (LANES + 5)).reshape(3, -1), np.zeros((1, LANES))
    for row, column in ((0, 0), (1, 3), (2, 5)):
        take(array, row, column, result)
        np.testing.assert_array_equal(result[0], array[row, column : column + LANES])


def test_prefetch_asks_for_every_line_of_an_element_and_changes_nothing() -> None:
    @njit
    def of_numbers(a):  # type: ignore[no-untyped-def]
        prefetch(a, 1, 2)

    @njit
    def of_vectors(a):  # type: ignore[no-untyped-def]
        prefetch(vectors(a), 1, 2)

    array = np.arange(12.0 * LANES).reshape(3, 4, LANES)
    before = array.copy()
    of_numbers(array[:, :, 0].copy())
    of_vectors(array)
    for ask, lines in ((of_numbers, 1), (of_vectors, 8 * LANES // LINE)):
        assert next(iter(ask.inspect_llvm().values())).count("call void @llvm.prefetch") == lines
    np.testing.assert_array_equal(array, before)
