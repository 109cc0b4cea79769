"""A record through an identifier: in chunks, with progress, a thinned history, and the result at the end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from replant.assessment import Simulation, Verdict, fit_percent, judge, simulate
from replant.defaults import settle
from replant.identifier import Identifier
from replant.least_squares import least_squares
from replant.offline import FitResult
from replant.preprocess import screen
from replant.regression import regressors
from replant.settings import Request, Settings
from replant.structure import Structure
from replant.transfer_function import TransferFunction
from replant.validation import FloatArray

CHUNK = 1 << 14  # samples between two reports of progress
MOST_ROWS = 10_000  # of history kept: more than a plot can show


@dataclass(frozen=True, eq=False)
class History:
    """The estimate over time, thinned.

    Attributes
    ----------
    samples : (H,) array of int
        After how many samples each row was taken.
    parameters : (H, P) array
    std : (H, P) array or None
        Standard deviation of each estimate, where the estimator tells it.
    """

    samples: np.ndarray[tuple[int], np.dtype[np.int64]]
    parameters: FloatArray
    std: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """An identified model with what is needed to trust or distrust it.

    Attributes
    ----------
    structure : Structure
    parameters : (P,) array
    transfer_function : TransferFunction
    one_step, simulated : float
        Fit in percent: from past outputs, and from the input alone.
    simulation : Simulation
    samples : int
        Accepted samples.
    rejected : dict
        Rejected samples by reason.
    verdict : Verdict
    elapsed : float
        Time taken in s.
    settings : Settings or None
        Of an online run.
    history : History or None
        Of an online run.
    covariance : (P, P) array or None
        Of the parameters, in their units squared, where the estimator tells it.
    """

    structure: Structure
    parameters: FloatArray
    transfer_function: TransferFunction
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    verdict: Verdict
    elapsed: float
    settings: Settings | None = None
    history: History | None = None
    covariance: FloatArray | None = None


def run_online(
    request: Request, u: FloatArray, y: FloatArray, progress: Callable[[int], None] = lambda samples: None
) -> Result:
    """Identify in one pass over a record; what is left to "auto" is chosen from the record beforehand.

    Parameters
    ----------
    request : Request
    u, y : (K,) arrays
        Raw input and output.
    progress : callable
        Called with the number of samples done, every few thousand.
    """
    begun = time.perf_counter()
    settings = settle(request, u, y, u.size)
    identifier = Identifier(
        settings.structure,
        settings.dt,
        filter=settings.filter,
        scaling=settings.scaling,
        optimizer=settings.optimizer,
        replay=settings.replay,
        normalize=settings.normalize,
        preprocess=settings.preprocess,
    )
    stride = max(1, u.size // MOST_ROWS)
    kept: list[FloatArray] = []
    for start in range(0, u.size, CHUNK):
        trace = identifier.update_many(u[start : start + CHUNK], y[start : start + CHUNK])
        kept.append(trace.parameters[(stride - 1 - start) % stride :: stride])
        progress(min(start + CHUNK, u.size))
    rows = np.concatenate(kept) if kept else np.empty((0, settings.structure.size))
    history = History(stride * np.arange(1, rows.shape[0] + 1), rows)
    return assess_run(identifier, settings, history, u, y, begun)


def assess_run(
    identifier: Identifier, settings: Settings, history: History, u: FloatArray, y: FloatArray, begun: float
) -> Result:
    """Return the result of an online run over the record u, y; ``begun`` is the clock at its start."""
    model, parameters = identifier.transfer_function, identifier.parameters
    mapped = settings.preprocess.map_input(u)
    accepted, _ = screen(mapped, y)
    y = np.where(accepted, y, np.nan)
    linear_input = np.where(accepted, mapped - float(settings.preprocess.input_offset), np.nan)
    phi, target = regressors(settings.structure, settings.dt, settings.filter, settings.preprocess, u, y)
    simulation = simulate(model, linear_input, y, settings.dt, input_hold=settings.filter.input_hold)
    return Result(
        settings.structure,
        parameters,
        model,
        fit_percent(y, y - (target - phi @ parameters)),
        simulation,
        identifier.samples,
        identifier.rejected,
        judge(
            refused=identifier.status == "diverged",
            condition=least_squares(phi, target).condition,
            simulated=simulation.fit,
            drift=_drift(history.parameters),
        ),
        time.perf_counter() - begun,
        settings,
        history,
    )


def result_of_fit(fitted: FitResult, begun: float) -> Result:
    """Return the result of an offline fit; ``begun`` is the clock at its start."""
    return Result(
        fitted.structure,
        fitted.parameters,
        fitted.transfer_function,
        fitted.one_step,
        fitted.simulation,
        fitted.samples,
        fitted.rejected,
        judge(refused=False, condition=fitted.condition, simulated=fitted.simulation.fit, drift=0.0),
        time.perf_counter() - begun,
    )


def _drift(parameters: FloatArray) -> float:
    """Return the largest movement over the last tenth of a history, as a part of the final value."""
    if parameters.shape[0] < 10:
        return np.inf
    last = parameters[-max(2, parameters.shape[0] // 10) :]
    size = np.abs(last[-1])
    size[size == 0.0] = np.inf
    return float(((last.max(axis=0) - last.min(axis=0)) / size).max())
