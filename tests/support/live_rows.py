"""A record of two inputs, what learned it, and a view of that."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import replant as rp
from replant.live.make_view import EstimateHistory, make_view
from replant.live.streams import Signals
from replant.live.view import SessionInfo, View
from support.rows import ASKED, DT, FAST, SLOW, noisy, row_of, toggling

HEATERS = Signals(("Q1", "Q2"), "T1")
NAMES = ("a1.Q1", "a0.Q1", "b0.Q1", "a0.Q2", "b0.Q2")
U = toggling(3, samples=3000)
Y = noisy(3, row_of(U, FAST, SLOW))
T = DT * np.arange(len(U))


def fresh(**other: Any) -> Any:
    """Return an identifier without a sample."""
    return rp.Identifier(**{**ASKED, "dt": DT, "input_names": HEATERS.inputs, **other})


@functools.cache
def _learned() -> Any:
    identifier = fresh()
    identifier.update_many(U, Y, T)
    return identifier


def learned() -> Any:
    """Return an identifier that took the record at once."""
    return _learned().clone()


@functools.cache
def seen() -> View:
    """Return the view of what took the record."""
    identifier = learned()
    info, names = SessionInfo(at=float(T[-1]), source="fake://", source_state="connected"), Signals(("Q1",), "T1")
    found = make_view(identifier, info, EstimateHistory(5), signals=names)
    assert identifier.to_bytes() == learned().to_bytes(), "looking changed the identifier"
    return found
