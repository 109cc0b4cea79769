"""A record that begins at rest: a step right at its start suffices for the gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from support.cases import every

G = rp.TransferFunction([2.0], [12.0, 1.0])
DT = 0.5


def step_test(seed: int, begin: int, level: float = 3.0) -> rp.Log:
    u = np.where(np.arange(150) < begin, level, level + 1.0)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(150)
    return rp.Log(u, 5.0 + G.simulate(u - level, DT) + noise, DT)


@every("begin", [1, 5, 40], quick=1)
def test_the_gain_is_better_known_and_within_what_is_promised(begin: int) -> None:
    """Over 20 records the mean square error, in standard deviations, is 1 within a factor of 2."""
    off, spread = [], []
    for seed in range(20):
        log = step_test(seed, begin)
        found, plain = rp.fit(rp.from_rest(log), poles=1), rp.fit(log, poles=1)
        std = found.uncertainty.dc_gain_std
        off.append((found.transfer_function.dc_gain - 2.0) / std)
        spread.append(std / plain.uncertainty.dc_gain_std)
    assert np.median(spread) < (0.1 if begin == 1 else 1.0)
    assert np.mean(np.square(off)) < 2.0


def test_the_samples_put_before_the_log_are_at_rest() -> None:
    log = step_test(0, 5)
    log = rp.Log(log.input, log.output, DT, 7.0 + DT * np.arange(150), others={"pump": np.arange(150.0)})
    longer = rp.from_rest(log)
    assert (longer.input[:155] == 3.0).all()
    # the output at the step has not moved yet: six samples at rest, of which none is lost or counts twice
    places = [0, 6, 25, 56, 99, 155]
    assert np.flatnonzero(np.isfinite(longer.output[:156])).tolist() == places
    np.testing.assert_array_equal(longer.output[places], log.output[:6])
    np.testing.assert_array_equal(longer.output[156:], log.output[6:])
    np.testing.assert_allclose(np.diff(longer.time), DT)
    assert longer.stamps is None
    assert (longer.others["pump"][:151] == 0.0).all()


def test_without_an_output_before_the_first_move_it_is_refused() -> None:
    log = step_test(0, 5)
    y = log.output.copy()
    y[:6] = np.nan
    with pytest.raises(rp.InvalidArgumentError, match="the output at rest is unknown"):
        rp.from_rest(rp.Log(log.input, y, DT))


def test_the_option_name_of_other_tools_gets_a_hint() -> None:
    log = step_test(0, 5)
    with pytest.raises(rp.ArgumentTypeError, match="from_rest"):
        rp.fit(log, poles=1, x0="zero")


def test_a_dead_time_does_not_hide_the_rest() -> None:
    u = np.where(np.arange(150) < 5, 3.0, 4.0)
    late = rp.TransferFunction([2.0], [12.0, 1.0], 6.0)
    y = 5.0 + late.simulate(u - 3.0, DT) + 0.05 * np.random.default_rng(3).standard_normal(150)
    found = rp.fit(rp.from_rest(rp.Log(u, y, DT)), poles=1, delay=6.0)
    assert found.transfer_function.dc_gain == pytest.approx(2.0, abs=4.0 * found.uncertainty.dc_gain_std)
    assert found.uncertainty.dc_gain_std < 0.05
    assert found.one_step > 80.0


@pytest.mark.slow
@every("several", [False, True], quick=1)
def test_the_rest_is_no_part_of_the_record_that_is_counted(several: bool) -> None:
    """The added samples count neither as samples nor as rejected ones, nor in the duration."""
    log = step_test(0, 5)
    pump = np.where(np.arange(150) // 30 % 2 == 0, 0.0, 1.0)
    y = log.output + G.simulate(pump, DT)
    y[100] = np.nan
    log = rp.Log(log.input, y, DT, others={"pump": pump}, more_inputs=("pump",)) if several else rp.Log(pump, y, DT)
    poles = (1, 1) if several else 1
    longer = rp.from_rest(log)
    assert (longer.rest, len(longer), longer.duration) == (150, 300, log.duration)
    for identify, reason in ((rp.fit, "not finite"), (rp.run, "no output")):
        found, plain = (identify(each, poles=poles) for each in (longer, log))
        assert found.rejected[reason] == plain.rejected[reason] == 1
        assert found.samples == plain.samples == (149 if identify is rp.fit else 150)
        assert found.model.provenance.samples == found.samples
        assert dict(found.model.rejected) == found.rejected
    found = rp.fit([longer, longer], poles=poles)
    assert (found.samples, found.rejected["not finite"]) == (298, 2)


def test_what_the_verdict_dates_counts_no_rest() -> None:
    verdict = rp.fit(rp.from_rest(step_test(0, 5)), poles=1).verdict
    assert "over the last 75 s" in verdict.reasons[0]  # 150 samples, and as many of rest
    record = Record(np.zeros(300), np.zeros(300), np.array([DT]), rest=150)
    assert record.since_first(200) == pytest.approx(50 * DT)
    assert record.last(200).rest == 50
    assert record.first(100).rest == 100
    assert record.since_first(100) == 0.0


def test_the_rest_is_that_of_the_new_clock() -> None:
    log = step_test(0, 5)
    t = DT * np.arange(150) + 0.1 * DT * (np.arange(150) % 2)
    longer = rp.from_rest(rp.Log(log.input, log.output, DT, t))
    assert longer.stamps is not None
    assert longer.duration == pytest.approx(t[-1] - t[0] + DT)
    finer = rp.resample(longer, 0.5 * DT)
    assert (finer.rest, len(finer) - finer.rest) == (300, 299)
    assert rp.decimate(rp.from_rest(log), 2).rest == 65
    assert [rp.resample(replace(log, rest=rest), log.dt / 2).rest for rest in (0, len(log))] == [0, 299]
    assert rp.from_rest(rp.from_rest(log)).rest == 450
