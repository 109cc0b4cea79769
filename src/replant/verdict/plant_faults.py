r"""Faults of the plant: coefficients that depend on the operating point, and dry friction.

| fault | columns of its score test |
|---|---|
| a coefficient depends on the operating point | x^p x^(i) through B/A, i to n; x^p x^(j), j to m; p = 1 and 2 |
| the plant has dry friction | the sign of x' through B/A |

x is the state of the model, 1/A u about its mean, the operating point where the model has no zeros the output itself.
A plant whose coefficients depend on it,

.. math:: \sum_i a_i(x) x^{(i)} = u, \quad y = \sum_j b_j(x) x^{(j)},

has, to first order, these columns beside the slopes of the linear model; a curve of the output is among them.  About a
level x the change :math:`w x^p x^{(i)}` is one of the coefficient by :math:`w x^p`, where i = 0 by p + 1 times that:
the curve's slope, and not its value, makes the gain.  What matters is what that makes of G about the levels that the
record visits: of the output's power, which the levels themselves make, it may be a small part.

The columns of a sample hold only what was known before it: in feedback they tell as much.  With a reference they are
made of what that explains of the input.  What other dynamics could explain is taken away before.

Sources: Toth (2010), "Modeling and Identification of Linear Parameter-Varying Systems"; Schetzen (1980), "The Volterra
and Wiener Theories of Nonlinear Systems"; Armstrong-Helouvry, Dupont and Canudas de Wit (1994), "A survey of models,
analysis tools and compensation methods for the control of machines with friction", Automatica 30.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.estimation.simulation.model_run import PER_COEFFICIENT
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ALPHA, NEGLIGIBLE
from replant.numerics.linear_algebra import chi2_quantile, combined
from replant.numerics.score_test import Explained
from replant.verdict.estimate_distance import LARGEST_ERROR, excited_frequencies
from replant.verdict.estimate_tests import FARTHEST
from replant.verdict.evidence import Evidence, Runs, rounding_of
from replant.verdict.input_faults import Acting
from replant.verdict.residual_tests import dynamics, residual_of
from replant.verdict.verdict import Finding, percent

POWERS = (1, 2)  # of the operating point: what depends on it, and what depends on how far away it is [exponents]
ENDS = (0.05, 0.95)  # between which nine samples in ten have their operating point [quantiles]


def plant_findings(acting: Acting) -> list[Finding]:
    """Say where coefficients depend on the operating point, or friction acts, and what that changes."""
    evidence, runs, loop = acting.evidence, acting.runs, acting.loop
    reference, rows = loop.reference, evidence.known
    used = evidence.used[rows]
    if not runs.now.error[rows][used].std() > rounding_of(runs.now.forced[rows], evidence.record.y[rows][used]):
        return []  # rounding follows from the path, too
    path = Path.of(evidence, acting.input if reference is not None else None)
    if path is None:
        return []
    linear = dynamics(evidence, runs.now, feedback=loop.feedback.found) if reference is None else reference.states[rows]
    drift = np.linspace(-1.0, 1.0, len(linear))[:, None]  # of the output, or left of one that was taken off
    known = np.hstack([acting.known, linear, drift])
    return _of_levels(evidence, runs, path, known) + _of_friction(acting, path, known)


@dataclass(frozen=True, eq=False)
class Path:
    """The state of a model B/A over a record of K samples."""

    model: Model
    record: Record  # with all samples that act, from a level of zero on
    states: FloatArray  # (K, n + 1): x, x' .. of the record, x about its mean over the samples that are tested
    before: int  # samples of the record that come before those of the evidence

    @classmethod
    def of(cls, evidence: Evidence, by_reference: FloatArray | None = None) -> Path | None:
        """Return that over a record, or of an input (K,) that a reference explains; None where it leaves float64."""
        whole = (
            evidence.record.joined if by_reference is None else replace(evidence.record, u=by_reference, before=None)
        )
        # a plant is at rest at its first input, but for one that integrates
        rests = float(np.abs(evidence.poles).min()) * evidence.record.span > 1.0
        # another load, or the begin of another log, changes the output's level and not x
        record = replace(whole, u=whole.u - whole.u[0] if rests else whole.u, measured=None, begins=())
        model, before = Model(evidence), whole.u.size - evidence.samples
        states = model.states(record, evidence.dt)
        if not np.isfinite(states).all():
            return None
        states[:, 0] -= states[before:][evidence.known, 0].mean()
        return cls(model, record, states, before)

    @property
    def level(self) -> FloatArray:
        """The operating point (K,), of the size one."""
        x = self.states[:, 0]
        return np.asarray(x / max(float(x[self.before :].std()), float(np.finfo(float).tiny)))


class Model:
    """B/A, run over records."""

    def __init__(self, evidence: Evidence) -> None:
        structure = evidence.structure
        self.structure, self.dt, self.hold = structure, evidence.dt, evidence.record.input_hold
        self.a, self.b = evidence.estimate[structure.denominator], evidence.estimate[structure.numerator]

    def states(self, record: Record, dt: float) -> FloatArray:
        """Return x, x' .. and the derivative n of x = 1/A u (K, n + 1)."""
        n = self.structure.poles
        full = Structure(n, n, self.structure.delay, feedthrough=True)
        return self._of(full, dt, self.hold, record)[:, full.numerator][:, ::-1].copy()

    def output(self, inputs: FloatArray, record: Record, dt: float) -> FloatArray:
        """Return B/A of held inputs (K, C), without the dead time, which they have already."""
        structure, outputs = replace(self.structure, delay=0.0, bias=False), np.empty_like(inputs)
        for outcome, u in zip(outputs.T, inputs.T, strict=True):
            slopes = self._of(structure, dt, "zoh", replace(record, u=u.copy()))
            outcome[:] = combined(slopes[:, structure.numerator], self.b)
        return outputs

    def changes(self, states: FloatArray, record: Record, dt: float, level: FloatArray, power: int) -> FloatArray:
        """Return what changes of a_0 .. a_n, b_0 .. b_m by a level's power make of the output (K, n + m + 2)."""
        factor, after = level[:, None] ** power, states[1:].copy()
        if self.hold == "zoh":  # the derivative n jumps with the input: at the end of a sample it is that of its input
            low = self.a[::-1]
            after[:, -1] = states[:-1, -1] + combined(states[:-1, :-1] - after[:, :-1], low)
        changed = factor * states
        held = changed.copy()  # what moves within a sample is held at its mean: its error is of second order
        held[:-1] = 0.5 * (changed[:-1] + factor[1:] * after)
        return np.hstack([-self.output(held, record, dt), changed[:, : self.structure.zeros + 1]])

    def changes_of_response(self, omega: FloatArray) -> npt.NDArray[np.complex128]:
        """Return what changes of a_0 .. a_n, b_0 .. b_m make of G at frequencies (F,), over G, (F, n + m + 2)."""
        powers = (1j * omega)[:, None] ** np.arange(self.a.size + 1)
        a, b = powers @ np.append(self.a[::-1], 1.0), powers[:, : self.b.size] @ self.b[::-1]
        return np.hstack([-powers / a[:, None], powers[:, : self.b.size] / b[:, None]])

    def _of(self, structure: Structure, dt: float, hold: str, record: Record) -> FloatArray:
        model = AuxiliaryModel(structure, dt, hold)
        theta = np.zeros(model.entries)
        theta[structure.denominator] = self.a
        return model.run(theta, record).phi


