"""Larger noise is no reason for distrust; a plant that changes at the same sample is."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.verdict.verdict import Verdict
from support.builders import DT, binary
from support.cases import every

SAMPLES, CHANGED = 4000, 3000
PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])


def verdict(way: str, seed: int, gain: float, noise: float) -> Verdict:
    """Return what is said of a record, in whose last quarter gain and noise are multiplied."""
    u, since = binary(seed, SAMPLES, 8), np.arange(SAMPLES) >= CHANGED
    y = PLANT.simulate(u, DT)
    scale = 0.05 * y.std()
    y = np.where(since, gain * y, y)
    y += scale * np.where(since, noise, 1.0) * np.random.default_rng([seed, 1]).standard_normal(SAMPLES)
    if way == "fit":
        return rp.fit(u, y, DT, poles=2).verdict
    ident = rp.Identifier(poles=2, dt=DT)
    ident.update_many(u, y)
    return ident.assess()


@every("way", ["fit", "online"])
@every("seed", range(4), quick=1)
def test_a_right_model_is_trusted_though_the_noise_has_tripled(way: str, seed: int) -> None:
    assert verdict(way, seed, gain=1.0, noise=3.0).status == "trusted"


@every("seed", range(4), quick=1)
def test_a_mean_of_two_plants_is_not_trusted(seed: int) -> None:
    assert verdict("fit", seed, gain=1.3, noise=1.0).status == "inconsistent"
