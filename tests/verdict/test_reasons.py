"""Each reason of the verdict in pairs: a record where it is the cause, and one that looks alike where it is not."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.verdict import Assessment
from replant.verdict.estimate_tests import longer
from support.builders import binary
from support.cases import every
from support.loops import DT as LOOP_DT
from support.loops import closed_loop, coloured

DT, SAMPLES = 0.05, 3000


def said(verdict: Assessment, words: str) -> bool:
    return words in " ".join(verdict.reasons)


def running(u: np.ndarray, y: np.ndarray, poles: int = 1) -> Assessment:
    ident = rp.Identifier(rp.Structure(poles), DT)
    ident.update_many(u, y)
    return ident.assess()


def whole(u: np.ndarray, y: np.ndarray, poles: int = 1) -> Assessment:
    return rp.fit(u, y, DT, rp.Structure(poles)).verdict


def slow(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three slow sines and the output of a lag, without noise."""
    phases, t = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3), DT * np.arange(SAMPLES)
    u = sum(np.sin(2.0 * np.pi * f * t + phase) for f, phase in zip((0.013, 0.037, 0.11), phases, strict=True))
    u = np.asarray(u)
    return u, rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, DT)


def switched(seed: int, *, hold: int = 100, speed: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """A random switch and the output of a lag, without noise."""
    u = np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], SAMPLES // hold), hold)
    return u, rp.TransferFunction([1.0], [1.0, speed]).simulate(u, DT)


def noisy(seed: int) -> tuple[np.ndarray, np.ndarray]:
    u, y = switched(seed, hold=20, speed=1.0)
    return u, y + 0.05 * y.std() * np.random.default_rng([seed, 1]).standard_normal(y.size)


def rounded(y: np.ndarray, levels: int) -> np.ndarray:
    step = np.ptp(y) / levels
    return np.asarray(np.round(y / step) * step)


# --- a sensor at its limit

LIMIT = "a sensor at its limit"


@every("seed", range(4), quick=1)
@pytest.mark.parametrize("judged", [whole, running])
def test_an_encoder_that_turns_round_is_not_at_its_limit(seed: int, judged: Callable[..., Assessment]) -> None:
    u, y = slow(seed)
    assert not said(judged(u, rounded(y, 8)), LIMIT), seed
    load = np.ptp(y) / 8 * coloured(seed, SAMPLES, 0.98)  # the model errs by steps
    assert not said(judged(u, rounded(y + load, 12)), LIMIT), seed


@every("seed", range(4), quick=1)
@pytest.mark.parametrize("judged", [whole, running])
def test_nor_is_a_coarse_output_that_was_logged_with_few_digits(seed: int, judged: Callable[..., Assessment]) -> None:
    """The distances of its values are not equal then: 0.2, 0.2, 0.3."""
    u, y = switched(seed)
    assert not said(judged(u, np.round(rounded(y, 40), 1)), LIMIT), seed


@pytest.mark.slow
@every("seed", range(4), quick=2)
def test_an_output_that_is_cut_off_is(seed: int) -> None:
    u, y = slow(seed)
    coarse = rounded(y, 12)
    verdict = whole(u, np.minimum(coarse, np.unique(coarse)[-4]))
    assert said(verdict, LIMIT) or said(verdict, "left out: the sensor was stuck or at its limit"), verdict.reasons
    u, y = noisy(seed)
    verdict = running(u, np.minimum(y, 0.5 * y.max()))
    assert said(verdict, LIMIT) or said(verdict, "left out: the sensor was stuck or at its limit"), verdict.reasons


# --- an end that is filled up

FILLED = "the end of the record is filled up"


@every("seed", range(4), quick=1)
@every("coarse", [False, True], quick=1)
@every("both", [False, True])
def test_an_end_filled_up_with_zeros_is_named(seed: int, *, coarse: bool, both: bool) -> None:
    u, y = switched(seed) if coarse else noisy(seed)
    u, y = u + 2.0, (rounded(y, 30) if coarse else y) + 20.0
    y[-240:] = 0.0
    u[-240:] = 0.0 if both else u[-240:]
    verdict = running(u, y)
    assert said(verdict, FILLED), (seed, verdict.reasons)
    assert not said(verdict, LIMIT)
    assert not said(verdict, "stuck")
    assert said(verdict, f" s of {'input and output' if both else 'the output'} are constant")
    assert coarse or said(whole(u, y), "240 outputs were left out")