def _of_levels(evidence: Evidence, runs: Runs, path: Path, known: FloatArray) -> list[Finding]:
    """Say where G is another one at other levels of the record."""
    level, rows, far = path.level, evidence.known, 0.0
    error, visited = runs.now.error[rows], level[path.before :][rows]
    for power in POWERS:
        columns = path.model.changes(path.states, path.record, evidence.dt, level, power)[path.before :][rows]
        if known.shape[1] + columns.shape[1] > error.size / PER_COEFFICIENT:
            break
        residual = residual_of(evidence, error, known)
        found = residual.explained(columns)
        known = np.hstack([known, columns])
        if not found.is_sure:
            continue
        effect = residual.left_of(columns, found.weights)
        found = residual.beside(error, effect).explained(columns)
        factor = visited**power
        ends = np.quantile(factor, ENDS) - factor.mean()  # the model has the mean
        size = float(np.abs(ends).max()) * _change_of_response(evidence, path.model, found, power)
        far, error = max(far, size), error - effect
    if not far > math.sqrt(NEGLIGIBLE):
        return []
    # what is of first order tells no more of a larger change
    least = percent(min(far, 1.0))
    reason = f"the plant acts otherwise at other levels: within those of the record G differs by {least} at least"
    if not far > LARGEST_ERROR:
        return [Finding("trusted", f"{reason}, at a frequency that the input excites")]
    advice = "it is not linear: keep nearer to one level, or fit a model at each"
    return [Finding("inconsistent", f"{reason}, at a frequency that the input excites; {advice}")]


def _change_of_response(evidence: Evidence, model: Model, found: Explained, power: int) -> float:
    """Return by how much G changes surely at a level of one, as a part of it, at an excited frequency."""
    changes = model.changes_of_response(excited_frequencies(evidence))
    changes[:, [0, evidence.structure.poles + 1]] *= power + 1.0  # the slope of x^(p + 1), over x^p
    # whichever the weights are of those that are no chance
    chance = math.sqrt(chi2_quantile(1.0 - ALPHA, found.roots.shape[1]))
    surely = np.abs(changes @ found.weights) - chance * np.linalg.norm(changes @ found.roots, axis=1)
    return max(float(surely.max()), 0.0)


def _of_friction(acting: Acting, path: Path, known: FloatArray) -> list[Finding]:
    """Say where dry friction explains a part of the residual, and what that changes."""
    evidence, rows = acting.evidence, acting.evidence.known
    braked = -path.model.output(np.sign(path.states[:, 1:2]), path.record, evidence.dt)[path.before :][rows]
    found = residual_of(evidence, acting.runs.now.error[rows], known).explained(braked)
    if not (found.is_sure and found.weights[0] > 0.0):
        return []
    size = acting.size_of(braked, found.weights)
    if not size > FARTHEST:
        return []
    reason = f"the plant seems to have dry friction: without it a coefficient differs by {percent(size)}"
    return [Finding("inconsistent", f"{reason}; move it by more, or so that it does not turn round")]
