"""The free initial state of a step test with few samples of rest."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.fitting.other_causes import gain_from_rest
from replant.online.runs.run_log import judged_by_log
from replant.signals import prbs
from support.cases import every

REASON = "the initial state takes a part of the response"


def step_test(seed: int, before: float = 0.0) -> rp.FitResult:
    """The fit of a step test of 2 / (60 s + 1), an input before the record, under noise with a pole of .9."""
    return rp.fit(*step_record(seed, before), 1.0, poles=1)


def step_record(seed: int, before: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(400)
    for k in range(1, 400):
        noise[k] = 0.9 * noise[k - 1] + 0.436 * noise[k]
    u = np.concatenate([np.full(1200, before), np.zeros(12), np.ones(388)])
    y = rp.TransferFunction([2.0 / 60.0], [1.0, 1.0 / 60.0]).simulate(u, 1.0)
    return u[1200:], 20.0 + y[1200:] + 0.02 * noise


def test_a_gain_that_rest_refutes_is_not_trusted() -> None:
    """The one of 80 such records whose gain lies two standard deviations off, where others are known to a half."""
    found = step_test(59)
    assert found.verdict.status == "converging"
    assert found.verdict.reasons[0].startswith(REASON)
    assert "from rest the gain is 2, not 1.79" in found.verdict.reasons[0]
    assert found.verdict.reasons[1:]  # those of the model


def test_a_pass_over_the_log_says_so_too() -> None:
    log = rp.Log(*step_record(59), 1.0)
    verdict = judged_by_log(rp.run(log, poles=1), log).verdict
    assert verdict.status == "converging"
    assert verdict.reasons[0].startswith(REASON)


@every("seed", range(6))
def test_a_gain_that_rest_confirms_is_trusted(seed: int) -> None:
    assert step_test(seed).verdict.status == "trusted"


def test_where_a_step_at_once_leaves_the_gain_unknown_rest_is_asked_for_and_no_longer_record() -> None:
    u = np.append(0.0, np.ones(299))
    y = rp.TransferFunction([0.4], [1.0, 0.2]).simulate(u, 0.1)
    found = rp.fit(u, 20.0 + y + 0.02 * np.random.default_rng(1).standard_normal(300), 0.1, poles=1)
    assert found.verdict.status == "converging"
    assert found.verdict.reasons[0].startswith(REASON)
    assert not any("times" in reason for reason in found.verdict.reasons)
    assert rp.fit(rp.from_rest(rp.Log(u, 20.0 + y, 0.1)), poles=1).verdict.status == "trusted"


@every("seed", range(6))
def test_a_record_that_begins_in_motion_is_not_said_to_rest(seed: int) -> None:
    verdict = step_test(seed, before=0.5).verdict
    assert verdict.status == "trusted"
    assert not any(REASON in reason for reason in verdict.reasons)


def test_what_the_record_tells_by_itself_is_not_asked_of_rest() -> None:
    """Of an input that moves all the time the initial state takes little."""
    u = prbs(400, hold=5, seed=1)
    y = rp.TransferFunction([2.0 / 60.0], [1.0, 1.0 / 60.0]).simulate(u, 1.0)
    found = rp.fit(u, y + 0.02 * np.random.default_rng(0).standard_normal(400), 1.0, poles=1)
    assert found.record is not None
    assert found.covariance is not None
    assert gain_from_rest(found.structure, found.parameters * [1.0, 1.2], found.covariance, found.record) is None
