r"""The actuator experiment of section 4 on a simulated rig, and the measures of its estimates.

J
    :math:`J_p = \sum_k (\hat p(t_k) - p)^2`, (21), of the estimate before each sample's own update.
error
    Error of the last estimate, in percent of the true value.
settled
    Time in s from which on the estimate stays within 10 % of the true value; None if it ends outside.
roughness
    Standard deviation over the last tenth of the record about the straight line that fits best, in percent of the
    true value: the scatter of the estimate, without its remaining drift.

The article's record is not published.  The rig of Table 6 is simulated instead, with the laser's noise and the
membrane's creep.  Its voltage has steps of 10 ms to 20 s, which excite both the slow mode (0.1 rad/s) and the fast,
lightly damped one (76.7 rad/s).  `NOTES` lists the settings that the article does not print; `LEGEND` explains the
columns of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers import Adam, AMSGrad, Gradient, IntegralCost, Optimizer
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import Request, Scaling
from replant.estimation.solver.least_squares import least_squares, regressors
from replant.fitting.fit import fit
from replant.fitting.fit_result import FitResult
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.online.identifier import Identifier
from replant.online.runs.run import run_online
from replant.paper.tables import Curve, transients
from replant.rigs import Rig, deap_rig, deap_voltage
from replant.verdict import simulate

BAND = 0.1  # distance within which an estimate counts as settled [part of the true value]
Measures = Mapping[str, Mapping[str, Any]]  # by "error", "J", "settled" or "roughness", then by coefficient


def measure(
    start: FloatArray,
    parameters: FloatArray,
    true: Mapping[str, float],
    dt: float,
    samples: npt.NDArray[np.int64] | None = None,
    length: int | None = None,
) -> Measures:
    """Return the measures of the first ``len(true)`` parameters of an estimate, see the description of the module.

    Row i of ``parameters`` (H, P) is the estimate after ``samples[i]`` of ``length`` samples, by default after every
    sample; ``start`` (P,) is the estimate before the first sample.  Between rows the estimate is constant.
    """
    samples = np.arange(1, len(parameters) + 1) if samples is None else samples
    length = len(parameters) if length is None else length
    values, target = parameters[:, : len(true)], np.array(list(true.values()))
    # number of samples for which each estimate, beginning with the start, was valid
    held = np.diff(np.concatenate([[0], samples, [length]]))
    squares = (np.vstack([start[None, : len(true)], values]) - target) ** 2
    relative = (values - target) / np.abs(target)
    tail = samples > 0.9 * length
    found = {
        "error": (100.0 * relative[-1]).tolist(),
        "J": (held @ squares).tolist(),
        "settled": [_settled(column, np.asarray(samples * dt, np.float64)) for column in relative.T],
        "roughness": (100.0 * _scatter(samples[tail] / length, relative[tail])).tolist(),
    }
    return {name: dict(zip(true, each, strict=True)) for name, each in found.items()}


def _settled(relative: FloatArray, t: FloatArray) -> float | None:
    outside = np.flatnonzero(~(np.abs(relative) <= BAND))
    if outside.size == 0:
        return float(t[0])
    return None if outside[-1] == relative.size - 1 else float(t[outside[-1] + 1])


def _scatter(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the standard deviation of each column of ``values`` about its own straight line over ``t``."""
    if t.size < 3:
        return np.full(values.shape[1], np.nan)
    line = np.column_stack([np.ones_like(t), t - t.mean()])
    weights, *_ = np.linalg.lstsq(line, values, rcond=None)
    return np.asarray((values - line @ weights).std(axis=0))


