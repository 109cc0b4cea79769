"""Test signals have the properties for which they are used."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant import signals
from support.cases import every


@every("bits", range(2, 16))
def test_a_prbs_runs_through_every_state_once(bits: int) -> None:
    """Its period is 2^n - 1: every word of n successive values occurs exactly once, except one (all equal)."""
    period = 2**bits - 1
    u = signals.prbs(period + bits - 1, bits=bits)
    assert set(u) == {-1.0, 1.0}
    words = np.lib.stride_tricks.sliding_window_view(u > 0, bits) @ (1 << np.arange(bits))
    assert words.size == period
    assert np.unique(words).size == period
    np.testing.assert_array_equal(signals.prbs(2 * period, bits=bits)[period:], u[:period])


@pytest.mark.parametrize("bits", [3, 7, 10])
def test_a_prbs_is_as_white_as_a_binary_signal_can_be(bits: int) -> None:
    """Its circular autocorrelation is 2^n - 1 at lag zero and -1 at every other lag."""
    period = 2**bits - 1
    spectrum = np.fft.fft(signals.prbs(period, bits=bits))
    correlation = np.fft.ifft(abs(spectrum) ** 2).real
    np.testing.assert_allclose(correlation, [period] + [-1] * (period - 1), atol=1e-8 * period)


@every("seed", [1, 5, 126, 127, 128, 10**9])
def test_the_seed_of_a_prbs_is_where_it_starts(seed: int) -> None:
    once, other = signals.prbs(127, bits=7), signals.prbs(127, bits=7, seed=seed)
    assert any((np.roll(once, shift) == other).all() for shift in range(127))


def test_a_prbs_holds_each_value_and_has_its_amplitude() -> None:
    np.testing.assert_array_equal(
        signals.prbs(100, bits=5, hold=4, amplitude=2.5), 2.5 * np.repeat(signals.prbs(25, bits=5), 4)
    )
    assert signals.prbs(7, bits=5, hold=4).size == 7


def test_a_square_wave_switches_every_half_period() -> None:
    u = signals.square(1000, period=0.5, dt=0.01, amplitude=3.0)
    t = np.arange(1000)
    np.testing.assert_array_equal(u, 3.0 * (-1.0) ** (t // 25))
    assert u[:500].sum() == 0


def test_random_steps_keep_their_bounds() -> None:
    u = signals.random_steps(20_000, shortest=5, longest=50, low=2.0, high=3.0, seed=1)
    lengths = np.diff(np.flatnonzero(np.concatenate([[True], np.diff(u) != 0])))  # the last step may be cut
    assert lengths.min() >= 5
    assert lengths.max() <= 50
    assert 2.0 <= u.min() < 2.05 < 2.95 < u.max() <= 3.0
    # spread evenly in the logarithm, the median is the geometric mean of the bounds, 15.8
    assert 13 <= np.median(lengths) <= 19
    np.testing.assert_array_equal(u, signals.random_steps(20_000, shortest=5, longest=50, low=2.0, high=3.0, seed=1))
    assert (u != signals.random_steps(20_000, shortest=5, longest=50, low=2.0, high=3.0, seed=2)).any()


def test_a_multisine_holds_its_lines_and_no_others() -> None:
    frequencies = np.array([1.0, 3.0, 7.0, 20.0])
    u = signals.multisine(1000, 0.01, frequencies, amplitude=2.0)
    lines = abs(np.fft.rfft(u)) / 500
    at = (frequencies * 10).astype(int)  # ten seconds: a line every 0.1 Hz
    np.testing.assert_allclose(lines[at], lines[at][0], rtol=1e-9)
    assert np.delete(lines, at).max() < 1e-9
    assert abs(u).max() == pytest.approx(2.0)
    assert lines[at][0] > 2.0 / 4  # Schroeder's phases: the peak is below the sum of the amplitudes


@pytest.mark.parametrize(("first", "last"), [(0.5, 8.0), (8.0, 0.5), (2.0, 2.0)])
def test_a_chirp_runs_from_the_first_frequency_to_the_last(first: float, last: float) -> None:
    """Its zero crossings count the phase, whose mean frequency is (last - first) / ln(last / first)."""
    dt, samples = 1e-3, 10_000
    u = signals.chirp(samples, dt, first, last)
    mean = first if first == last else (last - first) / math.log(last / first)
    crossings = np.count_nonzero(np.diff(np.sign(u[1:])))
    assert abs(crossings - 2 * mean * samples * dt) <= 1
    for end, frequency in ((slice(0, 3), first), (slice(-3, None), last)):
        a, b, c = u[end]  # a sine of one frequency obeys a + c = 2 b cos(2 pi f dt)
        if abs(b) > 0.05:
            assert math.acos((a + c) / (2 * b)) / (2 * math.pi * dt) == pytest.approx(frequency, rel=0.2)


def test_white_noise_has_its_rms_and_no_memory() -> None:
    """Standard deviations over K samples: rms/sqrt(K), rms/sqrt(2K), 1/sqrt(K) of mean, rms, correlation; 5 allowed."""
    K, rms = 100_000, 0.3
    noise = signals.white_noise(K, rms, seed=1)
    assert abs(noise.mean()) < 5 * rms / math.sqrt(K)
    assert abs(noise.std() - rms) < 5 * rms / math.sqrt(2 * K)
    assert abs(np.mean(noise[1:] * noise[:-1])) / rms**2 < 5 / math.sqrt(K)
    np.testing.assert_array_equal(noise, signals.white_noise(K, rms, seed=1))


@every(
    ("call", "named"),
    [
        (lambda: signals.square(10, 0.0, 0.1), "period"),
        (lambda: signals.square(10, 0.1, 0.1), "period"),
        (lambda: signals.square(10, 1.0, -0.1), "dt"),
        (lambda: signals.square(-1, 1.0, 0.1), "samples"),
        (lambda: signals.prbs(10, bits=1), "bits"),
        (lambda: signals.prbs(10, bits=19), "bits"),
        (lambda: signals.prbs(10, bits=None), "bits"),
        (lambda: signals.prbs(10, hold=0), "hold"),
        (lambda: signals.prbs(10, seed=0), "seed"),
        (lambda: signals.prbs(1.5), "samples"),
        (lambda: signals.random_steps(10, shortest=0, longest=5, low=0, high=1), "shortest"),
        (lambda: signals.random_steps(10, shortest=6, longest=5, low=0, high=1), "shortest"),
        (lambda: signals.multisine(10, 0.1, np.array([5.0])), "frequencies"),
        (lambda: signals.multisine(10, 0.1, np.array([])), "frequencies"),
        (lambda: signals.multisine(10, 0.1, np.array([-1.0])), "frequencies"),
        (lambda: signals.chirp(10, 0.1, 0.0, 1.0), "first"),
        (lambda: signals.chirp(10, 0.1, 1.0, -1.0), "last"),
        (lambda: signals.chirp(10, math.nan, 1.0, 1.0), "dt"),
        (lambda: signals.white_noise(10, -1.0), "rms"),
    ],
)
def test_bad_arguments_are_refused_by_name(call: Any, named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("samples", [0, 1])
def test_a_signal_of_any_length_has_that_length(samples: int) -> None:
    assert signals.square(samples, 1.0, 0.1).shape == (samples,)
    assert signals.prbs(samples, hold=7).shape == (samples,)
    assert signals.random_steps(samples, shortest=1, longest=5, low=0, high=1).shape == (samples,)
    assert signals.white_noise(samples, 1.0).shape == (samples,)
