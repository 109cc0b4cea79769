"""A record through an identifier: in chunks, with progress, a thinned history, and the result at the end."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from replant.assessment import Simulation, Verdict, assess_record, fit_percent, simulate
from replant.defaults import settle
from replant.filters import StateVariableFilter
from replant.identifier import Identifier
from replant.offline import FitResult
from replant.prediction import one_step
from replant.preprocess import screen
from replant.settings import Request, Settings
from replant.startup import ready_record
from replant.structure import Structure
from replant.transfer_function import TransferFunction
from replant.uncertainty import Uncertainty
from replant.validation import FloatArray

CHUNK = 1 << 14  # samples between two reports of progress
MOST_ROWS = 10_000  # of history kept: more than a plot can show
BANDS = 200  # times that standard deviations are taken along the way


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

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response, where the estimator tells them."""
        return None if self.covariance is None else Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    def fixed_filter(self) -> StateVariableFilter | None:
        """The filter of an online run; 1/A of the result where it was the refined one."""
        if self.settings is None:
            return None
        used = self.settings.filter
        return used if isinstance(used, StateVariableFilter) else used.at(self.transfer_function.den, self.settings.dt)


def run_online(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    progress: Callable[[int], None] = lambda samples: None,
    *,
    startup: int | None = None,
) -> Result:
    """Identify in one pass over a record.

    Where instruments are wanted, a tenth of the record is the start-up; else what is left to "auto" is chosen from
    the whole record beforehand.

    Parameters
    ----------
    request : Request
    u, y : (K,) arrays
        Raw input and output.
    progress : callable
        Called with the number of samples done, every few thousand.
    startup : int, optional
        Samples held back for the start-up; the run is then, to the bit, what it would have been live.
    """
    begun = time.perf_counter()
    if startup is not None:
        identifier = Identifier(**vars(dataclasses.replace(request, startup=startup)))
    elif request.wants_instruments:
        request = dataclasses.replace(request, startup=max(u.size // 10, 1))
        identifier = Identifier(**vars(request))
    else:
        identifier = Identifier(**vars(settle(request, u, y, u.size)))
    stride = max(1, u.size // MOST_ROWS)
    chunk = min(CHUNK, max(1, u.size // BANDS))
    rows, bands = [np.empty((0, request.structure.size))], [np.empty((0, request.structure.size))]
    for start in range(0, u.size, chunk):
        trace = identifier.update_many(u[start : start + chunk], y[start : start + chunk])
        rows.append(trace.parameters[(stride - 1 - start) % stride :: stride])
        bands.append(np.broadcast_to(identifier.uncertainty.std, rows[-1].shape))
        progress(min(start + chunk, u.size))
    identifier.finish_startup()
    parameters = np.concatenate(rows)
    history = History(stride * np.arange(1, parameters.shape[0] + 1), parameters, np.concatenate(bands))
    return assess_run(identifier, request, history, u, y, begun)


def assess_run(
    identifier: Identifier, request: Request, history: History, u: FloatArray, y: FloatArray, begun: float
) -> Result:
    """Return the result of an online run over the record u, y; ``begun`` is the clock at its start."""
    settings = identifier.settings
    preprocess = settings.preprocess if settings else request.preprocess.resolve(u, y)
    mapped = preprocess.map_input(u)
    accepted, _ = screen(mapped, y)
    y = np.where(accepted, y, np.nan)
    linear_input = np.where(accepted, mapped - float(preprocess.input_offset), np.nan)
    hold = settings.filter.input_hold if settings else "zoh"
    simulation = simulate(identifier.transfer_function, linear_input, y, identifier.dt, input_hold=hold)
    covariance = identifier.covariance
    return Result(
        identifier.structure,
        identifier.parameters,
        identifier.transfer_function,
        fit_percent(y, y - one_step(y - simulation.output)),
        simulation,
        identifier.samples,
        identifier.rejected,
        identifier.assess(),
        time.perf_counter() - begun,
        settings,
        history,
        covariance if np.isfinite(covariance).all() else None,
    )


def result_of_fit(fitted: FitResult, u: FloatArray, y: FloatArray, begun: float) -> Result:
    """Return the result of an offline fit to the record u, y; ``begun`` is the clock at its start."""
    hold = fitted.filter.input_hold
    record = ready_record(fitted.structure, fitted.dt, fitted.preprocess, u, y, input_hold=hold)
    return Result(
        fitted.structure,
        fitted.parameters,
        fitted.transfer_function,
        fitted.one_step,
        fitted.simulation,
        fitted.samples,
        fitted.rejected,
        assess_record(
            fitted.structure,
            fitted.parameters,
            record,
            fitted.dt,
            fitted.covariance,
            instruments=fitted.method != "least_squares",
        ),
        time.perf_counter() - begun,
        covariance=fitted.covariance,
    )