SAMPLES = 240_000  # length of the article's record: 240 s at 1 kHz [samples]
BUFFER = 240_000  # the article's buffer [samples]
BATCH = 10  # the article's batch [samples]
NOISE = 1e-3  # standard deviation of the laser's noise [mm]
CREEP = 5e-3  # creep for each decade of time [mm]
FORGETTING_RATE = 0.1  # the article's forgetting rate [1/s]
POINTS = 1200  # points of a curve in Figures 7 and 8, whose panels are small [count]
STRUCTURE = Structure(poles=3, zeros=1, bias=True)
#: sigma_y, and sigma in the order a2, a1, a0, b1, b0, bias; a sigma of 10 gives the bias the article's constant 0.1.
SCALING = Scaling(0.05, (1e-4, 1e-6, 1e-6, 1e-4, 1e-4, 10.0))
#: The article's filters, Tustin and one sample late, and filters without discretisation error; Lambda = (s + 50)^3.
FILTERS = {
    "gbt": StateVariableFilter(cutoff=50.0, method="gbt"),
    "exact": StateVariableFilter(cutoff=50.0, method="exact"),
}
#: g_n of each configuration; those with a gain below 1 learn from the buffer.
GAINS = {"no buffer": 1.0, "small gain": 0.5, "very small gain": 0.1}
#: The optimizers at gain g_n.
OPTIMIZERS: Mapping[str, Callable[[float], Optimizer]] = {
    "Gradient": lambda gain: Gradient(0.05 * gain),
    "IntegralCost": lambda gain: IntegralCost(0.05 * gain, FORGETTING_RATE),
    "AMSGrad": lambda gain: AMSGrad(5e-5 * gain),
    "Adam": lambda gain: Adam(5e-5 * gain),
}
OFFLINE, NORMALISED, DEFAULT = "least squares", "normalised", "replant"
FURTHER = 5  # further records, which show the scatter of the default's error [count]
RUNS = len(FILTERS) * (len(OPTIMIZERS) * len(GAINS) + 1) + 1 + FURTHER
NOTES = (
    "The article's record is not published: a rig with the parameters of Table 6 is simulated instead, "
    f"{SAMPLES:,} samples at 1 kHz, 1 um of laser noise, creep of 5 um a decade of time.",
    f"The article does not print g_n, the batch, the forgetting rate or Lambda(s). Here g_n is {GAINS['small gain']:g} "
    f"for the small and {GAINS['very small gain']:g} for the very small gain, both with a buffer of {BUFFER:,} and the "
    f"{BATCH} updates a sample that reproduce Table 1; the forgetting rate is {FORGETTING_RATE:g} /s, a memory "
    "as long as the slow mode's time constant; Lambda(s) is (s + 50)^3.",
    "Gains in the article's units: 0.05 g_n for Gradient (1/s) and IntegralCost (1/s^2), multiplied by the sampling "
    "time, 5e-5 g_n for AMSGrad and Adam.",
)

LEGEND = (
    "a2 to b0: error of the last estimate, in percent of the true value.",
    "filter: gbt is the article's, Tustin's rule and one sample late; exact has no discretisation error; own is the "
    "default's.",
    "normalised: each row of the regression is divided by m of (13), as in the online runs.",
    "J_sum: the article's index (21), summed over the coefficients; a1, the largest coefficient, dominates the sum.",
    "replant's default starts with a model of the first tenth of the record; before that, provisional models of fewer "
    "samples count in its J, and 0 before the first of them.",
    "in 10%: time in s from which on every coefficient stays within 10 % of its true value.",
    "rough: standard deviation over the last tenth of the record about the best straight line, in percent of the true "
    "value; the largest of the coefficients.",
    "free: fit in percent of the last model, simulated from the input alone.",
)


@dataclass(frozen=True, eq=False)
class Record:
    """The rig and the record measured on it."""

    rig: Rig
    u: FloatArray  # (K,): input voltage in kV
    y: FloatArray  # (K,): displacement in mm

    @property
    def true(self) -> dict[str, float]:
        """The true coefficients by name."""
        values = [*self.rig.plant.den[1:].tolist(), *self.rig.plant.num.tolist()]
        return dict(zip(STRUCTURE.names, values, strict=False))

    @cached_property
    def linear_input(self) -> FloatArray:
        """u_p = u_A^2 - u_R^2 [kV^2], (K,)."""
        preprocess = self.rig.preprocess
        return np.asarray(preprocess.map_input(self.u) - float(preprocess.input_offset))

    def free_run(self, model: TransferFunction) -> float:
        """Return the fit in percent of a model simulated from the input alone."""
        return simulate(model, self.linear_input, self.y, self.rig.dt).fit


@dataclass(frozen=True, eq=False)
class Row:
    """One line of the table."""

    method: str  # method, variant: optimizer and configuration, or `OFFLINE`, or `DEFAULT`
    variant: str
    filters: str  # a key of `FILTERS`; "own" for the default
    measures: Measures  # for least squares only the error
    free_run: float  # fit in percent of the model simulated from the input alone
    curves: Mapping[str, Curve] | None = None  # by coefficient, of a run with the article's optimizers

    @property
    def label(self) -> str:
        """Method, variant and filters, separated by commas."""
        return ", ".join(part for part in (self.method, self.variant, f"{self.filters} filters") if part)

    @property
    def errors(self) -> Mapping[str, float]:
        """Errors of the last estimate by coefficient, in percent of the true value."""
        return self.measures["error"]

    @property
    def totals(self) -> dict[str, float | None]:
        """For an online run the article's J_sum, the time at which all are settled, and the largest roughness."""
        if self.method == OFFLINE:
            return {}
        times, roughness = self.measures["settled"].values(), self.measures["roughness"].values()
        settled = None if None in times else max(times)
        return {"J_sum": sum(self.measures["J"].values()), "settled": settled, "roughness": max(roughness)}


