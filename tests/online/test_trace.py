"""Trace: the estimate before each sample, the index J of (21), and joined chunks."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from support.builders import G1, identifier, record
from support.cases import every

U, Y = record(G1, seed=1, samples=60, dt=0.05, noise=0.1)


def test_the_estimate_before_each_sample_is_the_one_after_the_last() -> None:
    ident = identifier()
    expected = []
    for u, y in zip(U, Y, strict=True):
        expected.append(ident.parameters)
        ident.update(u, y)
    trace = identifier().update_many(U, Y)
    np.testing.assert_array_equal(trace.before(), expected)


def test_the_index_is_the_sum_of_squared_distances_held_before_each_sample() -> None:
    trace = identifier().update_many(U, Y)
    true = np.array([0.1, 0.2, 0.3, 0.4])
    held = [trace.start, *trace.parameters[:-1]]
    expected = sum((estimate - true) ** 2 for estimate in held)
    np.testing.assert_allclose(trace.index(true), expected, rtol=1e-12)
    np.testing.assert_allclose(trace.index(np.tile(true, (60, 1))), expected, rtol=1e-12)


def test_the_index_follows_a_plant_that_changes() -> None:
    trace = rp.Trace(("a0",), np.zeros(1), np.array([[1.0], [2.0]]), np.zeros(2))
    np.testing.assert_array_equal(trace.index([[3.0], [5.0]]), [(0 - 3.0) ** 2 + (1 - 5.0) ** 2])


@every("twin", [copy.copy, copy.deepcopy, replace, lambda trace: pickle.loads(pickle.dumps(trace))])
def test_a_trace_of_a_start_up_is_copied_with_its_estimates(twin: Callable[[rp.Trace], rp.Trace]) -> None:
    whole, ident = (rp.Identifier(poles=1, dt=0.05, startup=40) for _ in range(2))
    trace, other = whole.update_many(U, Y), twin(ident.update_many(U, Y))
    assert trace.parameters[:39].any()
    for name in ("names", "start", "parameters", "errors"):
        np.testing.assert_array_equal(getattr(other, name), getattr(trace, name))
    assert repr(other) == repr(trace)


@every("cut", [0, 1, 25, 60])
def test_joined_chunks_are_the_whole(cut: int) -> None:
    whole, ident = identifier().update_many(U, Y), identifier()
    joined = ident.update_many(U[:cut], Y[:cut]) + ident.update_many(U[cut:], Y[cut:])
    assert len(joined) == len(whole) == 60
    for name in ("start", "parameters", "errors"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    np.testing.assert_array_equal(joined.before(), whole.before())
    np.testing.assert_array_equal(joined.index(np.ones(4)), whole.index(np.ones(4)))


def test_indices_of_chunks_add_up_also_over_an_empty_one() -> None:
    ident, true = identifier(), np.ones(4)
    chunks = [ident.update_many(U[a:b], Y[a:b]) for a, b in ((0, 20), (20, 20), (20, 60))]
    assert chunks[1].before().shape == (0, 4)
    np.testing.assert_allclose(
        sum(chunk.index(true) for chunk in chunks), identifier().update_many(U, Y).index(true), rtol=1e-12
    )


@every(
    ("true", "error", "message"),
    [
        *((true, rp.InvalidArgumentError, "true must have shape")
          for true in ([1.0], [1.0] * 5, 1.0, np.ones((3, 4)), np.ones((60, 3)))),
        *((true, rp.ArgumentTypeError, "true") for true in ("abcd", None, [None] * 4, np.ones(4) * 1j)),
    ],
)  # fmt: skip
def test_true_parameters_of_a_wrong_shape_or_kind_are_refused(true: object, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        identifier().update_many(U, Y).index(true)


def test_traces_of_different_parameters_do_not_join() -> None:
    one, two = identifier(structure=rp.Structure(1)), identifier()
    with pytest.raises(rp.InvalidArgumentError, match="different parameters"):
        one.update_many(U, Y) + two.update_many(U, Y)
