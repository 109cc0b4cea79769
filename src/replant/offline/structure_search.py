"""Search for the structure: poles, zeros and dead time of a grid, compared on samples that were not fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from replant.arguments import FloatArray, increasing, record, vector, whole
from replant.assessment import simulate
from replant.engine.record import SAME, gaps_of, ready_record
from replant.errors import InvalidArgumentError
from replant.limits import MOST_TRIED, dead_time, duration, several
from replant.model.dead_time import unknown_outputs
from replant.model.structure import Structure
from replant.offline.fit import fit
from replant.offline.fit_result import FitResult
from replant.offline.samples import Samples
from replant.regressor.filters import RefinedFilter
from replant.regressor.preprocess import Preprocess, screen
from replant.simulation.prediction import prediction_error, runs_away
from replant.statistics.linear_algebra import quiet, real_coefficients
from replant.statistics.robust import without_spikes

TRAINED = 0.7
"""Part of the record that models are fitted to; the rest is held out [share].
Origin: a rule of thumb of cross validation.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STRETCHES = 3
"""Stretches into which the part held out is cut, at each end of the record [count].
Derivation: each is then a tenth of the record; of six a standard error is known to a third.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ENOUGH = 0.5
"""Held-out fit that more parameters must bring to be worth having [%].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEAST_SHARED = 0.5
"""Share of the stretches that two structures must share to be compared [share].
Derivation: fewer than three differences have no standard error.
"""

MAY_BE_ABSENT = 1.0
"""Standard deviation of a coefficient beyond which it may as well be absent, so that poles or zeros are too many [part
of its size].
Derivation: its 68 % interval then holds zero.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PRECISION = 0.01
"""Precision to which the dead time is found between the points of the grid [sampling times].
Derivation: finer than data tell: a hundredth of a sample moves the output by a hundredth of what it does in one.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One structure that was tried.

    Attributes
    ----------
    structure : Structure
    held_out : float
        Simulated fit in percent over the first and the last 30 % of the record, each by a model of the rest, with
        offset and initial state estimated; of an unstable model, which would run away, the fit of the output predicted
        one step ahead.  Minus infinity where there is no model.
    stretches : (S,) array
        Logarithm of the residual's power over each stretch held out.
    uncertainty : float
        Largest standard deviation of a coefficient of the models, as a part of its size.
    criterion : float
        Bayesian information criterion of the first 70 %, K ln(variance) + P ln(K): smaller is better.
    """

    structure: Structure
    held_out: float
    stretches: FloatArray
    uncertainty: float
    criterion: float

    @property
    def is_known(self) -> bool:
        """Whether no coefficient may as well be absent."""
        return self.uncertainty < MAY_BE_ABSENT

    def is_behind(self, best: Candidate) -> bool:
        """Return whether it predicts worse than the best one, by more than a standard error of the difference."""
        shared = np.isfinite(self.stretches) & np.isfinite(best.stretches)
        if shared.sum() < LEAST_SHARED * shared.size:
            return True
        worse = (self.stretches - best.stretches)[shared]
        return bool(worse.mean() > worse.std(ddof=1) / math.sqrt(worse.size))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of a search.

    Attributes
    ----------
    best : FitResult
        The fit of the chosen structure to the whole record, its dead time found between the points of the grid.
    chosen : Candidate
    candidates : tuple of Candidate
        All that were tried, in the order of the grid.
    """

    best: FitResult
    chosen: Candidate
    candidates: tuple[Candidate, ...]


