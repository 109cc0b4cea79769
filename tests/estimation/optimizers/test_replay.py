"""Replay: its defaults, its bounds, and what it does for the estimate.  (The buffer itself: kernels/test_step.py.)"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from support.builders import G1, identifier, record, true_parameters
from support.cases import every


@every(
    ("arguments", "named", "kind"),
    [
        ({"capacity": 0}, "capacity", ValueError),
        ({"capacity": 2**31}, "capacity", ValueError),
        ({"capacity": 1e3}, "capacity", TypeError),
        ({"capacity": "many"}, "capacity", TypeError),
        ({"batch_size": 0}, "batch_size", ValueError),
        ({"batch_size": 1.5}, "batch_size", TypeError),
        ({"warmup": -1}, "warmup", ValueError),
        ({"warmup": None}, "warmup", TypeError),
        ({"seed": -1}, "seed", ValueError),
        ({"seed": 2**63}, "seed", ValueError),
        ({"seed": 0.5}, "seed", TypeError),
    ],
    ids=repr,
)
def test_a_bad_replay_is_refused_by_name(arguments: dict[str, Any], named: str, kind: type[Exception]) -> None:
    with pytest.raises(kind, match=named) as caught:
        rp.Replay(**arguments)
    assert isinstance(caught.value, rp.ReplantError)
    assert "\n" not in str(caught.value)


def test_the_seed_alone_makes_the_draws() -> None:
    u, y = record(G1, seed=1, samples=300, dt=0.05, noise=0.1)

    def run(seed: int) -> np.ndarray:
        return identifier(replay=rp.Replay(capacity=64, batch_size=5, seed=seed)).update_many(u, y).parameters

    np.testing.assert_array_equal(run(3), run(3))
    assert (run(3) != run(4)).any()


def test_a_batch_of_one_is_no_replay() -> None:
    u, y = record(G1, seed=2, samples=200, dt=0.05, noise=0.1)
    plain, one = identifier(replay=None), identifier(replay=rp.Replay(capacity=9, batch_size=1, warmup=0))
    np.testing.assert_array_equal(plain.update_many(u, y).parameters, one.update_many(u, y).parameters)


def test_what_replay_is_for() -> None:
    """The article's claim: with the buffer the same gain comes closer to the plant in the same time, (21)."""
    u, y = record(G1, seed=3, samples=4000, dt=0.01, hold=60)

    def index(replay: rp.Replay | None) -> np.ndarray:
        ident = identifier(
            rp.Gradient(gain=2.0),
            structure=rp.Structure(1),
            dt=0.01,
            replay=replay,
            scaling=rp.Scaling(0.25, [0.05, 0.15]),
        )
        return ident.update_many(u, y).index(true_parameters(G1, 0))

    assert (index(rp.Replay(capacity=1000, batch_size=20)) < 0.5 * index(None)).all()
