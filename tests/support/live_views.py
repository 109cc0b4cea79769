"""Views of the record in `live_fakes`, and a message."""

from __future__ import annotations

import functools

import numpy as np

import replant as rp
from replant.live.make_view import EstimateHistory, make_view
from replant.live.outputs.message import EstimateMessage
from replant.live.view import SessionInfo, View
from support.live_fakes import DT, PLANT, REQUEST, record

FIRST_ORDER = rp.Structure(1)


@functools.cache
def viewed(samples: int, structure: rp.Structure = FIRST_ORDER, t: tuple[float, ...] | None = None) -> View:
    u, y = record(max(samples, 1))
    identifier = rp.Identifier(**{**vars(REQUEST), "structure": structure})
    identifier.update_many(u[:samples], y[:samples], None if t is None else np.array(t))
    before = identifier.to_bytes()
    found = make_view(
        identifier, SessionInfo(at=samples * DT, source="fake://", rate=20.0), EstimateHistory(structure.size)
    )
    assert identifier.to_bytes() == before, "looking changed the identifier"
    return found


def resting_view() -> View:
    """A view of a trusted model whose input has come to rest."""
    u = np.concatenate([record(3000)[0], np.full(2000, 3.0)])
    y = 7.0 + PLANT.simulate(u - 3.0, DT) + 0.02 * np.random.default_rng(5).standard_normal(u.size)
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    return make_view(identifier, SessionInfo(at=u.size * DT, source="fake://"), EstimateHistory(2))


def estimate(sequence: int | None = 3) -> EstimateMessage:
    values = np.array([0.1 + 0.2, np.nan]), np.array([1e-300, np.nan])
    return EstimateMessage(0.25, sequence, 4, ("a0", "b0"), *values, "starting", "converging", excited=True)