def search(
    u: Any,
    y: Any = None,
    dt: float | None = None,
    *,
    poles: int | Iterable[int] = range(1, 5),
    zeros: int | Iterable[int] | None = None,
    delays: float | Iterable[float] = (0.0,),
    bias: bool = False,
    preprocess: Preprocess | None = None,
    reference: Any = None,
    t: Any = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SearchResult:
    """Fit every structure of a grid by refined instrumental variables, and choose one.

    Each structure is fitted to the first 70 % of the record and simulated over the rest, and to the last 70 %.  Those
    with a coefficient that is not known are left out, unless all are.  Of the structures that predict no worse than the
    best one, by a standard error over six stretches or by half a point of fit, the one with the fewest parameters is
    chosen; of several, the one with the least information criterion.  Its dead time is then found between the points of
    the grid, where that lowers the criterion.

    Parameters
    ----------
    u : (K,) array, Log or list of Log
        Raw input, or a log with input, output and sampling time; or several logs of one rig, which give one model.
    y : (K,) array
        Output.
    dt : float
        Sampling time in s.
    poles : int or iterable of int
        Numbers of poles to try.
    zeros : int or iterable of int, optional
        Numbers of zeros to try; by default all below the number of poles.
    delays : float or iterable of float
        Dead times to try, in s.
    bias : bool
        Whether a bias is identified.
    preprocess : Preprocess
        Input map and working point; see `fit`.
    reference : (K,) array, optional
        Where a controller makes the input, see `fit`.
    t : (K,) array, optional
        Time stamps in s, strictly increasing, of an irregular clock.
    progress : callable
        Called before each structure with how many were tried, of how many.

    Returns
    -------
    SearchResult
        Every structure tried, and the one chosen.

    Raises
    ------
    InvalidArgumentError
        If no structure of the grid is possible, or none gives a model.

    References
    ----------
    Ljung (1999), "System Identification: Theory for the User", section 16.4; Hastie, Tibshirani and Friedman (2009),
    "The Elements of Statistical Learning", section 7.10 (the rule of one standard error).

    Examples
    --------
    >>> from replant.signals import prbs, white_noise
    >>> u = prbs(2000, hold=8)
    >>> y = Structure(poles=2).transfer_function([4.0, 3.0, 2.0]).simulate(u, 0.05) + white_noise(2000, 0.05)
    >>> found = search(u, y, 0.05, poles=(1, 2, 3))
    >>> found.best.structure.poles
    2
    """
    given = Samples.of(u, y, dt, t, reference)
    preprocess = given.preprocess if preprocess is None else preprocess
    u, y = record(given.u, given.y)
    dt, delays = duration("dt", given.dt), sorted(set(several("delays", delays, dead_time)))
    grid = _grid(poles, zeros, delays, bias)
    r = None if given.reference is None else vector("reference", given.reference)
    stamps = None if given.t is None else increasing(given.t, u.size)
    tried, held = [], RefinedFilter(given.input_hold)
    for done, structure in enumerate(grid):
        progress(done, len(grid))
        tried.append(_try(structure, u, y, r, stamps, dt, preprocess, held))
    progress(len(grid), len(grid))
    usable = [candidate for candidate in tried if math.isfinite(candidate.held_out)]
    if not usable:
        raise InvalidArgumentError("no structure of the grid explains this record: does the input move the output?")
    usable = [candidate for candidate in usable if candidate.is_known] or usable
    best = max(usable, key=lambda candidate: candidate.held_out)
    near = [each for each in usable if each.held_out >= best.held_out - ENOUGH or not each.is_behind(best)]
    chosen = min(near, key=lambda candidate: (_parameters(candidate.structure), candidate.criterion))

    def fitted(delay: float) -> FitResult:
        structure = replace(chosen.structure, delay=delay)
        return fit(u, y, dt, structure, method="srivc", preprocess=preprocess, filter=held, t=stamps, reference=r)

    best_fit = given.named(_between_points(fitted, chosen.structure.delay, delays, dt))
    return SearchResult(best_fit, chosen, tuple(tried))


def _between_points(fitted: Callable[[float], FitResult], delay: float, delays: list[float], dt: float) -> FitResult:
    """Return the fit with the dead time, between the neighbours of one of the grid, that leaves least.

    The grid's own one stays unless another lowers the information criterion: unless K ln(variance) is less by ln(K).
    """
    from scipy import optimize  # slow to import

    at_point = fitted(delay)
    k = delays.index(delay)
    low, high = delays[max(k - 1, 0)], delays[min(k + 1, len(delays) - 1)]
    if not high > low:
        return at_point
    fits: dict[float, FitResult] = {}

    def left(tried: float) -> float:
        try:
            fits[tried] = fitted(tried)
        except InvalidArgumentError:  # no model with this one
            return math.inf
        return _variance(fits[tried])

    found = float(optimize.minimize_scalar(left, bounds=(low, high), options={"xatol": PRECISION * dt}).x)
    if found not in fits:
        return at_point
    gain = math.log(max(_variance(at_point), 1e-300) / max(_variance(fits[found]), 1e-300))
    return fits[found] if at_point.samples * gain > math.log(at_point.samples) else at_point


def _variance(fitted: FitResult) -> float:
    """Return the variance of the noise of a fit: of the innovation, where the noise model tells it."""
    noise = fitted.noise
    return math.inf if noise is None else float(noise.variance)


def _grid(poles: Any, zeros: Any, delays: Sequence[float], bias: bool) -> list[Structure]:
    numbers = several("poles", poles, partial(whole, least=1))
    allowed = None if zeros is None else several("zeros", zeros, partial(whole, least=0))
    orders = [Structure(n).poles for n in numbers]  # raises for too many
    if len(orders) * (len(allowed) if allowed else 1) * len(delays) > MOST_TRIED:
        raise InvalidArgumentError(f"the grid of poles, zeros and delays must have at most {MOST_TRIED} structures")
    grid = [
        Structure(n, m, delay, bias)
        for n in orders
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
    t: FloatArray | None,
    dt: float,
    preprocess: Preprocess,
    held: RefinedFilter,
) -> Candidate:
    """Fit a structure to either end's 70 % of a record, and hold the rest out."""
    trained, scored = int(TRAINED * u.size), _without_gross_outliers(y)
    errors, spreads, uncertainties, criteria = [], [], [], []
    for seen in (slice(0, trained), slice(u.size - trained, u.size)):
        more: dict[str, Any] = {
            name: None if signal is None else signal[seen] for name, signal in (("reference", r), ("t", t))
        }
        try:
            fitted = fit(u[seen], y[seen], dt, structure, method="srivc", preprocess=preprocess, filter=held, **more)
        except InvalidArgumentError:  # the record is too short for this structure, or the fit found no model
            return Candidate(structure, -math.inf, np.full(2 * STRETCHES, np.inf), math.inf, math.inf)
        unseen = slice(trained, u.size) if seen.start == 0 else slice(0, u.size - trained)
        error = _error_held_out(fitted, u, scored, t, unseen)
        errors.append(error)
        measured = scored[unseen][np.isfinite(error)]
        spreads.append(float(np.sum((measured - measured.mean()) ** 2)) if measured.size else 0.0)
        uncertainties.append(_uncertainty(fitted))
        residual = scored[seen] - fitted.simulation.output
        residual = residual[np.isfinite(residual)]
        variance = float(np.mean(residual**2)) if residual.size else 0.0
        tiny = np.finfo(float).tiny
        criteria.append(residual.size * math.log(max(variance, tiny)) + _parameters(structure) * math.log(trained))
    left = sum(float(np.nansum(error**2)) for error in errors)
    usable = all(np.isfinite(error).any() for error in errors) and sum(spreads) > 0.0
    held_out = 100.0 * (1.0 - math.sqrt(left / sum(spreads))) if usable and math.isfinite(left) else -math.inf
    parts = [part[np.isfinite(part)] for error in errors for part in np.array_split(error, STRETCHES)]
    powers = np.array([float(np.mean(part**2)) if part.size else math.inf for part in parts])
    stretches = np.log(np.maximum(powers, np.finfo(float).tiny))
    return Candidate(structure, held_out, stretches, max(uncertainties), criteria[0])


def _without_gross_outliers(y: FloatArray) -> FloatArray:
    """Return outputs (K,) with NaN for what no plant does: of all structures they would make the same bad fit."""
    known = np.isfinite(y)
    cleaned = y.copy()
    cleaned[known] = without_spikes(y[known])
    return np.where(cleaned == y, y, np.nan)


def _error_held_out(fitted: FitResult, u: FloatArray, y: FloatArray, t: FloatArray | None, unseen: slice) -> FloatArray:
    """Return measured minus modelled output over a stretch that was not fitted; NaN where there is no output."""
    dt = fitted.dt
    # inputs from before the stretch act on it through the dead time: they are simulated, their outputs left out
    delay = fitted.structure.delay
    unknown = unknown_outputs(delay, dt)
    start = max(unseen.start - unknown, 0)
    if t is not None:
        start = max(int(np.searchsorted(t, t[unseen.start] - delay + SAME * dt, "right")) - 1, 0)
        unknown = int(np.count_nonzero(t[start : unseen.stop] - t[start] < delay - SAME * dt))
    skipped, whole_part = unseen.start - start, slice(start, unseen.stop)
    mapped = fitted.preprocess.map_input(u[whole_part])
    stamps = None if t is None else t[whole_part]
    span = dt * (unseen.stop - unseen.start) if t is None else float(t[unseen.stop - 1] - t[unseen.start])
    if runs_away(fitted.transfer_function.den, span):
        error = _predicted(fitted, u[whole_part], y[whole_part], stamps)
    else:
        measured = np.where(np.arange(start, unseen.stop) < unseen.start, np.nan, y[whole_part])
        hold = fitted.filter.input_hold
        error = measured - simulate(fitted.transfer_function, mapped, measured, dt, input_hold=hold, t=stamps).output
    error[:unknown] = np.nan  # answers to inputs that are not known
    if stamps is not None:
        for begin in stamps[gaps_of(np.diff(stamps, prepend=stamps[0] - dt), dt)]:
            error[(stamps >= begin) & (stamps - begin < delay - SAME * dt)] = np.nan
    return error[skipped:]


def _uncertainty(fitted: FitResult) -> float:
    """Return the largest standard deviation of a coefficient as a part of its size.

    Of a_i the size is that of the coefficient of prod(s + abs(pole)), as it would be if all poles were real; of b_j it
    is its own.
    """
    uncertainty, structure = fitted.uncertainty, fitted.structure
    if uncertainty is None or not np.isfinite(uncertainty.std).all():
        return math.inf
    denominator = real_coefficients(fitted.parameters[structure.denominator], 1.0 / (fitted.dt * fitted.samples))
    sizes = np.concatenate([denominator, np.abs(fitted.parameters[structure.numerator])])
    return float((uncertainty.std[: sizes.size] / np.maximum(sizes, np.finfo(float).tiny)).max())


def _predicted(fitted: FitResult, u: FloatArray, y: FloatArray, t: FloatArray | None) -> FloatArray:
    """Return the error (K,) of the output predicted one step ahead; NaN where there is no output, or no prediction."""
    hold = fitted.filter.input_hold
    ready = ready_record(fitted.structure, fitted.dt, fitted.preprocess, u, y, t, hold)
    error = prediction_error(fitted.structure, fitted.parameters, ready, fitted.dt)
    found = np.full(y.size, np.nan)
    if error is not None:
        accepted, _ = screen(fitted.preprocess.map_input(u), y)
        found[accepted] = error
    return found


def _parameters(structure: Structure) -> int:
    """Return the number of parameters, a dead time counted as one."""
    return structure.size + bool(structure.delay)