@dataclass(frozen=True, eq=False)
class Actuator:
    """The experiment with its results."""

    record: Record
    offline: Mapping[str, FitResult]  # `fit_offline` by filters
    goals: Mapping[str, FloatArray]  # `fit_normalised` by filters
    rows: tuple[Row, ...]  # twelve runs with both kinds of filters, least squares plain and normalised, the default
    # the default on `FURTHER` records of the same rig and length, with other voltages and other noise
    elsewhere: tuple[Row, ...]

    def row(self, method: str, variant: str = "", filters: str = "gbt") -> Row:
        """Return one row."""
        return {(row.method, row.variant, row.filters): row for row in self.rows}[method, variant, filters]

    def online_rows(self, filters: str = "gbt") -> list[Row]:
        """Return the twelve runs of the article's methods with one kind of filters."""
        return [row for row in self.rows if row.method in OPTIMIZERS and row.filters == filters]


def measure_rig(samples: int = SAMPLES, seed: int = 0) -> Record:
    """Return a record of the simulated rig; ``seed`` determines voltage and noise."""
    rig, u = deap_rig(noise=NOISE, creep=CREEP), deap_voltage(samples, seed)
    return Record(rig, u, rig.measure(u, seed))


def fit_offline(record: Record, on_run: Callable[[], None] = lambda: None) -> dict[str, FitResult]:
    """Return least squares over the whole record, by filters, as the article does for its Table 6."""
    rig, fits = record.rig, {}
    how: dict[str, Any] = {"method": "least_squares", "preprocess": rig.preprocess}
    for name, chosen in FILTERS.items():
        fits[name] = fit(record.u, record.y, rig.dt, STRUCTURE, filter=chosen, **how)
        on_run()
    return fits


def fit_normalised(record: Record, filters: str) -> FloatArray:
    """Return the estimate of least squares with rows over m of (13), to which the normalising optimizers converge."""
    rig = record.rig
    phi, target = regressors(STRUCTURE, rig.dt, FILTERS[filters], rig.preprocess, record.u, record.y)
    m = np.sqrt(1.0 + ((phi / SCALING.sigmas(STRUCTURE)) ** 2).sum(axis=1))
    return least_squares(phi / m[:, None], target / m).parameters


def identifier(record: Record, method: str, variant: str, filters: str) -> Identifier:
    """Return the identifier of one run before its first sample."""
    return Identifier(
        STRUCTURE,
        record.rig.dt,
        filter=FILTERS[filters],
        scaling=SCALING,
        optimizer=OPTIMIZERS[method](GAINS[variant]),
        replay=None if variant == "no buffer" else Replay(capacity=BUFFER, batch_size=BATCH, warmup=20),
        preprocess=record.rig.preprocess,
    )


def reproduce_actuator(record: Record | None = None, on_run: Callable[[], None] = lambda: None) -> Actuator:
    """Run the experiment: every optimizer, configuration and filter, least squares, and replant's default."""
    record = measure_rig() if record is None else record
    offline = fit_offline(record, on_run)
    goals = {filters: fit_normalised(record, filters) for filters in FILTERS}
    rows = []
    for method, variant, filters in product(OPTIMIZERS, GAINS, FILTERS):
        rows.append(_run(record, method, variant, filters))
        on_run()
    rows += [_offline_row(record, "", filters, fitted.parameters) for filters, fitted in offline.items()]
    rows += [_offline_row(record, NORMALISED, filters, goal) for filters, goal in goals.items()]
    rows.append(run_default(record))
    on_run()
    elsewhere = []
    for seed in range(1, FURTHER + 1):
        elsewhere.append(run_default(measure_rig(record.u.size, seed)))
        on_run()
    return Actuator(record, offline, goals, tuple(rows), tuple(elsewhere))


def _run(record: Record, method: str, variant: str, filters: str) -> Row:
    estimator, dt = identifier(record, method, variant, filters), record.rig.dt
    trace = estimator.update_many(record.u, record.y)
    measures = measure(trace.start, trace.parameters, record.true, dt)
    free_run = record.free_run(estimator.transfer_function)
    return Row(method, variant, filters, measures, free_run, transients(trace, dt, POINTS))


def _offline_row(record: Record, variant: str, filters: str, parameters: FloatArray) -> Row:
    errors = {
        name: 100.0 * (value - true) / abs(true)
        for (name, true), value in zip(record.true.items(), parameters.tolist(), strict=False)
    }
    return Row(OFFLINE, variant, filters, {"error": errors}, record.free_run(STRUCTURE.transfer_function(parameters)))


def run_default(record: Record) -> Row:
    """Return the row of replant's default, for which only the structure is given."""
    request = Request(STRUCTURE, record.rig.dt, preprocess=record.rig.preprocess)
    result = run_online(request, record.u, record.y)
    assert result.history is not None
    start, samples, parameters = np.zeros(STRUCTURE.size), result.history.samples, result.history.parameters
    measures = measure(start, parameters, record.true, record.rig.dt, samples, record.u.size)
    return Row(DEFAULT, "default", "own", measures, record.free_run(result.transfer_function))