@every("seed", range(4), quick=2)
def test_a_sensor_that_stays_where_it_was_fills_up_nothing(seed: int) -> None:
    u, y = noisy(seed)
    y[-400:] = y[-401]
    verdict = running(u, y)
    assert not said(verdict, FILLED), (seed, verdict.reasons)
    assert said(verdict, "the output is constant to the bit for 20 s while the model's output moved by")


# --- a sensor that is stuck

STUCK = "a stuck or saturated sensor"


@every("seed", range(3), quick=1)
@every("judged", [whole, running], quick=1)
@every("levels", [6, 26, 40], quick=1)
def test_the_plateaus_of_a_coarse_sensor_are_not_stuck(
    seed: int, judged: Callable[..., Assessment], levels: int
) -> None:
    u, y = switched(seed)
    for measured in (rounded(y, levels), np.round(rounded(y, levels), 1)):
        verdict = judged(u, measured)
        assert not said(verdict, STUCK), (seed, verdict.reasons)
        assert not said(verdict, "left out")


def test_a_sensor_that_was_stuck_where_the_output_seldom_comes_is_well_after_as_long() -> None:
    """What was measured beyond it before says that it is no end of the scale."""
    u, y = noisy(0)
    before, since = y[:1500].max(), y[1800:].max()
    assert before > since
    y[1500:1800] = 0.5 * (before + since)
    assert said(running(u[:2050], y[:2050]), STUCK)
    verdict = running(u, y)
    assert verdict.status == "trusted", verdict.reasons
    assert not said(verdict, STUCK)
    assert said(verdict, "300 outputs were left out")


@every("seed", range(3), quick=1)
def test_a_coarse_sensor_that_stands_still_while_the_model_moves_many_steps_is(seed: int) -> None:
    u, y = switched(seed)
    u[-380:-180] = 1.0  # up and down, by ten steps and more
    u[-180:] = -1.0
    y = rounded(rp.TransferFunction([1.0], [1.0, 0.2]).simulate(u, DT), 26)
    y[-400:] = y[-401]
    assert said(running(u, y), STUCK), seed
    verdict = whole(u, y)
    assert said(verdict, "outputs were left out: the sensor was stuck") or said(verdict, STUCK), verdict.reasons


# --- an input that is constant

NEVER, RESTED = "the input is constant: move it", "the input has rested for the last"


@pytest.mark.parametrize("level", [0.0, 1.5])
def test_a_constant_input_is_named_where_no_model_is_found_too(level: float) -> None:
    u, y = np.full(400, level), 3.0 + 0.01 * np.random.default_rng(1).standard_normal(400)
    for attempt in (lambda: rp.fit(u, y, DT, poles=1, method="srivc"), lambda: rp.search(u, y, DT, poles=(1, 2))):
        with pytest.raises(rp.ReplantError, match=NEVER):
            attempt()


def test_an_input_that_moved_before_has_rested() -> None:
    """For longer than samples are kept: 10,000."""
    u, y = noisy(1)
    settles = u[-1] + (y[-1] - u[-1]) * np.exp(-DT * np.arange(1, 10_501))  # the plant's time constant is 1 s
    u = np.append(u, np.full(10_500, u[-1]))
    y = np.append(y, settles + 0.05 * np.random.default_rng(1).standard_normal(10_500))
    ident = rp.Identifier(rp.Structure(1), DT)
    ident.update_many(u[:SAMPLES], y[:SAMPLES])
    assert ident.assess().status == "trusted"
    ident.update_many(u[SAMPLES:], y[SAMPLES:])
    verdict = ident.assess()
    assert (verdict.status, verdict.excited) == ("trusted", False)
    assert verdict.reasons[-1].startswith(f"{RESTED} 500 s and more")
    assert not said(verdict, NEVER)


def test_an_input_that_never_moved_is_constant() -> None:
    y = np.random.default_rng(1).standard_normal(2 * SAMPLES)
    verdict = running(np.ones(y.size), y)
    assert verdict.status == "not excited"
    assert said(verdict, NEVER)
    assert not said(verdict, RESTED)


# --- a plant that changes half-way

CHANGED = "the plant seems to have changed"


def halves(seed: int, gain: float, load: float, what: str = "gain") -> rp.Assessment:
    """The verdict of `fit` on 2,000 samples, under noise of a quarter of the output."""
    u, after = binary(seed, 2000, 10), np.arange(2000) >= 1000
    if what == "input":  # it moves less from then on
        u = np.where(after, 0.3 * u, u)
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.1) * np.where(after, gain, 1.0) + load * after
    noise = 0.25 * y.std() * np.random.default_rng([seed, 3]).standard_normal(2000)
    if what == "noise":
        noise = np.where(after, 2.0 * noise, noise)
    return rp.fit(u, y + noise, 0.1, rp.Structure(1)).verdict


