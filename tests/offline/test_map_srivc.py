"""An estimate revised by a record too short to tell it alone."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.engine.record import Record
from replant.offline.map_srivc import revise
from replant.offline.refined import Refined
from support.builders import binary, true_parameters
from support.cases import every

DT, NOISE = 0.01, 0.01
#: A fast mode beside one of 20 s: the record lasts a tenth of that.
PLANT = rp.TransferFunction([8.0, 2.0], [1.0, 4.05, 0.2])
STRUCTURE = rp.Structure(2, 1)
BEFORE = true_parameters(PLANT, 1)
KNOWN = 0.002  # part to which the coefficients were known


def revised(true: np.ndarray, seed: int = 0, samples: int = 200, variance: float = NOISE**2) -> tuple[Refined, float]:
    """Return the estimate revised by a record of a plant that has become another one."""
    u = binary(seed, samples, 5)
    y = rp.TransferFunction(true[2:], [1.0, *true[:2]]).simulate(u, DT)
    y += NOISE * np.random.default_rng(seed).standard_normal(samples)
    old, std = np.concatenate([BEFORE, np.zeros(3)]), np.concatenate([KNOWN * BEFORE, np.zeros(3)])
    found = revise(STRUCTURE, Record(u, y, np.array([DT])), old, std, variance, 1e-3)
    assert found is not None
    return found


@every("factor", [0.5, 1.5])
@every("entry", [0, 2])
def test_what_the_record_tells_moves_and_what_it_does_not_stays(entry: int, factor: float) -> None:
    """The fast mode's coefficients are told within 2 s; the slow one's stay, as no record of 2 s could place them."""
    true = BEFORE.copy()
    true[entry] *= factor
    found, none = revised(true)
    away = np.abs(found.theta[:4] - true)
    std = np.sqrt(np.diag(found.covariance)[:4])
    assert none < 1e-3
    assert away[entry] < 0.05 * true[entry]
    assert (away < 4.0 * std).all()


def test_where_nothing_has_moved_nothing_moves() -> None:
    for seed in range(5):
        found, none = revised(BEFORE, seed)
        std = np.sqrt(np.diag(found.covariance)[:4])
        assert none > 0.1
        assert (np.abs(found.theta[:4] - BEFORE) < 4.0 * std).all()


def test_what_may_have_moved_is_said_to_be_uncertain() -> None:
    """A slow coefficient of which 2 s say next to nothing: its interval widens to what a jump would make of it."""
    true = BEFORE.copy()
    true[1] *= 1.5
    found, _ = revised(true)
    assert abs(found.theta[1] - true[1]) < 3.0 * np.sqrt(found.covariance[1, 1])


def test_a_long_record_outweighs_what_was_known() -> None:
    true = BEFORE * [1.5, 0.7, 0.6, 1.3]
    found, _ = revised(true, samples=8000)
    np.testing.assert_allclose(found.theta[:4], true, rtol=0.05)
    assert (np.sqrt(np.diag(found.covariance)[:4]) < 0.03 * true).all()


def test_an_unstable_estimate_is_no_prior() -> None:
    """Its output leaves float64 within the record, of which a test that failed would warn."""
    u = binary(0, 4000, 5)
    old = np.concatenate([[-800.0, 2.0], BEFORE[2:], np.zeros(3)])
    assert revise(STRUCTURE, Record(u, u, np.array([DT])), old, 0.1 * np.abs(old), 1.0, 1e-3) is None
