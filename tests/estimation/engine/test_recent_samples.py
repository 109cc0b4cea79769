"""The newest samples of a ring, read in one pass, are those that are read signal by signal."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.recent_samples import RecentSamples, variance_of_input
from replant.estimation.engine.state import State

DT, KEPT = 0.02, 400
PLANT = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0])


def kept(samples: int, *, missing: int | None = None, gap: int | None = None, reference: bool = False) -> State:
    """Return the state of an identifier that has seen so many samples, and keeps 400 of them."""
    generator = np.random.default_rng(samples)
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 20 + 1), 20)[:samples]
    y = PLANT.simulate(u, DT) + 0.1 * generator.standard_normal(samples)
    t = np.arange(samples) * DT
    if missing is not None:
        y[missing] = np.nan
    if gap is not None:
        t[gap:] += 7.0
    identifier = rp.Identifier(rp.Structure(2, 1), DT, history=KEPT)
    identifier.update_many(u, y, t=t, r=u if reference else None)
    return identifier._state


@pytest.mark.parametrize(
    "given",
    [
        {"samples": 300},
        {"samples": 400},
        {"samples": 1170},
        {"samples": 1170, "missing": 1000},
        {"samples": 1170, "missing": 770},  # the oldest kept
        {"samples": 1170, "gap": 1000},
        {"samples": 1170, "gap": 770},  # before the oldest kept: of no interest
        {"samples": 1170, "reference": True},
    ],
)
@pytest.mark.parametrize("most", [1, 250, KEPT])
def test_one_pass_gives_the_same_record(given: dict[str, int], most: int) -> None:
    state = kept(**given)  # type: ignore[arg-type]
    found = RecentSamples.record_of(state, most, DT, "zoh")
    expected = RecentSamples.of(state, most).record(DT, "zoh", parted=True)
    for one, other in zip(vars(found).values(), vars(expected).values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("samples", [300, 1170])
@pytest.mark.parametrize("most", [1, 250])
def test_variance_of_the_newest_inputs(samples: int, most: int) -> None:
    state = kept(samples)
    np.testing.assert_allclose(variance_of_input(state, most), np.var(RecentSamples.of(state, most).input), rtol=1e-12)
