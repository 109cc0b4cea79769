"""A long record whose newest samples contradict the estimate: it begins anew there; where they do not, it stays."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from support.builders import DT, binary
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy.controlled import published_loops

PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
STEADY, SAMPLES = 12_000, 22_000
NOISE = 0.7
"""Standard deviation of the noise, part of the output's: the residual hardly grows when the gain is a fifth off."""


def noise(kind: str, seed: int, samples: int = SAMPLES) -> np.ndarray:
    white = np.random.default_rng([seed, 1]).standard_normal(samples)
    return white if kind == "white" else lfilter([np.sqrt(1.0 - 0.8**2)], [1.0, -0.8], white)


def record(kind: str, gain: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A gain that changes after `STEADY` samples."""
    u = binary(seed, SAMPLES, 8)
    y = PLANT.simulate(u, DT)
    scale = NOISE * float(y.std())
    y[STEADY:] *= gain
    return u, y + scale * noise(kind, seed)


@every(("kind", "gain"), [("white", 0.75), ("white", 1.3), ("coloured", 0.75), ("coloured", 1.3)], quick=1)
def test_a_change_that_hardly_shows_in_the_residual_is_learned(kind: str, gain: float) -> None:
    """An estimate that remembers 12,000 samples would need as many again to come half of the way."""
    u, y = record(kind, gain, 1)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u, y)
    static = ident.transfer_function.num[-1] / ident.transfer_function.den[-1]
    std = float(np.sqrt(np.diag(ident.covariance)[2])) / ident.parameters[2]
    assert abs(static / (gain * 2.0 / 3.0) - 1.0) < 4.0 * std < 0.3
    assert ident.assess().status != "inconsistent"


@every("kind", ["white", "coloured"], quick=1)
def test_a_change_while_the_input_rests_is_learned_although_no_sample_before_it_is_kept(kind: str) -> None:
    """The kept samples alone show one model; the estimate knows more than these."""
    u = np.concatenate([binary(1, STEADY, 8), np.zeros(3000), binary(2, 8000, 8)])
    y = PLANT.simulate(u, DT)
    scale = NOISE * float(y[:STEADY].std())
    y[STEADY + 1000 :] *= 0.4  # the residual's power grows 1.7-fold, which raises no alarm
    ident = rp.Identifier(rp.Structure(2), DT, history=2000)
    ident.update_many(u, y + scale * noise(kind, 1, u.size))
    static = ident.transfer_function.num[-1] / ident.transfer_function.den[-1]
    assert abs(static / (0.4 * 2.0 / 3.0) - 1.0) < 0.2


@every("kind", ["white", "coloured"], quick=1)
@every("seed", range(3), quick=1)
def test_an_estimate_that_holds_keeps_its_whole_record(kind: str, seed: int) -> None:
    """Of some fifty reviews none begins anew: the chance of one is 1e-7, from the levels of the two tests."""
    u = binary(seed, 100_000, 8)
    y = PLANT.simulate(u, DT)
    y += NOISE * y.std() * noise(kind, seed, 100_000)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u, y)
    assert ident._state.record_began == 0


def test_a_frozen_estimate_is_not_reviewed() -> None:
    u, y = record("white", 1.3, 1)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u[:STEADY], y[:STEADY])
    ident.freeze()
    before = ident.parameters.copy()
    ident.update_many(u[STEADY:], y[STEADY:])
    assert (ident.parameters == before).all()


@pytest.mark.slow
def test_single_samples_and_a_checkpoint_come_to_the_same_review() -> None:
    u, y = record("white", 1.3, 1)
    whole = rp.Identifier(rp.Structure(2), DT)
    whole.update_many(u[:20_000], y[:20_000])
    parts = rp.Identifier(rp.Structure(2), DT)
    parts.update_many(u[:18_000], y[:18_000])
    parts = rp.Identifier.from_bytes(parts.to_bytes())
    for k in range(18_000, 20_000):
        parts.update(float(u[k]), float(y[k]))
    assert whole._state.changed_at > 0
    assert parts.to_bytes() == whole.to_bytes()


@every("run", [35, 46, 49], quick=1)
def test_an_estimate_that_has_run_away_is_solved_for_again(run: int) -> None:
    """The start-up takes the controller for the plant, and the recursion leaves for 1e8 and more within 100 samples."""
    loop = next(each for each in published_loops() if each.key == "K published analogue-coloured")
    measured = loop.record(run)
    ident = rp.Identifier(loop.structure, loop.dt)
    ident.update_many(measured.u[:2000], measured.y[:2000])
    np.testing.assert_allclose(ident.parameters, [0.5, 1.0, 1.0, 1.0], atol=0.2)
