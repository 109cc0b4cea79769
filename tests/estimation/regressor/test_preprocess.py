"""Preprocess: input map, working point, and which samples may pass."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.model.preprocess import screen
from support.cases import every

U, Y = np.random.default_rng(0).normal(3.0, 1.0, (2, 100))


def test_the_maps_do_what_they_say() -> None:
    np.testing.assert_array_equal(rp.Preprocess().map_input(U), U)
    np.testing.assert_array_equal(rp.Preprocess("square").map_input(U), U**2)
    np.testing.assert_array_equal(rp.Preprocess(np.tanh).map_input(U), np.tanh(U))


@pytest.mark.parametrize("input_map", ["identity", "square", np.cbrt])
def test_the_working_point_is_taken_after_the_map(input_map: Any) -> None:
    mapped = rp.Preprocess(input_map).map_input(U)
    first = rp.Preprocess(input_map, "first", "first").resolve(U, Y)
    mean = rp.Preprocess(input_map, "mean", "mean").resolve(U, Y)
    mixed = rp.Preprocess(input_map, "first", 2.5).resolve(U, Y)
    assert (first.input_offset, first.output_offset) == (mapped[0], Y[0])
    assert mean.input_offset == pytest.approx(mapped.mean(), rel=1e-14)
    assert mean.output_offset == pytest.approx(Y.mean(), rel=1e-14)
    assert (mixed.input_offset, mixed.output_offset) == (mapped[0], 2.5)
    assert first.needs == mean.needs == mixed.needs == "nothing"
    assert first.input_map is input_map


@every(("bad_u", "bad_y"), [(np.nan, 1.0), (1.0, np.inf), (1e308, 1.0), (1.0, -1e308)])
@every("word", ["first", "mean"])
@every("input_map", ["identity", "square"])
def test_a_rejected_sample_has_no_part_in_the_working_point(
    bad_u: float, bad_y: float, word: str, input_map: str
) -> None:
    u, y = np.concatenate([[bad_u], U, [bad_u]]), np.concatenate([[bad_y], Y, [bad_y]])
    preprocess = rp.Preprocess(input_map, word, word)
    assert preprocess.resolve(u, y) == preprocess.resolve(U, Y)


@every("word", ["first", "mean"])
@every("record", [([], []), ([np.nan], [1.0]), ([1e200], [1.0])], ids=repr)
def test_a_working_point_needs_a_sample(word: str, record: tuple[list[float], list[float]]) -> None:
    with pytest.raises(rp.InvalidArgumentError, match="working point"):
        rp.Preprocess(output_offset=word).resolve(*map(np.array, record))


@every(
    ("offsets", "needs"),
    [
        ((0.0, 1.0), "nothing"),
        (("first", 0.0), "first"),
        ((0.0, "mean"), "mean"),
        (("first", "mean"), "mean"),
    ],
)
def test_what_must_be_known_first(offsets: tuple[Any, Any], needs: str) -> None:
    assert rp.Preprocess("identity", *offsets).needs == needs


def test_samples_are_screened_and_counted_by_reason() -> None:
    u = np.array([1.0, np.nan, 1.0, 1e308, np.inf, 1e150, 1.0])
    y = np.array([1.0, 1.0, -np.inf, 1.0, 1e308, -1e150, -1.1e150])
    accepted, rejected = screen(u, y)
    np.testing.assert_array_equal(accepted, [True, False, False, False, False, True, False])
    assert rejected == {"not finite": 3, "too large": 2}


@every(
    ("arguments", "named"),
    [
        ({"input_map": "cube"}, "input_map"),
        ({"input_map": None}, "input_map"),
        ({"input_map": 2}, "input_map"),
        ({"input_offset": "last"}, "input_offset"),
        ({"input_offset": None}, "input_offset"),
        ({"input_offset": math.nan}, "input_offset"),
        ({"input_offset": 1j}, "input_offset"),
        ({"output_offset": math.inf}, "output_offset"),
        ({"output_offset": [1.0]}, "output_offset"),
    ],
    ids=repr,
)
def test_a_bad_preprocess_is_refused_by_name(arguments: dict[str, Any], named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named) as caught:
        rp.Preprocess(**arguments)
    assert "\n" not in str(caught.value)


@every(
    "bad_map",
    [lambda v: v[:-1], lambda v: 1.0, lambda v: v[:, None], lambda v: None, lambda v: "a", lambda v: v * 1j],
)
def test_a_map_that_does_not_keep_to_its_contract_is_refused(bad_map: Any) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match="input_map") as caught:
        rp.Preprocess(bad_map).map_input(U)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("value", "why"), [(np.nan, "2 not finite"), (1e200, "2 too large")])
def test_a_working_point_without_a_sample_says_what_they_are(value: float, why: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=f"at least one usable sample: {why}"):
        rp.Preprocess(output_offset="mean").resolve(np.ones(2), np.full(2, value))
