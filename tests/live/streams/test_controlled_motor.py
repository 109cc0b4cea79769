"""The motor under its controller: plant and controller are as documented; the samples are endless and reproducible."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from replant.errors import InvalidArgumentError
from replant.live.streams import Batch, demo, open_source
from replant.live.streams.demo import (
    _LOOP_BLOCK,
    DITHER,
    HIGHEST,
    INTEGRAL,
    LOAD,
    LOAD_TIME,
    LOWEST,
    PROPORTIONAL,
    controlled,
)
from replant.rigs import motor_rig
from support.cases import every

RIG = motor_rig()
URL = "demo?speed=max&loop=pi"


def blocks(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    _, u, y, r = zip(*itertools.islice(controlled(seed), count), strict=True)
    return np.concatenate(u), np.concatenate(y), np.concatenate(r)


def first(count: int, seek: int | None = None) -> list[np.ndarray]:
    source = open_source(URL)
    if seek is not None:
        source.seek(seek)
    batches: list[Batch] = []
    for batch in source.batches():
        batches += [batch] if len(batch) else []
        if sum(map(len, batches)) >= count:
            break
    source.close()
    names = ("u", "y", "r", "t", "sequence")
    return [np.concatenate([getattr(batch, name) for batch in batches])[:count] for name in names]


def test_the_controller_is_the_documented_one() -> None:
    """Over the seams between blocks, too."""
    u, y, r = blocks(3)
    error = r - y
    steps = PROPORTIONAL * np.diff(error) + INTEGRAL * RIG.dt * error[:-1]
    np.testing.assert_allclose(np.diff(u), steps, rtol=0.0, atol=1e-9)
    assert u[0] == pytest.approx(PROPORTIONAL * error[0])


def test_the_plant_is_the_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "LOAD", 0.0)
    monkeypatch.setattr(demo, "motor_rig", lambda: motor_rig(noise=0.0))
    u, y, _ = blocks(3)
    np.testing.assert_allclose(y, RIG.plant.simulate(u, RIG.dt), rtol=0.0, atol=1e-8)


def test_load_and_noise_have_the_documented_size() -> None:
    """Their effect on the output: the gain is 10 at low frequency, and the load is as slow as the plant."""
    u, y, _ = blocks(30)
    disturbance = y - RIG.plant.simulate(u, RIG.dt)
    assert np.diff(disturbance, 4).std() / np.sqrt(70.0) == pytest.approx(RIG.noise, rel=0.05)  # 1 + 16 + 36 + 16 + 1
    # a Markov process through 10 / (0.5 s + 1): half its power is left where the time constants are equal
    assert -1.0 / RIG.plant.poles.max() == LOAD_TIME
    assert disturbance.std() == pytest.approx(10.0 * LOAD / np.sqrt(2.0), rel=0.15)  # of 1200 correlation times


def test_the_speed_follows_a_set_point_that_moves() -> None:
    _, y, r = blocks(10)
    assert LOWEST - DITHER <= r.min() < LOWEST + 5.0
    assert HIGHEST - 5.0 < r.max() <= HIGHEST + DITHER
    assert np.corrcoef(y[1000:], r[1000:])[0, 1] > 0.9
    assert np.count_nonzero(np.diff(r)) > r.size / 20  # it never rests


@every("after", [-1, 0, 99, _LOOP_BLOCK - 1, _LOOP_BLOCK + 77])
def test_it_goes_on_after_any_number_to_the_bit(after: int) -> None:
    whole = first(_LOOP_BLOCK + 300)
    for all_of_it, later in zip(whole, first(200, seek=after), strict=True):
        np.testing.assert_array_equal(later, all_of_it[after + 1 : after + 201])
    np.testing.assert_array_equal(whole[3], whole[4] * RIG.dt)


def test_seeds_and_blocks_differ() -> None:
    parts = [block for seed in (0, 1) for block in itertools.islice(controlled(seed), 2)]
    for (_, *some), (_, *others) in itertools.combinations(parts, 2):
        assert all(abs(np.corrcoef(np.diff(a), np.diff(b))[0, 1]) < 0.2 for a, b in zip(some, others, strict=True))


def test_the_actuator_has_no_reference() -> None:
    source = open_source("demo?speed=max")
    assert next(filter(len, source.batches())).r is None
    source.close()


def test_another_loop_is_refused() -> None:
    with pytest.raises(InvalidArgumentError, match="loop must be one of none, pi"):
        open_source("demo?loop=pid")
