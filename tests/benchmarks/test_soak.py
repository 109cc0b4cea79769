"""Rig time with faults, in small: what `make soak` runs for 1,000 hours."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from soak.faults import FAULTS
from soak.rig import DT, Rig
from soak.rig_time import LIMIT, WRONG, Episode, broken, table, watched


def a_rig(seed: int = 0) -> Rig:
    return Rig(np.random.default_rng(seed))


def test_a_rig_goes_on_where_it_was() -> None:
    whole, parts = a_rig(), a_rig()
    whole.noise = parts.noise = 0.0
    whole.held = parts.held = 0.7
    joined = [parts.take(samples) for samples in (1, 7, 92)]
    for one, other in zip(whole.take(100), zip(*joined, strict=True), strict=True):
        np.testing.assert_allclose(one, np.concatenate(other), rtol=1e-9)


@every("seed", range(6))
def test_the_error_is_that_of_the_gain_where_the_input_excites(seed: int) -> None:
    rig = a_rig(seed)
    before = rig.plant
    assert rig.error(before) == pytest.approx(0.0, abs=1e-9)
    rig.change(gain=1.25)
    assert rig.error(before) == pytest.approx(0.2)
    rig.change(gain=0.8, speed=2.0)
    assert rig.error(before) > WRONG


@every("name", FAULTS)
def test_every_fault_arrives_and_ends(name: str) -> None:
    rig = a_rig(1)
    lasts, fault = FAULTS[name](rig)
    u, y, t = fault(rig.take(4000))
    assert 0 < u.size == y.size == t.size <= 4000
    assert lasts >= 0.0


@pytest.mark.slow
def test_no_wrong_model_is_trusted_for_long() -> None:
    watch = watched(0, seed=0, hours=0.4, names=iter(["gain_change", "stuck", "garbled", "restart"] * 2))
    assert len(watch.episodes) >= 1
    assert broken(watch.episodes) == []
    assert watch.identifier.samples > 1200.0 / DT


def test_a_model_that_stays_wrong_and_trusted_is_told() -> None:
    episode = Episode("gain_change", 0, 100.0, 0.0, noticed=None, wrong=2.0 * LIMIT, worst=0.5)
    assert len(broken([episode])) == 1
    assert "gain change" in table([episode])
