r"""Faults of the plant: coefficients that depend on the operating point, the direction or the time; dry friction.

| fault | columns of its score test |
|---|---|
| a coefficient depends on the operating point | x^p x^(i) through B/A, i to n; x^p x^(j), j to m; p = 1 and 2 |
| on the direction | sign(x') x^(i) through B/A, i to n; sign(x') x^(j) |
| on the time | cos(pi k t / T) x^(i) through B/A, i < n; cos(pi k t / T) x^(j); k = 1 to 8 |
| the plant has dry friction | the sign of x' through B/A |

x is the state of the model, 1/A u minus its mean, and serves as the operating point; for a model without zeros it is
proportional to the output.  A plant whose coefficients depend on it,

.. math:: \sum_i a_i(x) x^{(i)} = u, \quad y = \sum_j b_j(x) x^{(j)},

has, to first order, these columns beside the slopes of the linear model; they include a static curve of the output.
At a level x the change :math:`w x^p x^{(i)}` changes the coefficient by :math:`w x^p`, and for i = 0 by p + 1 times
that, as the gain is the curve's slope and not its value.  The test judges the change of G at the levels that the record
visits; it may be a small part of the output's power, which comes from the levels themselves.  A heater that cools more
slowly than it heats has another G on its way down; the G of a motor that warms up, or of a battery that discharges,
depends on the time.

The columns of a sample use only what was known before it, so that the test is valid in feedback.  With a reference they
are made of the input that it explains.  What other dynamics could explain is projected out first.

Sources: Toth (2010), "Modeling and Identification of Linear Parameter-Varying Systems"; Schetzen (1980), "The Volterra
and Wiener Theories of Nonlinear Systems"; Armstrong-Helouvry, Dupont and Canudas de Wit (1994), "A survey of models,
analysis tools and compensation methods for the control of machines with friction", Automatica 30.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.estimation.simulation.model_run import PER_COEFFICIENT, responses
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ALPHA, NEGLIGIBLE
from replant.numerics.linear_algebra import chi2_quantile, combined, roots
from replant.numerics.score_test import Residual
from replant.verdict.estimate_distance import LARGEST_ERROR, excited_frequencies, output_spectrum
from replant.verdict.estimate_tests import FARTHEST
from replant.verdict.evidence import Evidence, rounding_of
from replant.verdict.input_faults import Acting
from replant.verdict.residual_tests import power_of, residual_of
from replant.verdict.verdict import Finding, percent

POWERS = (1, 2)  # powers of the operating point: odd for its sign, even for its distance from the mean [exponents]
ENDS = (0.05, 0.95)  # quantiles of the operating point between which G is compared: 90 % of samples [quantiles]
# each takes as many columns as G has coefficients
WAVES = 8  # half periods within a record of the fastest change that is modelled [count]
POINTS = 5  # times per half period of the fastest wave at which G is evaluated [count]

LEVELS = "the plant acts otherwise at other levels: within those of the record G differs by {} at least"
WAYS = "the plant acts otherwise on its way up than on its way down: G differs from the model by {} at least"
TIMES = "the plant changes as the record goes on: G differs from the model by {} at least"


def plant_findings(acting: Acting) -> list[Finding]:
    """Return findings if coefficients depend on level, direction or time, or if the plant has dry friction."""
    evidence, runs, loop = acting.evidence, acting.runs, acting.loop
    reference, rows = loop.reference, evidence.known
    used = evidence.used[rows]
    if not runs.now.error[rows][used].std() > rounding_of(runs.now.forced[rows], evidence.record.y[rows][used]):
        return []  # rounding depends on the path, too
    path = Path.of(evidence, acting.input if reference is not None else None)
    if path is None:
        return []
    drift = np.linspace(-1.0, 1.0, len(acting.linear))[:, None]  # of the output, or the rest of a subtracted one
    known = np.hstack([acting.known, acting.linear, drift])
    residual = residual_of(evidence, runs.now.error[rows], known)
    told = (
        _of_levels(acting, path, residual, known),
        _of_direction(acting, path, known),
        _of_time(acting, path, residual),
    )
    return _surest(acting, known, list(filter(None, told))) + _of_friction(acting, path, residual)


def _surest(acting: Acting, known: FloatArray, told: list[Told]) -> list[Finding]:
    """Return the findings on the dependence that is most significant beside the others, as they overlap."""
    told = [each for each in told if each.findings]
    evidence = acting.evidence
    error = acting.runs.now.error[evidence.known]

    def beside(one: Told) -> float:
        others = [each.columns for each in told if each is not one]
        return residual_of(evidence, error, np.hstack([known, *others])).explained(one.columns).statistic

    if not told:
        return []
    return (max(told, key=beside) if told[1:] else told[0]).findings


@dataclass(frozen=True, eq=False)
class Path:
    """The state of a model B/A over a record of K samples."""

    model: Model
    record: Record  # with all samples that act; starts at an input of zero
    states: FloatArray  # (K, n + 1): x, x' .. of the record, x minus its mean over the samples that are tested
    reached: FloatArray  # (K, n + 1): the same just before each sample
    before: int  # samples of the record that come before those of the evidence

    @classmethod
    def of(cls, evidence: Evidence, by_reference: FloatArray | None = None) -> Path | None:
        """Return the path over a record, or by the input (K,) that a reference explains; None if it exceeds float64."""
        whole = (
            evidence.record.joined if by_reference is None else replace(evidence.record, u=by_reference, before=None)
        )
        # a plant is at rest at its first input, unless it integrates
        rests = float(np.abs(evidence.poles).min()) * evidence.record.span > 1.0
        # a new load, or the begin of another log, changes the output's level and not x
        record = replace(whole, u=whole.u - whole.u[0] if rests else whole.u, measured=None, begins=())
        model, before = Model(evidence), whole.u.size - evidence.samples
        states = model.states(record)
        if not np.isfinite(states).all():
            return None
        states[:, 0] -= states[before:][evidence.known, 0].mean()
        return cls(model, record, states, model.reached(states), before)

    def changes(self, factor: FloatArray, at_end: FloatArray, *, slow: bool = False) -> FloatArray:
        """Return the changes of the output (K, n + m + 2) by changes of a_0 .. a_n, b_0 .. b_m by a factor.

        ``factor`` (K,) is the value from each sample on, ``at_end`` (K,) just before; ``slow`` leaves a_n out.
        """
        model, last, at_end = self.model, self.states.shape[1] - slow, at_end[:, None]
        held = factor[:, None] * self.states[:, :last]
        # a signal that varies within a sample is held at its mean, with an error of second order
        held[:-1] = 0.5 * (held[:-1] + at_end[1:] * self.reached[1:, :last])
        own = at_end * self.states[:, : model.structure.zeros + 1]
        return np.hstack([-model.output(held, self.record), own])

    @cached_property
    def braked(self) -> FloatArray:
        """The change of the output (J, 1) by dry friction."""
        return -self.model.output(np.sign(self.states[:, 1:2]), self.record)[self.before :]

    @property
    def level(self) -> FloatArray:
        """The operating point (K,), scaled to a standard deviation of 1."""
        x = self.states[:, 0]
        return np.asarray(x / max(float(x[self.before :].std()), float(np.finfo(float).tiny)))


class Model:
    """B/A, run over records."""

    def __init__(self, evidence: Evidence) -> None:
        structure = evidence.structure
        self.structure, self.dt, self.hold = structure, evidence.dt, evidence.record.input_hold
        self.a, self.b = evidence.estimate[structure.denominator], evidence.estimate[structure.numerator]

    def states(self, record: Record) -> FloatArray:
        """Return x = 1/A u and its derivatives up to the n-th (K, n + 1)."""
        n = self.structure.poles
        full = Structure(n, n, self.structure.delay, feedthrough=True)
        model = AuxiliaryModel(full, self.dt, self.hold)
        theta = np.zeros(model.entries)
        theta[full.denominator] = self.a
        return model.run(theta, record).phi[:, full.numerator][:, ::-1].copy()

    def output(self, inputs: FloatArray, record: Record) -> FloatArray:
        """Return the outputs of B/A by held inputs (K, C), without the dead time, which these include already."""
        poles = roots(np.append(1.0, self.a))  # unstable ones are reflected, as in the states
        stable = np.poly(-np.abs(poles.real) + 1j * poles.imag).real
        plant = TransferFunction(self.b, np.asarray(stable, np.float64))
        return responses(plant, inputs, record, self.dt, "zoh")

    def reached(self, states: FloatArray) -> FloatArray:
        """Return the states (K, n + 1) just before each sample: with a held input the n-th derivative jumps there."""
        reached = states.copy()
        if self.hold == "zoh":  # until then it follows from the input of the sample before
            reached[1:, -1] = states[:-1, -1] + combined(states[:-1, :-1] - states[1:, :-1], self.a[::-1])
        return reached

    def changes_of_response(self, omega: FloatArray) -> npt.NDArray[np.complex128]:
        """Return the relative changes of G at frequencies (F,) by a_0 .. a_n, b_0 .. b_m, (F, n + m + 2)."""
        powers = (1j * omega)[:, None] ** np.arange(self.a.size + 1)
        a, b = powers @ np.append(self.a[::-1], 1.0), powers[:, : self.b.size] @ self.b[::-1]
        return np.hstack([-powers / a[:, None], powers[:, : self.b.size] / b[:, None]])


class Depends(NamedTuple):
    """The result of a test whether coefficients depend on something."""

    columns: FloatArray  # (J, C): tested columns
    far: float  # lower bound of the relative change of G; 0 if not significant
    effect: FloatArray  # (J,): change of the output


def _depends(
    acting: Acting, path: Path, residual: Residual, error: FloatArray, factors: FloatArray, at: FloatArray,
    slope: float = 1.0, *, at_end: FloatArray | None = None, slow: bool = False,
) -> Depends | None:  # fmt: skip
    """Test a residual of an error for coefficients that depend on factors (K, S); G is compared at values (P, S).

    None if there are too few samples; ``slope``: factor on the changes by a_0 and b_0, see the top of the file;
    ``at_end`` (K, S): the factors just before each sample, if they jump there.
    """
    evidence, model, rows = acting.evidence, path.model, acting.evidence.known
    chosen = np.ones(model.a.size + model.b.size + 1, bool)
    chosen[model.a.size] = not slow  # for slow changes the column of a_n depends on the others
    both = zip(factors.T, factors.T if at_end is None else at_end.T, strict=True)
    parts = [path.changes(*each, slow=slow) for each in both]
    columns = np.hstack(parts)[path.before :][rows]
    if residual.known.shape[1] + columns.shape[1] > error.size / PER_COEFFICIENT:
        return None
    found = residual.explained(columns)
    # for changes in time this part of the output's power is the mean square of the change of G
    least = NEGLIGIBLE * power_of(evidence, acting.made[rows]) if slow else 0.0
    if not (found.is_sure and found.power > least):
        return Depends(columns, 0.0, np.zeros(error.size))
    effect = residual.left_of(columns, found.weights)
    found = residual.beside(error, effect).explained(columns)
    omega, shares = output_spectrum(evidence) if slow else (excited_frequencies(evidence), None)
    changes = model.changes_of_response(omega)
    changes[:, [0, model.a.size + 1]] *= slope
    # over the whole confidence region of the weights
    chance, far = math.sqrt(chi2_quantile(1.0 - ALPHA, found.roots.shape[1])), 0.0
    for each in at:
        made = np.kron(each, changes[:, chosen])
        size, doubt = np.abs(made @ found.weights), chance * np.linalg.norm(made @ found.roots, axis=1)
        if shares is not None:  # with many columns G seems to differ at some frequency, by chance
            size, doubt = np.sqrt(shares @ size**2), np.sqrt(shares @ doubt**2)
        far = max(far, float(np.max(size - doubt)))
    return Depends(columns, far, effect)


class Told(NamedTuple):
    """A dependence of coefficients, with the texts for its finding."""

    columns: FloatArray  # (J, C): tested columns
    far: float  # lower bound of the relative change of G
    reason: str
    advice: str

    @property
    def findings(self) -> list[Finding]:
        """The finding on the change of G; none if it is negligible."""
        if not self.far > math.sqrt(NEGLIGIBLE):
            return []
        # a first-order result does not hold for a larger change
        reason = f"{self.reason.format(percent(min(self.far, 1.0)))}, where the input excites it"
        is_fault = self.far > LARGEST_ERROR
        return [Finding("inconsistent", f"{reason}; {self.advice}") if is_fault else Finding("trusted", reason)]


def _of_levels(acting: Acting, path: Path, residual: Residual, known: FloatArray) -> Told:
    """Test whether G depends on the level, within the levels of the record."""
    rows, far, before = acting.evidence.known, 0.0, known.shape[1]
    error = acting.runs.now.error[rows]
    for power in POWERS:
        if power > POWERS[0]:
            residual = residual_of(acting.evidence, error, known)
        factor = path.level**power
        visited = factor[path.before :][rows]
        ends = np.quantile(visited, ENDS) - visited.mean()  # the model describes the mean
        # power + 1: the slope of x^(p + 1), over x^p
        found = _depends(acting, path, residual, error, factor[:, None], ends[:, None], power + 1.0)
        if found is None:
            break
        far, error, known = max(far, found.far), error - found.effect, np.hstack([known, found.columns])
    return Told(known[:, before:], far, LEVELS, "it is not linear: keep nearer to one level, or fit a model at each")


def _of_direction(acting: Acting, path: Path, known: FloatArray) -> Told | None:
    """Test whether G depends on the direction; None if there are too few samples."""
    rows = acting.evidence.known
    factor = np.sign(path.states[:, 1:2])
    visited = factor[path.before :][rows]
    error = acting.runs.now.error[rows]
    residual = residual_of(acting.evidence, error, np.hstack([known, path.braked[rows]]))
    ends = np.array([[visited.min()], [visited.max()]]) - visited.mean()
    # with one pole x' jumps with the input, which in feedback answers the noise of the same sample
    at_end = np.sign(path.reached[:, 1:2])
    found = _depends(acting, path, residual, error, factor, ends, at_end=at_end)
    if found is None:
        return None
    return Told(found.columns, found.far, WAYS, "it is not linear: fit a model of the moves in each direction")


def _of_time(acting: Acting, path: Path, residual: Residual) -> Told | None:
    """Test whether G depends on the time; None if a change has been found already, or there are too few samples."""
    evidence, rows = acting.evidence, acting.evidence.known
    error = acting.runs.now.error[rows]
    waves = min(WAVES, int(error.size / PER_COEFFICIENT - residual.known.shape[1]) // evidence.coefficients)
    if waves < 1 or evidence.plant_change is not None:
        return None
    intervals = np.broadcast_to(path.record.intervals, path.states[:, 0].shape)
    part = np.cumsum(intervals) / float(intervals.sum())
    factors = np.cos(np.pi * part[:, None] * np.arange(1, waves + 1))
    visited = factors[path.before :][rows]
    at = visited[np.linspace(0, len(visited) - 1, POINTS * waves).astype(int)] - visited.mean(axis=0)
    found = _depends(acting, path, residual, error, factors, at, slow=True)
    if found is None:
        return None
    return Told(found.columns, found.far, TIMES, "identify shorter parts by themselves, or forget old samples")


def _of_friction(acting: Acting, path: Path, residual: Residual) -> list[Finding]:
    """Return a finding if dry friction explains a part of the residual and changes the coefficients."""
    braked = path.braked[acting.evidence.known]
    found = residual.explained(braked)
    if not (found.is_sure and found.weights[0] > 0.0):
        return []
    size = acting.size_of(braked, found.weights)
    if not size > FARTHEST:
        return []
    reason = f"the plant seems to have dry friction: without it a coefficient differs by {percent(size)}"
    return [Finding("inconsistent", f"{reason}; move it by more, or so that it does not turn round")]