@every("seed", range(3), quick=1)
def test_a_plant_that_changes_half_way_has_changed(seed: int) -> None:
    verdict = halves(seed, 1.25, 0.0)
    assert verdict.status == "inconsistent"
    assert said(verdict, CHANGED)


@every("seed", range(3), quick=1)
@every(("load", "what"), [(0.0, ""), (1.0, ""), (0.0, "noise"), (0.0, "input")])
def test_a_load_other_noise_or_another_input_is_no_change_of_the_plant(load: float, what: str, seed: int) -> None:
    assert not said(halves(seed, 1.0, load, what), CHANGED)


# --- what makes an estimate better known

MORE, LONGER = "take more samples", r"record ([\d.]+) times as long"


def uncertain(samples: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(3)
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 40 + 1), 40)[:samples]
    y = rp.TransferFunction([1.0], [1.0, 1.5, 0.5]).simulate(u, DT)
    return u, y + 1.1 * generator.standard_normal(samples)  # more would hide the second pole


@pytest.mark.slow
def test_of_a_record_that_has_ended_it_is_said_how_long_another_has_to_be() -> None:
    """And one as long as that is known well enough."""
    u, y = uncertain(800)
    verdict = whole(u, y, 2)
    factor = re.search(LONGER, " ".join(verdict.reasons))
    assert verdict.status == "converging"
    assert factor
    assert not said(verdict, MORE)
    longer = whole(*uncertain(int(800 * 2.0 * float(factor[1]))), 2)  # a figure of a figure
    assert longer.status == "trusted", longer.reasons


def test_a_running_identifier_takes_more_samples() -> None:
    verdict = running(*uncertain(1000), 2)
    assert said(verdict, MORE), verdict.reasons
    assert not re.search(LONGER, " ".join(verdict.reasons))


# --- the reference follows the disturbances

FOLLOWS = "the reference follows the disturbances"
CONTROLLED = [1.0], [1.0, 1.4, 1.0]


def set_points(seed: int, *, jumps: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A few set-points at random times round a PI controller, under a load and where asked for with jumps of y."""
    generator, samples = np.random.default_rng(seed), 3000
    r, noise = np.zeros(samples), 0.005 * generator.standard_normal(samples)
    for at in np.sort(generator.choice(np.arange(50, 2950), 12, replace=False)):
        r[at:] = generator.uniform(-1.0, 1.0)
    if jumps:
        for at in np.flatnonzero(np.diff(r))[:3] - 3:  # by chance just before the first set-points
            noise[at:] += 0.5
    u, y = closed_loop(*CONTROLLED, (2.0, 1.0), LOOP_DT, r, 0.05 * coloured(seed, samples, 0.98), noise)
    return u, y, r


@pytest.mark.slow
@every("seed", range(3))
@every("jumps", [False, True])
@every("late", [0, 1])  # samples by which the logger is late with the set-point
def test_a_few_set_points_follow_no_disturbance(seed: int, late: int, *, jumps: bool) -> None:
    u, y, r = set_points(seed, jumps=jumps)
    seen = np.concatenate([np.full(late, r[0]), r[: r.size - late]])
    verdict = rp.fit(u, y, LOOP_DT, rp.Structure(2), reference=seen).verdict
    assert not said(verdict, FOLLOWS), (seed, verdict.reasons)


@every("seed", range(6), quick=1)
def test_what_is_made_from_the_output_does(seed: int) -> None:
    u, y, r = set_points(seed, jumps=False)
    for wrong in (r - y, y):
        verdict = rp.fit(u, y, LOOP_DT, rp.Structure(2), reference=wrong).verdict
        assert said(verdict, FOLLOWS), (seed, verdict.reasons)


def test_no_less_than_a_tenth_more_is_asked_for() -> None:
    assert longer(1.02, 1.0, "record {} times as long") == "record 1.1 times as long"
    assert longer(2.0, 1.0, "record {} times as long") == "record 4 times as long"


def test_an_input_that_stands_still_to_the_bit_has_no_part_of_its_variance() -> None:
    u = np.append(binary(1, 3000, 8), np.ones(2500))
    y = rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, 0.05) + 0.02 * np.random.default_rng(1).standard_normal(5500)
    ident = rp.Identifier(poles=1, dt=0.05)
    ident.update_many(u, y)
    assert not any(" 0 %" in reason for reason in ident.assess().reasons)
    assert any(reason.startswith("the input has rested for the last") for reason in ident.assess().reasons)
