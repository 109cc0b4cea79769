"""Each reason of the verdict in pairs: a record where it is the cause, and one that looks alike where it is not."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.assessment import Assessment
from support.loops import DT as LOOP_DT
from support.loops import closed_loop, coloured

# --- the reference follows the disturbances

FOLLOWS = "the reference follows the disturbances"
CONTROLLED = [1.0], [1.0, 1.4, 1.0]


def said(verdict: Assessment, words: str) -> bool:
    return words in " ".join(verdict.reasons)


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


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("late", [0, 1])  # samples by which the logger is late with the set-point
def test_a_few_set_points_follow_no_disturbance(late: int, *, jumps: bool) -> None:
    for seed in range(6):
        u, y, r = set_points(seed, jumps=jumps)
        seen = np.concatenate([np.full(late, r[0]), r[: r.size - late]])
        verdict = rp.fit(u, y, LOOP_DT, rp.Structure(2), reference=seen).verdict
        assert not said(verdict, FOLLOWS), (seed, verdict.reasons)


def test_what_is_made_from_the_output_does() -> None:
    for seed in range(6):
        u, y, r = set_points(seed, jumps=False)
        for wrong in (r - y, y):
            verdict = rp.fit(u, y, LOOP_DT, rp.Structure(2), reference=wrong).verdict
            assert said(verdict, FOLLOWS), (seed, verdict.reasons)
