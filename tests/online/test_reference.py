"""A reference: kept beside each sample, the same bits however they come, and with every one or none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.estimation.engine.dimensions import RECENT
from replant.kernels.schema import LARGEST
from replant.online.ensemble import Ensemble
from support.cases import every
from support.loops import closed_loop

DT, STARTUP, SAMPLES = 0.05, 100, 1000
PLANT, STRUCTURE = rp.TransferFunction([2.0], [1.0, 0.5]), rp.Structure(1)
NO_USE: dict[str, dict[str, Any]] = {
    "gradient": {"optimizer": "amsgrad"},
    "tracking": {"optimizer": rp.KalmanTracking(1e-3)},
    "fixed filter": {"filter": rp.StateVariableFilter(3.0)},
    "no instruments": {"instruments": False},
}


def made(**changes: Any) -> rp.Identifier:
    return rp.Identifier(STRUCTURE, DT, startup=STARTUP, **changes)


def measured(samples: int = SAMPLES) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Input, output, stamps and reference; one that no other number of the record is equal to."""
    generator = np.random.default_rng(5)
    u = np.repeat(generator.choice([-1.0, 1.0], -(-samples // 8)), 8)[:samples]
    y = PLANT.simulate(u, DT) + 0.02 * generator.standard_normal(samples)
    return u, y, DT * np.arange(samples), 100.0 + np.arange(samples)


def garbled() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same with what can happen to a sample: not finite, outliers, leaps of input and time, a gap, a clock set."""
    u, y, t, r = measured()
    u[[3, 250]], y[[5, 400]], t[[7, 410]], r[[9, 300, 301]] = (
        np.nan,
        (np.nan, 1e3),
        (np.inf, 0.0),
        (np.inf, np.nan, 1e200),
    )
    u[500] = 1e9  # misread
    u[520:523] = 1e5  # a move
    t[600:] += 70 * DT  # a gap, whose first sample is held back
    t[700] += 1e6  # misread
    t[800:] -= 500.0  # the clock was set
    return u, y, t, r


def one_by_one(ident: rp.Identifier, *signals: np.ndarray) -> None:
    u, y, *others = (signal.tolist() for signal in signals)
    for k in range(len(u)):
        t, r = (others[0][k], others[1][k]) if len(others) > 1 else (None, others[0][k])
        ident.update(u[k], y[k], t, r)


@pytest.mark.slow
@every("stamped", [False, True])
def test_single_samples_and_chunks_of_any_size_give_the_same_bits(stamped: bool) -> None:
    u, y, t, r = garbled()
    whole, loop, parts = made(), made(), made()
    if stamped:
        whole.update_many(u, y, t, r)
        one_by_one(loop, u, y, t, r)
    else:
        whole.update_many(u, y, r=r)
        one_by_one(loop, u, y, r)
    for part in np.split(np.arange(SAMPLES), [1, 60, 61, 299, 301, 521, 601, 702]):
        parts.update_many(u[part], y[part], t[part] if stamped else None, r[part])
    assert whole.reference
    assert whole.to_bytes() == loop.to_bytes() == parts.to_bytes()


@pytest.mark.slow
@every("samples", [601, 50, 300], quick=1)
def test_a_checkpoint_continues_to_the_bit(samples: int) -> None:
    """While a sample is held back, during the start-up, and between two solutions."""
    u, y, t, r = garbled()
    begun = made()
    begun.update_many(u[:samples], y[:samples], t[:samples], r[:samples])
    saved = begun.to_bytes()
    later = rp.Identifier.from_bytes(saved)
    assert later.to_bytes() == saved
    for each in (begun, later):
        each.update_many(u[samples:], y[samples:], t[samples:], r[samples:])
    assert later.to_bytes() == begun.to_bytes()


def test_every_sample_keeps_its_own() -> None:
    """Also those of the start-up, those that were held back, and after the record was solved again."""
    u, y, t, r = measured()
    t[600:] += 70 * DT
    ident = made()
    ident.update_many(u[:60], y[:60], t[:60], r[:60])
    np.testing.assert_array_equal(ident.recent_reference, r[:60])
    ident.update_many(u[60:], y[60:], t[60:], r[60:])
    np.testing.assert_array_equal(ident.recent_reference, r)
    assert (ident.samples, ident.rejected["time leap"]) == (SAMPLES, 0)
    assert ident.settings is not None
    assert ident.settings.reference


@pytest.mark.slow
def test_more_samples_than_are_kept() -> None:
    u, y, _, r = measured(RECENT + 700)
    ident = made()
    ident.update_many(u, y, r=r)
    np.testing.assert_array_equal(ident.recent_reference, r[-RECENT:])
    assert ident.recent.shape == (RECENT, 3)


@every("value", [np.nan, np.inf, -np.inf, 2.0 * LARGEST])
def test_one_that_cannot_be_used_is_held_at_the_last_and_counted(value: float) -> None:
    u, y, _, r = measured(400)
    spoiled = r.copy()
    spoiled[[200, 201, 300]] = value
    ident = made()
    ident.update_many(u, y, r=spoiled)
    r[[200, 201, 300]] = r[[199, 199, 299]]
    np.testing.assert_array_equal(ident.recent_reference, r)
    assert (ident.samples, ident.rejected["no reference"]) == (400, 3)


@pytest.mark.parametrize(("value", "reason"), [(np.nan, "not finite"), (np.inf, "not finite"), (1e200, "too large")])
def test_before_the_first_one_that_can_be_used_the_sample_is_rejected(value: float, reason: str) -> None:
    u, y, _, r = measured(300)
    r[[0, 1, 40]] = value
    ident = made()
    ident.update_many(u, y, r=r)
    assert (ident.samples, ident.rejected[reason], ident.rejected["no reference"]) == (298, 2, 1)
    r[40] = r[39]
    np.testing.assert_array_equal(ident.recent_reference, r[2:])


def test_a_sample_that_is_rejected_leaves_none_behind() -> None:
    u, y, _, r = measured()
    ident = made()
    ident.update_many(u[:300], y[:300], r=r[:300])
    ident.update(np.nan, 1.0, r=7.0)
    ident.update(u[300], y[300], r=np.nan)
    assert ident.recent_reference[-1] == r[299]


@every("taken", [1, STARTUP - 1, STARTUP, 300])
@every("first", [False, True])
def test_with_every_sample_or_with_none(first: bool, taken: int) -> None:
    u, y, _, r = measured()
    ident = made()
    ident.update_many(u[:taken], y[:taken], r=r[:taken] if first else None)
    before = ident.to_bytes()
    others: list[Callable[[], object]] = [
        lambda: ident.update(1.0, 1.0, 1e3, r=None if first else 1.0),
        lambda: ident.update_many(u, y, 1e3 + DT * np.arange(SAMPLES), r=None if first else r),
    ]
    for other in others:
        with pytest.raises(InvalidArgumentError, match="give it with every sample, or with none") as caught:
            other()
        assert "\n" not in str(caught.value)
        assert ident.to_bytes() == before
    assert ident.reference == first


def test_a_first_sample_that_is_rejected_decides_too() -> None:
    ident = made()
    ident.update(np.nan, 0.0)
    with pytest.raises(InvalidArgumentError, match="came without r"):
        ident.update(1.0, 0.0, r=1.0)
    ident.reset()
    ident.update(np.nan, 0.0, r=1.0)
    with pytest.raises(InvalidArgumentError, match="came with r"):
        ident.update(1.0, 0.0)
    assert rp.Identifier.from_bytes(ident.to_bytes()).reference


def test_an_empty_chunk_decides_nothing() -> None:
    ident = made()
    ident.update_many([], [], r=[])
    ident.update_many([], [])
    assert not ident.reference
    ident.update(1.0, 0.0)


@every("name", NO_USE)
def test_what_cannot_use_it_says_so(name: str) -> None:
    u, y, _, r = measured()
    ident = made(**NO_USE[name])
    before = ident.to_bytes()
    for give in (lambda: ident.update(1.0, 1.0, r=1.0), lambda: ident.update_many(u, y, r=r)):
        with pytest.raises(InvalidArgumentError, match="only the refined filter with recursive least squares"):
            give()
    assert ident.to_bytes() == before


@pytest.mark.parametrize(
    "changes", [{}, {"filter": rp.RefinedFilter()}, {"optimizer": rp.RecursiveLeastSquares(time_constant=20.0)}]
)
def test_what_can_use_it_takes_it(changes: dict[str, Any]) -> None:
    u, y, _, r = measured(300)
    ident = made(**changes)
    ident.update_many(u, y, r=r)
    np.testing.assert_array_equal(ident.recent_reference, r)


@pytest.mark.parametrize(
    ("r", "kind", "words"),
    [
        (np.zeros(3), InvalidArgumentError, "r must have one value for each of 1000 samples, got 3"),
        (np.zeros((SAMPLES, 1)), InvalidArgumentError, "r must be a vector"),
        (["a"] * SAMPLES, ArgumentTypeError, "r must hold real numbers"),
    ],
)
def test_other_shapes_and_types_touch_nothing(r: Any, kind: type[Exception], words: str) -> None:
    u, y, _, _ = measured()
    ident = made()
    before = ident.to_bytes()
    with pytest.raises(kind, match=words):
        ident.update_many(u, y, r=r)
    with pytest.raises(ArgumentTypeError, match="r must be a number"):
        ident.update(1.0, 1.0, r="a")  # type: ignore[arg-type]
    with pytest.raises(ArgumentTypeError, match="t must be a number"):
        ident.update(1.0, 1.0, "a", 1.0)  # type: ignore[arg-type]
    assert ident.to_bytes() == before
    ident.update(1.0, 1.0)


@pytest.mark.slow
def test_an_unstable_plant_that_is_learned_is_trusted_with_a_reference_alone() -> None:
    """1/(s - 1) under a gain of three and a load that wanders."""
    generator = np.random.default_rng(0)
    r = np.repeat(generator.uniform(-1.0, 1.0, 200), 20)
    load = 0.1 * lfilter([1.0], [1.0, -0.95], generator.standard_normal(r.size))
    u, y = closed_loop([1.0], [1.0, -1.0], (3.0, 0.0), DT, r, load, np.zeros(r.size))
    alone, ident = rp.Identifier(STRUCTURE, DT), rp.Identifier(STRUCTURE, DT)
    alone.update_many(u, y)
    ident.update_many(u, y, r=r)
    assert ident.assess().status == "trusted"
    assert ident.uncertainty is not None
    assert (np.abs(ident.parameters - [-1.0, 1.0]) < 3.5 * ident.uncertainty.std).all()
    assert (ident.uncertainty.std < 0.06).all()
    assert alone.assess().status == "inconsistent"
    assert "only a reference can show" in " ".join(alone.assess().reasons)


def test_an_ensemble_refuses_it_by_name() -> None:
    u, y, _, r = measured(10)
    ident = made()
    ident.update_many(u, y, r=r)
    with pytest.raises(InvalidArgumentError, match="an ensemble knows no reference"):
        Ensemble([made(), ident])
    with pytest.raises(InvalidArgumentError, match="an ensemble knows no reference"):
        Ensemble(ident, 3)


def test_a_sample_without_its_reference_is_one_that_was_used() -> None:
    u, y, _, r = measured()
    r[300:310] = np.nan
    found = rp.run(u, y, DT, STRUCTURE, reference=r)
    assert (found.rejected["no reference"], found.used) == (10, SAMPLES)
