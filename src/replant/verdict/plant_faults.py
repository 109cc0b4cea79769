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
from replant.verdict.alternatives import WAVES, Acting, half_periods, power_of
from replant.verdict.estimate_distance import CONTRADICTS, LARGEST_ERROR, excited_frequencies
from replant.verdict.estimate_tests import FARTHEST
from replant.verdict.evidence import Evidence, rounding_of
from replant.verdict.loop import colour_left
from replant.verdict.verdict import Finding, percent

POWERS = (1, 2)  # powers of the operating point: odd for its sign, even for its distance from the mean [exponents]
ENDS = (0.05, 0.95)  # quantiles of the operating point between which G is compared: 90 % of samples [quantiles]

LEVELS = "the plant acts otherwise at other levels: within those of the record G differs by {} at least"
WAYS = "the plant acts otherwise on its way up than on its way down: G differs from the model by {} at least"
TIMES = "the plant changes as the record goes on: G differs from the model by {} in the mean"


def plant_findings(*inputs: Acting, in_time: bool = True) -> list[list[Finding]]:
    """Return findings for each input if coefficients depend on level, direction or time, or on dry friction.

    A plant behind one input that is not linear, or changes, looks like a change behind the others, too: of the
    dependences on all inputs the most significant one counts.
    """
    found = [_of_plant(each, in_time=in_time) for each in inputs]
    surest = max((told.statistic for told, _ in found if told is not None), default=0.0)
    return [
        [*(told.findings if told is not None and told.statistic == surest else []), *friction]
        for told, friction in found
    ]


def _of_plant(acting: Acting, *, in_time: bool) -> tuple[Dependence | None, list[Finding]]:
    """Return the most significant dependence that changes G, None without one, and findings on dry friction."""
    evidence, runs, rows = acting.evidence, acting.runs, acting.rows
    used = evidence.used[rows]
    if not acting.error[used].std() > rounding_of(runs.now.forced[rows], evidence.record.y[rows][used]):
        return None, []  # rounding depends on the path, too
    path = Path.of(evidence, None if acting.loop.reference is None else acting.input)
    if path is None:
        return None, []
    told = [_of_levels(acting, path), _of_direction(acting, path), *([_of_time(acting, path)] if in_time else [])]
    surest = _surest(acting, [each for each in told if each is not None and each.findings])
    return surest, _of_friction(acting, path)


def _surest(acting: Acting, told: list[Dependence]) -> Dependence | None:
    """Return the dependence that is most significant beside the others, as they overlap; None if there is none."""

    def beside(one: Dependence) -> float:
        others = np.hstack([each.columns for each in told if each is not one])
        return acting.beyond_dynamics.knowing(others).explained(one.columns).statistic

    return max(told, key=beside if told[1:] else lambda one: one.statistic, default=None)


