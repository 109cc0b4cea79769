"""What a model leaves of the output, by which estimates of a record compete for their place."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.engine.record import Record
from replant.online.restart import EXPLAINED, left_by_input
from support.builders import G1, binary

DT, SAMPLES, TRUE = 0.05, 800, np.array([0.5, 1.25])


def left_of(noise: np.ndarray, *, certain: bool = True, seen: int = 0) -> tuple[float, bool]:
    u = binary(1, SAMPLES, 20)
    record = Record(u, G1.simulate(u, DT) + noise, np.array([DT]))
    return left_by_input(rp.Structure(1), TRUE, record, DT, seen, certain=certain)


def test_what_the_true_model_leaves_is_the_variance_of_the_noise() -> None:
    noise = 0.3 * np.random.default_rng(0).standard_normal(SAMPLES)
    left, explains = left_of(noise)
    assert left == pytest.approx(noise.var(), rel=0.02)  # the initial state may take a part
    assert explains
    noise[:100] += 5.0
    left, _ = left_of(noise, seen=100)
    assert left == pytest.approx(noise[100:].var(), rel=0.3)
    assert left_of(noise)[0] > 2.0 * left


def test_a_constant_that_is_left_is_none_of_its_faults() -> None:
    noise = 0.3 * np.random.default_rng(0).standard_normal(SAMPLES)
    assert left_of(noise + 3.0)[0] == pytest.approx(left_of(noise)[0], rel=0.3)


@pytest.mark.parametrize("certain", [True, False])
def test_an_input_that_explains_too_small_a_part_explains_nothing(certain: bool) -> None:
    """The noise is so large that the part is just below, or well above, the least that counts."""
    signal = G1.simulate(binary(1, SAMPLES, 20), DT).var()
    for part, expected in ((0.7 * EXPLAINED, False), (1.3 * EXPLAINED, True)):
        size = np.sqrt(signal * (1.0 - part) / part)
        noise = np.random.default_rng(2).standard_normal(SAMPLES)
        assert left_of(size * noise / noise.std(), certain=certain)[1] is expected, part
