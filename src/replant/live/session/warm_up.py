"""Warm-up: compiles the kernels that a session needs before its first sample arrives."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable

import numpy as np

from replant.model.transfer_function import TransferFunction
from replant.online.identifier import Identifier
from replant.settings import Request

EXPLAIN_AFTER = 3.0
"""Time after which the wait is explained [s]."""

STARTUP, SAMPLES = 500, 1200
"""Samples of the warm-up's start-up, and of all of it: enough for a first model, and for the record to be solved again
[samples].
"""


def warm_up(request: Request, say: Callable[[str], None]) -> None:
    """Compile the kernels of a session by identifying a simulated plant, with and without time stamps.

    Parameters
    ----------
    request : Request
        The settings of the session.
    say : callable
        Called with a line of text if compiling takes long, or if the kernels cannot be stored on disk.
    """
    from replant.kernels.codegen.decorators import TROUBLE

    waiting = threading.Timer(EXPLAIN_AFTER, say, ["replant: compiling (once): up to a minute"])
    waiting.daemon = True
    waiting.start()
    try:
        _identify(dataclasses.replace(request, startup=STARTUP))
    finally:
        waiting.cancel()
    if TROUBLE:
        say(f"replant: the compiled kernels cannot be stored ({TROUBLE[0]}): the next start compiles them again")


def _identify(request: Request) -> None:
    u, y = _simulated_record(request)
    identifier = Identifier(**vars(request))
    identifier.update_many(u, y)
    identifier.finish()
    identifier.update_many(u[:2], y[:2])
    identifier.update_many(u[:2], y[:2], request.dt * np.arange(1, 3))


def _simulated_record(request: Request) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output of a plant of the requested structure, with real poles well below the sampling rate."""
    structure, dt = request.structure, request.dt
    speeds = np.geomspace(0.05, 0.2, structure.poles) / dt
    zeros = np.geomspace(0.07, 0.3, structure.zeros) / dt
    den, num = np.poly(-speeds), np.atleast_1d(np.poly(-zeros))
    plant = TransferFunction(np.asarray(num * den[-1] / num[-1]), np.asarray(den))
    generator = np.random.default_rng(0)
    u = 2.0 + np.repeat(generator.choice([-1.0, 1.0], SAMPLES // 8), 8)
    mapped = np.asarray(request.preprocess.map_input(u))
    return u, plant.simulate(mapped, dt) + 0.01 * generator.standard_normal(u.size)
