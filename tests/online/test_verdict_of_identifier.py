"""Identifier.assess: right models are trusted, wrong ones never, failures are noticed soon, and nothing is changed."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.estimation.settings import Request
from replant.logs import read_log
from replant.online.runs.result import result_of_fit
from replant.online.runs.run import run_online
from replant.verdict import Assessment
from support import live_fakes
from support.builders import AWKWARD, DT, binary, irregular_record, state
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy import verdicts

PLANT, STRUCTURE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2)


def noisy(
    plant: rp.TransferFunction, samples: int, dt: float, decibels: float, seed: int, hold: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    """A random binary input and the output with white noise so many decibels below it (infinite: none)."""
    u = binary(seed, samples, hold)
    y = plant.simulate(u, dt)
    return u, y + y.std() * 10 ** (-decibels / 20) * np.random.default_rng([seed, 3]).standard_normal(samples)


def identified(u: np.ndarray, y: np.ndarray, *, dt: float = DT, t: Any = None, **arguments: Any) -> rp.Identifier:
    ident = rp.Identifier(arguments.pop("structure", STRUCTURE), dt, **arguments)
    ident.update_many(u, y, t)
    return ident


def assert_trusted(verdict: Assessment, *, without_caveat: bool = True) -> None:
    assert verdict.status == "trusted", verdict
    assert len(verdict.reasons) == 1 or not without_caveat, verdict.reasons
    assert "which the estimate had not used" in verdict.reasons[0]
    assert verdict.held_out > 0


def test_stamps_in_another_unit_are_named_though_each_sample_lies_behind_a_gap() -> None:
    u, y = noisy(PLANT, 3000, DT, 20.0, 1)
    verdict = identified(u, y, t=1000.0 * DT * np.arange(3000)).assess()
    assert verdict.status == "inconsistent"
    assert verdict.reasons[0].startswith(f"the time stamps are {1000.0 * DT:.3g} s apart where dt says {DT:.3g} s")


# --- right and wrong: `make accuracy` takes thirty of each


@every("number", range(len(verdicts.RIGS) * len(verdicts.DECIBELS)), quick=3)
def test_a_right_model_is_trusted(number: int) -> None:
    """Each plant under each noise can be told from its record, so all are; the promise is 27 of thirty."""
    status, reasons = verdicts.right(number).assessed
    assert status == "trusted", reasons


@every("number", range(2 * len(verdicts.KINDS)), quick=3)
def test_a_wrong_model_is_not(number: int) -> None:
    """Each kind on two plants."""
    status, reasons = verdicts.wrong(number).assessed
    assert status in ("not excited", "inconsistent", "converging"), reasons
    assert all(reason and "\n" not in reason for reason in reasons)


def test_without_time_stamps_no_one_can_know_the_sampling_time() -> None:
    """The same samples at a tenth of the rate are those of a plant ten times as slow: to the bit, in other units."""
    u, y = noisy(PLANT, 4000, DT, 20.0, seed=1)
    right, slow = identified(u, y), identified(u, y, dt=10 * DT)
    assert_trusted(right.assess())
    assert_trusted(slow.assess())
    np.testing.assert_allclose(10 * slow.transfer_function.poles, right.transfer_function.poles, rtol=1e-6)


# --- other plants, inputs, clocks, optimizers


@every("decibels", [30.0, math.inf], quick=1)
@every("name", AWKWARD, quick=4)
def test_awkward_plants_are_trusted(name: str, decibels: float) -> None:
    structure, plant = AWKWARD[name]
    verdict = identified(*noisy(plant, 4000, DT, decibels, seed=3, hold=7), structure=structure).assess()
    assert_trusted(verdict)
    assert verdict.fit > (99.99 if decibels == math.inf else 93.0)


@pytest.mark.parametrize("dropped", [0.0, 0.1])
def test_an_irregular_clock_is_trusted(dropped: float) -> None:
    u, y, t = irregular_record(PLANT, seed=1, samples=3600, dt=DT, dropped=dropped, hold=8)
    y = y + 0.05 * y.std() * np.random.default_rng(0).standard_normal(y.size)
    assert_trusted(identified(u, y, t=t).assess())


@pytest.mark.parametrize("colour", [0.5, 0.9])
def test_the_colour_of_the_noise_is_its_own_business(colour: float) -> None:
    u, y = noisy(PLANT, 6000, DT, math.inf, seed=2)
    noise = lfilter([1.0], [1.0, -colour], np.random.default_rng(1).standard_normal(7000))[1000:]
    verdict = identified(u, y + 0.3 * y.std() / noise.std() * noise).assess()
    assert_trusted(verdict)
    assert verdict.whiteness > 1.0


@every("name", OPTIMIZERS, quick=2)
def test_with_instruments_every_optimizer_is_trusted_without_them_none(name: str) -> None:
    """At 10 dB least squares is an eighth off: the identifier must say so of itself.

    The plain gradient and AdaDelta take longer than the record: they may say that instead.
    """
    u, y = noisy(PLANT, 12_000, DT, 10.0, seed=3)
    verdict = identified(u, y, optimizer=name, instruments=True).assess()
    slow = name in ("gradient", "adadelta")
    assert verdict.status == "trusted" or (slow and verdict.status == "converging"), verdict
    biased = identified(u, y, optimizer=name, instruments=False).assess()
    assert biased.status == "inconsistent"
    assert "noise biases" in " ".join(biased.reasons)
    assert biased.distance > 0.1


def test_a_frozen_estimate_stays_trusted_while_the_plant_stays() -> None:
    u, y = noisy(PLANT, 6000, DT, 15.0, seed=5)
    ident = identified(u[:3000], y[:3000])
    ident.freeze()
    ident.update_many(u[3000:], y[3000:])
    verdict = ident.assess()
    assert_trusted(verdict)
    assert verdict.held_out == 3000  # all that came since


@pytest.mark.slow
def test_an_estimate_that_follows_is_trusted_and_one_that_remembers_all_only_where_it_is_near() -> None:
    """a0 from 3 to 4.2 in a line over 8,000 samples: 0.045 in 300 samples.

    The default begins again whenever what it remembers has become too wrong.
    """
    samples, u = 8000, binary(1, 8000, 8)
    slow, fast = (rp.TransferFunction([2.0], [1.0, 4.0, a0]).simulate(u, DT) for a0 in (3.0, 4.2))
    y = slow + (fast - slow) * np.linspace(0.0, 1.0, samples)
    y = y + 0.03 * y.std() * np.random.default_rng(0).standard_normal(samples)
    tracking = rp.KalmanTracking(process_noise=[1e-3, 1e-2, 1e-3])
    assert_trusted(identified(u, y, optimizer=tracking).assess(), without_caveat=False)
    ident = identified(u, y)
    assert np.abs(ident.parameters / [4.0, 4.2, 2.0] - 1.0).max() < 0.05 or ident.assess().status != "trusted"


# --- what an engineer meets


def test_starting() -> None:
    ident = rp.Identifier(STRUCTURE, DT)
    assert ident.assess() == ident.assess()
    assert (ident.assess().status, ident.assess().samples) == ("converging", 0)
    u, y = noisy(PLANT, 700, DT, 20.0, seed=1)
    ident.update_many(u[:200], y[:200])
    verdict = ident.assess()
    assert (verdict.status, verdict.samples) == ("converging", 200)
    assert "200 of the 500 samples" in verdict.reasons[0]
    ident.update_many(u[200:550], y[200:550])
    verdict = ident.assess()
    assert verdict.status == "converging"
    assert "too few to test it on" in verdict.reasons[0]
    still = rp.Identifier(STRUCTURE, DT)
    still.update_many(np.ones(100), y[:100])
    assert still.assess().status == "not excited"
    stamped = rp.Identifier(STRUCTURE, DT)
    stamped.update_many(u[:100], y[:100], 2.0 * np.arange(100))
    assert stamped.assess().status == "inconsistent"


def test_a_refused_update_is_a_divergence() -> None:
    u, y = noisy(PLANT, 500, DT, 20.0, seed=1)
    huge = {"filter": rp.StateVariableFilter(2.0), "scaling": None, "optimizer": rp.Gradient(1e200), "normalize": False}
    ident = identified(1e100 * u, 1e100 * y, replay=None, **huge)
    assert ident.status == "diverged"
    verdict = ident.assess()
    assert verdict.status == "diverged"
    assert "float64" in verdict.reasons[0]


def test_a_log_too_short_for_anything() -> None:
    for samples in (1, 5, 40):
        ident = rp.Identifier(rp.Structure(1), DT)
        ident.update_many(*noisy(PLANT, samples, DT, 20.0, seed=1))
        ident.finish()
        assert ident.assess().status in ("converging", "not excited")


def test_after_an_interruption_it_waits_for_samples_and_trusts_again() -> None:
    u, y, t = irregular_record(PLANT, seed=2, samples=4000, dt=DT, hold=8)
    y = y + 0.05 * y.std() * np.random.default_rng(0).standard_normal(y.size)
    t[2000:] += 60.0  # longer than any memory of the plant's
    ident = identified(u[:2090], y[:2090], t=t[:2090])
    verdict = ident.assess()
    assert verdict.status == "converging"
    assert "since the last interruption" in verdict.reasons[0]
    ident.update_many(u[2090:], y[2090:], t[2090:])
    assert_trusted(ident.assess())


@pytest.mark.slow
def test_after_a_cable_has_floated_a_slow_plant_is_trusted_when_its_gain_shows() -> None:
    """Its time constant is 1,000 samples; 100 would be enough for a faster plant."""
    plant, known, lasted = rp.TransferFunction([2.0], [1.0, 1.0 / (1000 * DT)]), 8000, 1500
    u, y = noisy(plant, known + lasted + 4000, DT, 20.0, seed=1, hold=200)
    floats = y.copy()
    floats[known : known + lasted] = y.std() * np.random.default_rng(1).standard_normal(lasted)
    ident = identified(u[:known], y[:known], structure=rp.Structure(1))
    assert_trusted(ident.assess())
    ident.update_many(u[known : known + lasted], floats[known : known + lasted])
    assert ident.assess().status != "trusted"
    said = []
    for k in range(known + lasted, y.size, 250):
        ident.update_many(u[k : k + 250], y[k : k + 250])
        said.append(ident.assess())
    waits = [verdict for verdict in said if "as usual again" in " ".join(verdict.reasons)]
    assert all(verdict.status != "trusted" for verdict in said[: said.index(waits[-1]) + 1])
    assert len(waits) > 1
    assert_trusted(said[-1])


@pytest.mark.slow
@every("decibels", [15.0, math.inf], quick=1)
@every("failure", ["sticks", "saturates", "falls off", "floats"])
@every("seed", range(3), quick=1)
def test_a_failing_sensor_loses_trust_within_two_seconds(failure: str, decibels: float, seed: int) -> None:
    dt, known = 0.01, 6000
    u, y = noisy(PLANT, known + 200, dt, decibels, seed, hold=40)
    ident = identified(u[:known], y[:known], dt=dt)
    assert_trusted(ident.assess())
    spread, failed = y[:known].std(), y[known:].copy()
    if failure == "sticks":
        failed[:] = y[known - 1]
    elif failure == "saturates":
        failed = np.clip(failed, -0.5 * spread, 0.5 * spread)
    else:
        floating = 0.05 * spread if failure == "floats" else 0.0
        failed = floating * np.random.default_rng(seed).standard_normal(failed.size)
    ident.update_many(u[known:], failed)
    assert ident.assess().status != "trusted"


# --- it looks and does not touch


@pytest.mark.parametrize("arguments", [{}, {"optimizer": "amsgrad"}, {"optimizer": "kalman-tracking"}], ids=repr)
def test_sample_by_sample_or_in_chunks_the_verdict_is_the_same(arguments: dict[str, Any]) -> None:
    u, y = noisy(PLANT, 1300, DT, 20.0, seed=4)
    whole, chunks, loop = (rp.Identifier(STRUCTURE, DT, **arguments) for _ in range(3))
    whole.update_many(u, y)
    for begin in range(0, 1300, 77):
        chunks.update_many(u[begin : begin + 77], y[begin : begin + 77])
    for k in range(1300):
        loop.update(u[k], y[k])
        if k % 400 == 0:
            loop.assess()
    assert state(whole) == state(chunks) == state(loop)
    assert repr(whole.assess()) == repr(chunks.assess()) == repr(loop.assess())


def test_it_is_frozen_and_changes_nothing() -> None:
    ident = identified(*noisy(PLANT, 3000, DT, 20.0, seed=4))
    before, twin = state(ident), ident.clone()
    verdict = ident.assess()
    assert repr(verdict) == repr(ident.assess()) == repr(twin.assess())
    assert state(ident) == before
    with pytest.raises(dataclasses.FrozenInstanceError):
        verdict.status = "trusted"  # type: ignore[misc]


@pytest.mark.slow
def test_a_verdict_looks_at_all_that_is_kept_and_costs_no_more_however_long_the_stream() -> None:
    """How long that takes is measured by `make bench`."""
    ident = identified(*noisy(AWKWARD["order 4"][1], 12_000, DT, 30.0, seed=3), structure=AWKWARD["order 4"][0])
    assert ident.assess().samples == 10_000


# --- logs


def test_a_fit_is_judged_in_sample() -> None:
    u, y = noisy(PLANT, 4000, DT, 10.0, seed=1)
    fitted = rp.fit(u, y, DT, STRUCTURE)
    verdict = result_of_fit(fitted, u, y, 0.0).verdict
    assert verdict.status == "trusted"
    assert "in sample" in verdict.reasons[0]
    biased = result_of_fit(rp.fit(u, y, DT, STRUCTURE, method="least_squares"), u, y, 0.0).verdict
    assert biased.status == "inconsistent"
    late = rp.TransferFunction([2.0], [1.0, 4.0, 3.0], delay=0.5).simulate(u, DT)
    assert result_of_fit(rp.fit(u, late, DT, STRUCTURE), u, late, 0.0).verdict.status == "inconsistent"


EXPLAINS = "the input could explain another"
#: What one pole, and a dead time in s, leave of a real rig: less than a sixteenth of the amplitude, or more.
LOGS = {
    ("un_dcmotor/DCmotor_prbs_open_exp.csv", 0.0): ("inconsistent", "with a dead time of 0.01 s"),
    ("un_dcmotor/DCmotor_prbs_open_exp.csv", 0.01): ("trusted", "which the estimate had not used"),
    ("un_thermal/Thermal_prbs_open_exp.csv", 0.0): ("trusted", EXPLAINS),
    ("un_thermal/dcmotor2_prbs_open_exp.csv", 0.0): ("inconsistent", "with a dead time of 0.015 s"),
    ("ayala_ballhoop/randomStepSequence.mat", 0.0): ("inconsistent", "the actuator seems to saturate"),
}


@pytest.mark.slow
@every(("name", "delay"), LOGS, quick=1)
def test_one_pole_for_a_real_rig_is_trusted_with_a_caveat_or_not_at_all(
    datasets: Path, name: str, delay: float
) -> None:
    """The first motor answers half a sample late: with that dead time nothing is left to explain."""
    log = read_log(datasets / name, input="u", output="y")
    request = Request(rp.Structure(1, 0, delay), log.dt, preprocess=rp.Preprocess("identity", "mean", "mean"))
    verdict = run_online(request, log.input, log.output).verdict
    status, words = LOGS[name, delay]
    assert verdict.status == status
    assert words in " ".join(verdict.reasons)


@pytest.mark.slow
def test_a_whole_log_is_judged_as_fit_judges_it(datasets: Path) -> None:
    """Its input lies round a working point, which `run` takes off and `fit` does not."""
    log = read_log(datasets / "ayala_ballhoop" / "randomStepSequence.mat", input="u", output="y")
    online = run_online(Request(rp.Structure(1), log.dt), log.input, log.output).verdict
    offline = rp.fit(log.input, log.output, log.dt, rp.Structure(1)).verdict
    said, expected = (re.split(r"(\d[\d.]*\d|\d)", "\n".join(each.reasons)) for each in (online, offline))
    assert said[::2] == expected[::2]
    assert [float(each) for each in said[1::2]] == pytest.approx([float(each) for each in expected[1::2]], rel=0.03)


@pytest.mark.parametrize("factor", [1e3, 1e60, 1e140])
def test_no_reason_holds_a_number_without_end(factor: float) -> None:
    """A model that has nothing to do with the output fits it worse than any number tells."""
    u, y = live_fakes.record(500)
    identifier = rp.Identifier(**vars(live_fakes.REQUEST))
    identifier.update_many(u, y)
    identifier.freeze()
    identifier.update_many(factor * u, y)
    reasons = identifier.assess().reasons
    assert any("fit below -1000 %" in reason for reason in reasons)
    assert not any(re.search(r"[\d,]{15}", reason) for reason in reasons)