@dataclass(frozen=True, eq=False)
class Path:
    """The state of a model B/A over a record of K samples."""

    structure: Structure
    a: FloatArray  # (n,)
    b: FloatArray  # (m + 1,)
    dt: float
    record: Record  # with all samples that act; starts at an input of zero
    states: FloatArray  # (K, n + 1): x, x' .. of the record, x minus its mean over the samples that are tested
    tested: slice  # these

    @classmethod
    def of(cls, evidence: Evidence, by_reference: FloatArray | None = None) -> Path | None:
        """Return the path over a record, or by the input (K,) that a reference explains; None if it exceeds float64."""
        structure, n = evidence.structure, evidence.structure.poles
        a, b = evidence.estimate[structure.denominator], evidence.estimate[structure.numerator]
        whole = (
            evidence.record.joined if by_reference is None else replace(evidence.record, u=by_reference, before=None)
        )
        # a plant is at rest at its first input, unless it integrates
        rests = float(np.abs(evidence.poles).min()) * evidence.record.span > 1.0
        # a new load, or the begin of another log, changes the output's level and not x
        record = replace(whole, u=whole.u - whole.u[0] if rests else whole.u, measured=None, begins=())
        full = Structure(n, n, structure.delay, feedthrough=True)
        model = AuxiliaryModel(full, evidence.dt, record.input_hold)
        theta = np.zeros(model.entries)
        theta[full.denominator] = a
        states = model.run(theta, record).phi[:, full.numerator][:, ::-1].copy()
        if not np.isfinite(states).all():
            return None
        before = whole.u.size - evidence.samples
        tested = slice(before + evidence.known.start, before + evidence.known.stop)
        states[:, 0] -= states[tested, 0].mean()
        return cls(structure, a, b, evidence.dt, record, states, tested)

    @cached_property
    def reached(self) -> FloatArray:
        """The states (K, n + 1) just before each sample: with a held input the n-th derivative jumps there."""
        states, reached = self.states, self.states.copy()
        if self.record.input_hold == "zoh":  # until then it follows from the input of the sample before
            reached[1:, -1] = states[:-1, -1] + combined(states[:-1, :-1] - states[1:, :-1], self.a[::-1])
        return reached

    def output(self, inputs: FloatArray) -> FloatArray:
        """Return the outputs of B/A by held inputs (K, C), without the dead time, which these include already."""
        poles = roots(np.append(1.0, self.a))  # unstable ones are reflected, as in the states
        stable = np.poly(-np.abs(poles.real) + 1j * poles.imag).real
        plant = TransferFunction(self.b, np.asarray(stable, np.float64))
        return responses(plant, inputs, self.record, self.dt, "zoh")

    def changes(self, factor: FloatArray, at_end: FloatArray, *, slow: bool = False) -> FloatArray:
        """Return the changes of the output (K, n + m + 2) by changes of a_0 .. a_n, b_0 .. b_m by a factor.

        ``factor`` (K,) is the value from each sample on, ``at_end`` (K,) just before; ``slow`` leaves a_n out.
        """
        last, at_end = self.states.shape[1] - slow, at_end[:, None]
        held = factor[:, None] * self.states[:, :last]
        # a signal that varies within a sample is held at its mean, with an error of second order
        held[:-1] = 0.5 * (held[:-1] + at_end[1:] * self.reached[1:, :last])
        own = at_end * self.states[:, : self.structure.zeros + 1]
        return np.hstack([-self.output(held), own])

    def changes_of_response(self, omega: FloatArray) -> npt.NDArray[np.complex128]:
        """Return the relative changes of G at frequencies (F,) by a_0 .. a_n, b_0 .. b_m, (F, n + m + 2)."""
        powers = (1j * omega)[:, None] ** np.arange(self.a.size + 1)
        a, b = powers @ np.append(self.a[::-1], 1.0), powers[:, : self.b.size] @ self.b[::-1]
        return np.hstack([-powers / a[:, None], powers[:, : self.b.size] / b[:, None]])

    @cached_property
    def braked(self) -> FloatArray:
        """The change of the output (J, 1) by dry friction."""
        return -self.output(np.sign(self.states[:, 1:2]))[self.tested]


@dataclass(frozen=True, eq=False)
class Varying:
    """A factor on which coefficients may depend; G is compared at some of its values, or over the whole record."""

    reason: str
    advice: str
    factors: FloatArray  # (K, S)
    at: FloatArray | None = None  # (P, S): values less their mean; None for a slow change, compared in the mean square
    at_end: FloatArray | None = None  # (K, S): the factors just before each sample, if they jump there
    slope: float = 1.0  # factor on the changes by a_0 and b_0, see the top of the file


class Dependence(NamedTuple):
    """The result of a test whether coefficients depend on something."""

    on: Varying
    columns: FloatArray  # (J, C): tested columns
    error: FloatArray  # (J,): minus the effect of the columns, if significant
    residual: Residual  # whitened by the noise of this error
    statistic: float = 0.0  # over its limit
    far: float = 0.0  # lower bound of the relative change of G, of a slow one in the mean; 0 if not significant

    @property
    def findings(self) -> list[Finding]:
        """The finding on the change of G; none if it is negligible."""
        # a smaller change in time looks like noise that is not the same all along
        if not self.far > (CONTRADICTS if self.on.at is None else math.sqrt(NEGLIGIBLE)):
            return []
        # a first-order result does not hold for a larger change
        reason = f"{self.on.reason.format(percent(min(self.far, 1.0)))}, where the input excites it"
        is_fault = self.far > LARGEST_ERROR
        return [Finding("inconsistent", f"{reason}; {self.on.advice}") if is_fault else Finding("trusted", reason)]


