"""The movement of a record, computed in batches, equals NumPy's on the whole record."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replant.fleet.worker import movement_of
from support.cases import every

SAMPLES = 60


@dataclass
class Parts:
    """A recording that comes in parts that end at ``ends``."""

    u: np.ndarray
    y: np.ndarray
    ends: list[int]
    held: None = None

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for begin, end in zip([0, *self.ends], [*self.ends, self.u.size], strict=True):
            yield self.u[begin:end], self.y[begin:end]


def longest_stretch(y: np.ndarray) -> int:
    longest = now = 0
    for k in range(y.size):
        now = now + 1 if k and y[k] == y[k - 1] else 1
        longest = max(longest, now)
    return longest


@every("ends", [[], [1], [30], [1, 2, 3], [10, 10, 40], [7, 21, 22, 59]], ids=str)
@every("seed", range(12))
def test_it_is_that_of_the_whole_record(ends: list[int], seed: int) -> None:
    """Signals far from zero, some samples missing, the output in steps that last a while."""
    generator = np.random.default_rng(seed)
    u = 1e3 + generator.standard_normal(SAMPLES)
    y = 5.0 * (seed % 3) + np.repeat(generator.integers(0, 3, SAMPLES), generator.integers(1, 9, SAMPLES))[:SAMPLES]
    u[generator.random(SAMPLES) < 0.1] = math.nan
    y[generator.random(SAMPLES) < 0.05 * (seed % 2)] = math.nan
    input_stds, output_std, output_held = movement_of(Parts(u, y, ends))
    np.testing.assert_allclose(input_stds, [np.nanstd(u)], rtol=1e-9)
    np.testing.assert_allclose(output_std, np.nanstd(y), rtol=1e-12)
    assert output_held == longest_stretch(y) / SAMPLES


@every("ends", [[], [20], [1, 59]], ids=str)
@every("value", [0.0, 4.0])
def test_a_constant_stands_still_throughout_and_does_not_move(ends: list[int], value: float) -> None:
    signal = np.full(SAMPLES, value)
    assert movement_of(Parts(signal, signal, ends)) == ([0.0], 0.0, 1.0)


def test_without_a_sample_nothing_is_known() -> None:
    nothing = np.zeros(0)
    input_stds, *of_output = movement_of(Parts(nothing, nothing, []))
    assert all(math.isnan(value) for value in (*input_stds, *of_output))
    missing = np.full(SAMPLES, math.nan)
    input_stds, _, output_held = movement_of(Parts(missing, missing, [9]))
    assert np.isnan(input_stds).all()
    assert output_held == 1 / SAMPLES
