r"""Validation: a model compared with a record that it was not made from.

Offset and initial state are estimated, everything else is the model's.  The residual is tested for being white and
independent of the input.  The error by frequency is the transfer function from the input to the residual,
:math:`E(i \omega) = \Phi_{eu} / \Phi_u`, over abs G; its standard deviation for M independent segments is
:math:`\sqrt{(\Phi_e - |\Phi_{eu}|^2 / \Phi_u) / (M \Phi_u)}`.

Source: Ljung (1999), "System Identification: Theory for the User", sections 6.4 and 16.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.simulation.fitted_run import Simulation, fit_percent
from replant.estimation.simulation.model_run import model_output
from replant.estimation.solver.bad_samples import doubts, suspicious
from replant.estimation.solver.solve import in_turn
from replant.fitting.model_fields import ModelFields
from replant.kernels.schema import Doubt
from replant.model.preprocess import accepted, screen
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.autoregression import one_step
from replant.numerics.linear_algebra import quiet
from replant.numerics.residuals import Correlations, correlation_lags, correlations
from replant.plotting.diagrams import draw_validation
from replant.verdict import assess_record
from replant.verdict.estimate_distance import EXCITED, SEGMENT
from replant.verdict.verdict import Verdict

FEWEST_SEGMENTS = 8  # fewest segments for a spectrum [count]
CHANCE = 0.05  # how often the error of a right model exceeds its limit [share]
# some million times the precision of float64
ROUNDING = 1e-9  # residual up to which it is rounding, and not tested [part of the output's spread]


@dataclass(frozen=True, eq=False)
class ErrorByFrequency:
    """The transfer function from input to residual, over abs G, at the frequencies that the input excites.

    Attributes
    ----------
    frequency : (F,) array
        In rad/s.
    error : (F,) array
        Relative to abs G.
    limit : (F,) array
        95 % limit of the error of a right model.
    """

    frequency: FloatArray
    error: FloatArray
    limit: FloatArray

    @property
    def worst(self) -> float:
        """Largest significant error, relative to abs G; 0 without one.

        An error is significant beyond the limit that it exceeds by chance with probability 0.05 / F, with F
        frequencies: the largest error of a right model is so in one record of twenty.
        """
        beyond = self.error > self.limit * math.sqrt(1.0 + math.log(self.error.size) / -math.log(CHANCE))
        return float(self.error[beyond].max()) if beyond.any() else 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """The comparison of a model with a record that it was not made from.

    Attributes
    ----------
    fit : float
        Simulated fit in percent: the model run from the input alone; of an unstable one that of its prediction.
    one_step : float
        Fit in percent one step ahead: each residual is predicted from past ones.
    offset : float
        By how much the record's working point lies above the model's, in the unit of the output.
    output, residual : (K,) arrays
        The model's output in absolute units, and measured minus model's output; NaN without a measured output.
    time : (K,) array
        In s.
    correlations : Correlations or None
        Of the residual with itself and with the input; None with too few samples.
    by_frequency : ErrorByFrequency or None
        None on an irregular clock, and with too few samples.
    verdict : Verdict
        On the model by this record alone.
    samples : int
        Samples with a measured output.
    is_prediction : bool
        Whether ``output`` is predicted one step ahead, as for an unstable model.
    outliers, stuck : int
        Outputs that were left out, as `replant.fit` does.
    """

    fit: float
    one_step: float
    offset: float
    output: FloatArray
    residual: FloatArray
    time: FloatArray
    correlations: Correlations | None
    by_frequency: ErrorByFrequency | None
    verdict: Verdict
    samples: int
    is_prediction: bool
    outliers: int = 0
    stuck: int = 0

    @property
    def how(self) -> str:
        """How the output was made, in words."""
        return "predicted from input and past output" if self.is_prediction else "simulated from the input alone"

    @property
    def outside(self) -> tuple[float, float]:
        """Part of the lags at which the residual's correlation with itself and with the input exceeds its 95 % limit.

        About 0.05 each for a model that explains the record completely; NaN with too few samples.
        """
        return (math.nan, math.nan) if self.correlations is None else self.correlations.outside

    def plot(self, axes: Any = None) -> Any:
        """Draw both outputs, the residual's correlations, and the error by frequency; return four axes of matplotlib.

        Parameters
        ----------
        axes : four matplotlib axes, optional
            Drawn into; without them a figure is made.
        """
        return draw_validation(self, axes)

    def __repr__(self) -> str:
        return f"<Validation over {self.samples} samples: fit {self.fit:.1f} %, {self.verdict.status}>"


@quiet
def validate(
    model: ModelFields, u: FloatArray, y: FloatArray, t: FloatArray | None, r: FloatArray | None, dt: float
) -> Validation:
    """Return the comparison of a model with a record."""
    v = model.linear_input(u)
    y = np.where(screen(v, y)[0], y, np.nan)
    if r is not None:
        r, known = accepted(r)
        y = np.where(known, y, np.nan)
    kept, needed = np.isfinite(y), model.structure.size + 1
    if kept.sum() < needed:
        raise InvalidArgumentError(f"the record has {int(kept.sum())} usable samples, a validation needs {needed}")
    g, given = model.transfer_function, y
    noise = np.ones(1) if model.noise is None else model.noise.coefficients

    def simulated(doubt: IntArray, _: Simulation | None) -> Simulation | None:
        y = np.where(doubt == Doubt.NONE, given, np.nan)
        enough = np.isfinite(y).sum() >= needed
        return model_output(g, v, y, dt, input_hold=model.input_hold, t=t) if enough else None

    # bad outputs are found with the model's output, whose level changes without them
    ends = in_turn(kept, suspicious(v, given), simulated, lambda run, _: doubts(v, given, run.output, noise))
    assert ends is not None, "the outputs as they came are enough"
    simulation, doubt = ends
    y = np.where(doubt == Doubt.NONE, given, np.nan)
    kept, residual = np.isfinite(y), y - simulation.output
    clock = np.asarray(dt * np.arange(u.size), np.float64) if t is None else t
    one_step_fit = simulation.fit if simulation.is_prediction else fit_percent(y, y - one_step(residual))
    left = residual[np.isfinite(residual)]
    is_tested = left.size > 0 and float(np.std(left)) > ROUNDING * float(np.std(y[kept]))  # more than rounding is left
    lags = correlation_lags([mode.time_constant for mode in g.modes], u.size, dt)
    return Validation(
        simulation.fit,
        one_step_fit,
        simulation.offset - model.output_level if not simulation.is_prediction else math.nan,
        simulation.output,
        residual,
        clock,
        correlations(residual, v, lags) if is_tested else None,
        _by_frequency(model, v, residual, dt) if t is None else None,
        _verdict(model, v, y, simulation.output, clock, r, dt, int((doubt == Doubt.STUCK).sum()), regular=t is None),
        int(kept.sum()),
        simulation.is_prediction,
        *(int((doubt == each).sum()) for each in (Doubt.OUTLIER, Doubt.STUCK)),
    )


def _verdict(
    model: ModelFields, v: FloatArray, y: FloatArray, modelled: FloatArray, clock: FloatArray, r: FloatArray | None,
    dt: float, stuck: int, *, regular: bool,
) -> Verdict:  # fmt: skip
    """Return the verdict on the model by the rows of a record whose input is known."""
    rows = np.isfinite(v) & (np.isfinite(y) | np.isfinite(modelled))  # a model may leave float64
    intervals = np.array([dt]) if regular and rows.all() else np.diff(clock[rows], prepend=clock[rows][:1] - dt)
    measured, level = np.isfinite(y[rows]), float(y[np.isfinite(y)].mean())
    # the constant in addition to G(s) is estimated from the record; without the mean the numbers are small
    record = Record(
        v[rows] - v[rows].mean(), np.where(measured, y[rows], modelled[rows]) - level, intervals, model.input_hold,
        None if r is None else r[rows], usual=math.inf if intervals.size == 1 else dt,
        measured=None if measured.all() else measured,
    )  # fmt: skip
    instruments = model.provenance.method != "least_squares"
    found = assess_record(
        model.structure, model.parameters, record, dt, model.covariance, instruments=instruments, unseen=True,
        left_out=stuck,
    )  # fmt: skip
    return Verdict(found.status, found.reasons, found.excited)


def _by_frequency(model: ModelFields, v: FloatArray, residual: FloatArray, dt: float) -> ErrorByFrequency | None:
    """Return the error of a model by frequency; None if the record is too short, or the input constant."""
    from scipy.signal import csd, welch

    segment = min(SEGMENT, v.size // FEWEST_SEGMENTS)
    known = np.isfinite(residual) & np.isfinite(v)
    if segment < 16 or not known.any():
        return None
    e = np.where(known, residual - residual[known].mean(), 0.0)
    u = np.where(np.isfinite(v), v - v[np.isfinite(v)].mean(), 0.0)
    how: Any = {"fs": 1.0 / dt, "nperseg": segment}
    hertz, power = welch(u, **how)
    _, left = welch(e, **how)
    _, cross = csd(u, e, **how)
    omega = math.tau * hertz[1:-1]
    power, left, cross = power[1:-1], left[1:-1], cross[1:-1]
    gain = np.abs(model.transfer_function.response(omega))
    made = gain**2 * power
    excited = (made > EXCITED * made.max(initial=0.0)) & (power > 0.0)
    if not excited.any():
        return None
    segments = max(1.0, v.size / segment)
    omega, power, left, cross, gain = (each[excited] for each in (omega, power, left, cross, gain))
    noise = np.maximum(left - np.abs(cross) ** 2 / power, 0.0)
    # E has two parts, real and imaginary: with a right model, the square of abs E is exponentially distributed
    limit = np.sqrt(-math.log(CHANCE) * noise / (segments * power))
    return ErrorByFrequency(omega, np.abs(cross) / power / gain, limit / gain)
