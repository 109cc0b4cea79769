"""A first model of one pole and a dead time: what a record of few moves shows of the response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.data.rest import from_rest
from replant.errors import ReplantError
from replant.log import Log

MOST_SAMPLES = 1000  # samples that it is made from: evenly spaced ones of a longer record [samples]
TRIED = 12  # dead times that it tries beside 0, from a sample to a quarter of the record, by equal factors [count]


@dataclass(frozen=True)
class FirstModel:
    """A model that the verdict trusts.

    Attributes
    ----------
    delay : float
        Dead time in s.
    time_constant : float
        In s.
    fit : float
        Fit of the simulated output in percent.
    """

    delay: float
    time_constant: float
    fit: float


def first_model(u: FloatArray, y: FloatArray, dt: float) -> FirstModel | None:
    """Return the model of one pole and a dead time that explains ``y`` (K,) best; None where none is trusted.

    A step test moves the input once: no correlation is beyond chance, though a model explains all of the output.

    Examples
    --------
    >>> from replant.model.transfer_function import TransferFunction
    >>> u = np.where(np.arange(200) < 20, 0.0, 1.0)
    >>> y = TransferFunction([0.5], [2.0, 1.0], 3.0).simulate(u, 0.5)
    >>> found = first_model(u, y + 0.01 * np.random.default_rng(1).standard_normal(200), 0.5)
    >>> round(found.delay), round(found.time_constant)
    (3, 2)
    """
    from replant.offline.structure_search import search

    every = -(-u.size // MOST_SAMPLES)
    u, y, dt = u[::every], y[::every], dt * every
    u = np.where(np.isfinite(u), u, np.nan)
    if u.size < 2 * TRIED or not np.isfinite(u).any() or not np.nanmax(u) > np.nanmin(u):
        return None
    delays = dt * np.unique([0.0, *np.geomspace(1.0, u.size / 4, TRIED).round()])
    log = Log(u, y, dt)
    for begins in (lambda log: log, from_rest):  # of a step at once, its gain is known from rest alone
        try:
            found = search(begins(log), poles=1, zeros=0, delays=delays.tolist()).best
        except ReplantError:
            continue
        if found.verdict.status == "trusted":
            slowest = found.transfer_function.modes[0].time_constant
            return FirstModel(found.structure.delay, slowest, found.simulation.fit)
    return None
