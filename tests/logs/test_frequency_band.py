"""A band-pass leaves G(s) unchanged, and removes signals outside the band."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.signals import prbs, white_noise
from support.cases import every

G = rp.TransferFunction([4.0], [1.0, 0.8, 4.0])
TRUE = np.array([0.8, 4.0, 4.0])
DT = 0.01
U = prbs(6000, hold=20) + 3.0
LOG = rp.Log(U, G.simulate(U, DT) + 5.0, DT)


@every("edges", [(0.1, None), (None, 5.0), (0.1, 5.0)], quick=1)
def test_the_plant_of_the_filtered_signals_is_the_plant(edges: tuple[float | None, float | None]) -> None:
    """A hundredth of the filter's transient remains."""
    filtered = rp.bandpass(LOG, *edges)
    np.testing.assert_allclose(rp.fit(filtered, poles=2).parameters, TRUE, rtol=1e-4)
    assert filtered.input_hold == "zoh"


def test_a_record_that_begins_with_a_transient_gives_the_plant_as_well() -> None:
    log = rp.Log(LOG.input[1234:], LOG.output[1234:], DT)
    np.testing.assert_allclose(rp.fit(rp.bandpass(log, 0.1, 5.0), poles=2).parameters, TRUE, rtol=1e-4)


def test_signals_outside_of_the_band_go_and_those_within_stay() -> None:
    t = np.arange(20_000) * DT
    slow, within, fast = (np.sin(2.0 * np.pi * f * t) for f in (0.01, 1.0, 40.0))
    log = rp.Log(slow + within + fast, slow + within + fast + 0.2 * t, DT)
    found = rp.bandpass(log, 0.1, 10.0)
    later = slice(5000, None)
    for signal in (found.input, found.output):
        centred = signal[later] - np.nanmean(signal[later])
        # two poles an edge: a decade away a hundredth is left, a factor of four a sixteenth
        assert float(np.std(centred)) == pytest.approx(float(np.std(within)), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("counted", [False, True])
def test_a_drift_that_would_spoil_the_model_is_taken_away(counted: bool) -> None:
    """`make slow` also fits the spoiled model to a third of the record, which takes ten times as long."""
    drift = 10.0 * np.sin(2.0 * np.pi * 0.005 * DT * np.arange(U.size))  # a twentieth of the edge: 1/400 of it stays
    drifting = rp.Log(U, LOG.output + drift + white_noise(U.size, 0.01, seed=1), DT)
    straight = rp.fit(rp.bandpass(drifting, 0.1), poles=2)
    if counted:
        spoilt = rp.fit(drifting.input[:2000], drifting.output[:2000], DT, poles=2)
        assert (np.abs(spoilt.parameters / TRUE - 1.0) > 0.5).all()
    assert straight.simulation.fit > 95.0
    np.testing.assert_allclose(straight.parameters, TRUE, rtol=0.02)


def test_missing_outputs_stay_missing_and_a_gap_is_forgotten() -> None:
    y = LOG.output.copy()
    y[1000] = np.nan
    y[3000:3100] = np.nan
    found = rp.bandpass(rp.Log(U, y, DT), 0.5).output
    known = np.isfinite(found)
    assert not known[1000]
    assert known[1001:3000].all()  # one sample is interpolated
    begin, behind = int(np.flatnonzero(known)[0]), int(np.flatnonzero(known[3100:])[0])
    assert 1.0 < begin * DT * 0.5 * 2.0 < 4.0  # about a period of the edge
    assert abs(behind - begin) <= 2


def test_each_signal_keeps_its_mean() -> None:
    filtered = rp.bandpass(LOG, 0.1)
    assert filtered.input.mean() == pytest.approx(LOG.input.mean())


@every(
    ("edges", "words"),
    [
        ((None, None), "low or a high edge"),
        ((0.0, None), "greater than 0"),
        ((2.0, 1.0), "below the high edge"),
        ((None, 50.0), "half the sampling rate"),
        ((0.01, None), "too low"),
        ((1e-12, None), "too low"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_sentence(edges: tuple[float | None, float | None], words: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=words):
        rp.bandpass(LOG, *edges)


def test_an_irregular_clock_is_refused() -> None:
    t = np.cumsum(1.0 + 0.1 * np.sin(np.arange(U.size)))
    with pytest.raises(rp.InvalidArgumentError, match="irregular"):
        rp.bandpass(rp.Log(U, LOG.output, 1.0, t), 0.1)