def _dependence(acting: Acting, path: Path, error: FloatArray, residual: Residual, on: Varying) -> Dependence | None:
    """Test the residual of an error (J,) for coefficients that depend on a factor; None if samples are too few."""
    both = zip(on.factors.T, on.factors.T if on.at_end is None else on.at_end.T, strict=True)
    columns = np.hstack([path.changes(*each, slow=on.at is None)[path.tested] for each in both])
    if residual.known.shape[1] + columns.shape[1] > error.size / PER_COEFFICIENT:
        return None
    found = residual.explained(columns)
    if not found.is_sure:
        return Dependence(on, columns, error, residual)
    effect = residual.left_of(columns, found.weights)
    error, residual = error - effect, residual.beside(error, effect)
    found = residual.explained(columns)
    if on.at is None:
        evidence = acting.evidence
        left = np.where(evidence.used[acting.rows], error, np.nan)
        # colour that the noise model leaves widens the score: slow noise resembles a slow change
        if not found.statistic > colour_left(left, evidence.past):
            return Dependence(on, columns, error, residual)
        # the mean square of the change of G, less what other dynamics and a drift may explain of its effect, too
        part = max(found.power - found.std, 0.0) / power_of(acting.evidence, acting.output[acting.rows])
        return Dependence(on, columns, error, residual, found.statistic, math.sqrt(part))
    changes = path.changes_of_response(excited_frequencies(acting.evidence))
    changes[:, [0, path.a.size + 1]] *= on.slope
    # over the whole confidence region of the weights
    chance, far = math.sqrt(chi2_quantile(1.0 - ALPHA, found.roots.shape[1])), 0.0
    for each in on.at:
        made = np.kron(each, changes)
        size, doubt = np.abs(made @ found.weights), chance * np.linalg.norm(made @ found.roots, axis=1)
        far = max(far, float(np.max(size - doubt)))
    return Dependence(on, columns, error, residual, found.statistic, far)


def _of_levels(acting: Acting, path: Path) -> Dependence | None:
    """Test whether G depends on the level, within those of the record; None if there are too few samples."""
    x = path.states[:, 0]
    level = x / max(float(x[-acting.evidence.samples :].std()), float(np.finfo(float).tiny))  # of the size one
    error, residual = acting.error, acting.beyond_dynamics
    found: list[Dependence] = []
    for power in POWERS:
        if found:
            error, residual = found[-1].error, found[-1].residual.knowing(found[-1].columns)
        factor = level**power
        ends = np.quantile(factor[path.tested], ENDS) - factor[path.tested].mean()
        advice = "it is not linear: keep nearer to one level, or fit a model at each"
        # power + 1: the slope of x^(p + 1), over x^p
        on = Varying(LEVELS, advice, factor[:, None], ends[:, None], slope=power + 1.0)
        told = _dependence(acting, path, error, residual, on)
        if told is None:
            break
        found.append(told)
    if not found:
        return None
    columns = np.hstack([each.columns for each in found])
    return found[-1]._replace(columns=columns, far=max(each.far for each in found))


def _of_direction(acting: Acting, path: Path) -> Dependence | None:
    """Test whether G depends on the direction; None if there are too few samples."""
    factor = np.sign(path.states[:, 1:2])
    visited = factor[path.tested]
    ends = np.array([[visited.min()], [visited.max()]]) - visited.mean()
    # with one pole x' jumps with the input, which in feedback answers the noise of the same sample
    advice = "it is not linear: fit a model of the moves in each direction"
    on = Varying(WAYS, advice, factor, ends, at_end=np.sign(path.reached[:, 1:2]))
    return _dependence(acting, path, acting.error, acting.beyond_dynamics.knowing(path.braked), on)


def _of_time(acting: Acting, path: Path) -> Dependence | None:
    """Test whether G depends on the time; None if a change has been found already, or there are too few samples."""
    evidence, residual = acting.evidence, acting.beyond_dynamics
    waves = min(WAVES, int(acting.error.size / PER_COEFFICIENT - residual.known.shape[1]) // evidence.coefficients)
    if waves < 1 or evidence.plant_change is not None:
        return None
    intervals = np.broadcast_to(path.record.intervals, path.states[:, 0].shape)
    part = np.cumsum(intervals) / float(intervals.sum())
    factors, advice = half_periods(part), "identify shorter parts by themselves, or forget old samples"
    # one wave detects a step or a drift best; more of them are needed for a change there and back
    changes = (Varying(TIMES, advice, factors[:, : 2**k]) for k in range(waves.bit_length()))
    found = (_dependence(acting, path, acting.error, residual, each) for each in changes)
    return max(filter(None, found), key=lambda each: each.far, default=None)


def _of_friction(acting: Acting, path: Path) -> list[Finding]:
    """Return a finding if dry friction explains a part of the residual and changes the coefficients."""
    found = acting.beyond_dynamics.explained(path.braked)
    if not (found.is_sure and found.weights[0] > 0.0):
        return []
    size = acting.size_of(path.braked, found.weights)
    if not size > FARTHEST:
        return []
    reason = f"the plant seems to have dry friction: without it a coefficient differs by {percent(size)}"
    return [Finding("inconsistent", f"{reason}; move it by more, or so that it does not turn round")]
