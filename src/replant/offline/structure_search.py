"""Search for the structure: poles, zeros and dead time of a grid, compared on samples that were not fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.arguments import FloatArray, record, vector, whole
from replant.assessment import fit_percent, simulate
from replant.engine.record import ready_record
from replant.errors import InvalidArgumentError
from replant.model.structure import Structure
from replant.offline.fit import FitResult, fit
from replant.regressor.preprocess import Preprocess, screen
from replant.simulation.prediction import prediction_error, runs_away
from replant.statistics.linear_algebra import quiet

TRAINED = 0.7
"""Part of the record that models are fitted to; the rest is held out [share].
Origin: a rule of thumb of cross validation.
Sensitivity: not measured.
"""

ENOUGH = 0.5
"""Held-out fit that more parameters must bring to be worth having [%].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One structure that was tried.

    Attributes
    ----------
    structure : Structure
    held_out : float
        Simulated fit in percent over the part of the record that was not fitted, with offset and initial state
        estimated; of an unstable model, which would run away, the fit of the output predicted one step ahead.
    criterion : float
        Bayesian information criterion of the part that was fitted, K ln(variance) + P ln(K): smaller is better.
    """

    structure: Structure
    held_out: float
    criterion: float


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of a search.

    Attributes
    ----------
    best : FitResult
        The fit of the chosen structure to the whole record.
    candidates : tuple of Candidate
        All that were tried, in the order of the grid.
    """

    best: FitResult
    candidates: tuple[Candidate, ...]


def search(
    u: Any,
    y: Any,
    dt: float,
    *,
    poles: Iterable[int],
    zeros: Iterable[int] | None = None,
    delays: Iterable[float] = (0.0,),
    bias: bool = False,
    preprocess: Preprocess = Preprocess(),  # noqa: B008 - frozen
    reference: Any = None,
) -> SearchResult:
    """Fit every structure of a grid by refined instrumental variables, and choose one.

    Each structure is fitted to the first 70 % of the record and simulated over the rest.  Of the structures within half
    a point of the best held-out fit the one with the fewest parameters is chosen; of several, the one with the least
    information criterion.

    Parameters
    ----------
    u, y : (K,) arrays
        Raw input and output.
    dt : float
        Sampling time in s.
    poles : iterable of int
        Numbers of poles to try.
    zeros : iterable of int, optional
        Numbers of zeros to try; by default all below the number of poles.
    delays : iterable of float
        Dead times to try, in s.
    bias : bool
        Whether a bias is identified.
    preprocess : Preprocess
        Input map and working point.
    reference : (K,) array, optional
        Where a controller makes the input, see `fit`.

    Raises
    ------
    InvalidArgumentError
        If no structure of the grid is possible, or none gives a model.

    Examples
    --------
    >>> from replant.signals import prbs, white_noise
    >>> u = prbs(2000, hold=8)
    >>> y = Structure(poles=2).transfer_function([4.0, 3.0, 2.0]).simulate(u, 0.05) + white_noise(2000, 0.05)
    >>> found = search(u, y, 0.05, poles=(1, 2, 3))
    >>> found.best.structure.poles
    2

    References
    ----------
    Ljung (1999), "System Identification: Theory for the User", section 16.4.
    """
    u, y = record(u, y)
    split = int(TRAINED * u.size)
    grid = _grid(poles, zeros, delays, bias)
    r = None if reference is None else vector("reference", reference)
    candidates = tuple(_try(structure, u, y, r, dt, split, preprocess) for structure in grid)
    usable = [candidate for candidate in candidates if math.isfinite(candidate.held_out)]
    if not usable:
        raise InvalidArgumentError("no structure of the grid explains this record: does the input move the output?")
    limit = max(candidate.held_out for candidate in usable) - ENOUGH
    near = [candidate for candidate in usable if candidate.held_out >= limit]
    chosen = min(near, key=lambda candidate: (_parameters(candidate.structure), candidate.criterion))
    return SearchResult(fit(u, y, dt, chosen.structure, preprocess=preprocess, reference=r), candidates)


def _grid(poles: Iterable[int], zeros: Iterable[int] | None, delays: Iterable[float], bias: bool) -> list[Structure]:
    delays, allowed = tuple(delays), None if zeros is None else tuple(zeros)
    grid = [
        Structure(n, m, delay, bias)
        for n in (whole("poles", n, 1) for n in poles)
        for m in (range(n) if allowed is None else allowed)
        if m < n
        for delay in delays
    ]
    if not grid:
        raise InvalidArgumentError("the grid holds no possible structure: zeros must be fewer than poles")
    return grid


@quiet
def _try(
    structure: Structure,
    u: FloatArray,
    y: FloatArray,
    r: FloatArray | None,
    dt: float,
    split: int,
    preprocess: Preprocess,
) -> Candidate:
    first = None if r is None else r[:split]
    try:
        fitted = fit(u[:split], y[:split], dt, structure, method="srivc", preprocess=preprocess, reference=first)
    except InvalidArgumentError:  # the record is too short for this structure, or the fit found no model
        return Candidate(structure, -math.inf, math.inf)
    model, mapped = fitted.transfer_function, fitted.preprocess.map_input(u)
    # inputs from before the held-out part act on it through the dead time: they are simulated, their outputs left out
    start = max(split - math.ceil(structure.delay / dt), 0)
    unseen = np.where(np.arange(start, y.size) < split, np.nan, y[start:])
    if runs_away(model.den, split * dt):
        held_out = _predicted(fitted, u[start:], y[start:], split - start)
    else:
        held_out = simulate(model, mapped[start:], unseen, dt).fit
    residual = y[:split] - fitted.simulation.output
    residual = residual[np.isfinite(residual)]
    variance = float(np.mean(residual**2)) if residual.size else 0.0
    tiny = np.finfo(float).tiny
    criterion = residual.size * math.log(max(variance, tiny)) + _parameters(structure) * math.log(split)
    return Candidate(structure, held_out, criterion)


def _predicted(fitted: FitResult, u: FloatArray, y: FloatArray, skipped: int) -> float:
    """Return the fit in percent of the output predicted one step ahead, over the samples (K,) but the first ones."""
    ready = ready_record(fitted.structure, fitted.dt, fitted.preprocess, u, y)
    error = prediction_error(fitted.structure, fitted.parameters, ready, fitted.dt)
    if error is None:
        return -math.inf
    accepted, _ = screen(fitted.preprocess.map_input(u), y)
    output = np.where(accepted, y, np.nan)
    output[accepted] -= error
    return fit_percent(y[skipped:], output[skipped:])


def _parameters(structure: Structure) -> int:
    """Return the number of parameters, a dead time counted as one."""
    return structure.size + bool(structure.delay)
