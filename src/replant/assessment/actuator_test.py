"""The test of the actuator: a static curve, or play, before the plant that is not linear.

A linear model is right for B/A behind a static curve or a play f only as far as f is straight.  What it leaves is
B/A (f(u) - k u).  So the residual is regressed on B/A of curves that stand for the usual actuators:

* v^3 and v^5, odd: the actuator saturates, or has a dead zone;
* abs(v), even: its gain is another one in the other direction;
* the play (backlash) of v, of two widths: it depends on where the input came from;

v being the input on a scale from -1 to 1.  What linear faults of a model leave (columns of the cross test) is taken
away from residual and columns first, and both are whitened.  An input of two levels cannot tell: all curves through two
points are straight lines.

Source: Ljung (1999), "System Identification: Theory for the User", sections 5.2 (Hammerstein models) and 16.6;
Krasnosel'skii and Pokrovskii (1989), "Systems with Hysteresis" (the play operator).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.cross_test import FALSE_ALARM, linear_columns
from replant.assessment.evidence import Evidence, Runs
from replant.assessment.unexplained_part import LARGEST_PART
from replant.assessment.verdict import Finding, percent
from replant.simulation.model_run import ModelRun, run_model
from replant.statistics.autoregression import Autoregression
from replant.statistics.chi2 import chi2_quantile
from replant.statistics.projections import lengths_of, orthogonal, products, without

WIDTHS = (0.2, 0.5)
"""Half widths of the plays tried [part of the largest input].
Origin: two of them explain the larger part of any play between 0.1 and 0.7.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEFT = 1e-3
"""Length of a curve's column beside what linear columns leave of it, below which the input cannot tell it from a
straight line [part of its length].
Origin: rounding and an initial state leave less of the columns of an input of two levels.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ADVICE = "stay where it is straight, or map the input by its curve"
SATURATES, DEAD = f"the actuator seems to saturate ({ADVICE})", f"the actuator seems to have a dead zone ({ADVICE})"
LOPSIDED = f"the actuator seems to have another gain in the other direction ({ADVICE})"
LOOSE = "the actuator seems to have play or friction (move it by more, or so that it comes from one side)"


def actuator_findings(evidence: Evidence, runs: Runs) -> list[Finding]:
    """Name the actuator's fault that explains most of the residual over all samples, if it is more than chance."""
    run, rows = runs.now, evidence.known
    power, whole = max(float(np.var(evidence.record.y[rows])), float(np.finfo(float).tiny)), evidence.record.joined
    v, before = _scaled(whole.u), whole.u.size - evidence.samples  # what acts comes through the actuator, too
    residual = Residual.of(run, rows, evidence.dt)
    surest, part, fault = 0.0, 0.0, ""
    for curves, (inward, outward) in _curves(v):
        weights, statistic, explained = residual.explained(_behind_the_plant(evidence, run, curves)[before:][rows])
        if statistic > surest:
            surest, part = statistic, explained / power
            fault = outward if _grows_outward(v[before:][rows], curves[before:][rows] @ weights) else inward
    # where linear columns explain more, it is the model that is wrong
    if not part > max(LARGEST_PART, residual.linear_part / power):
        return []
    reason = f"such a curve before the plant would explain another {percent(min(part, 1.0))} of the output's power"
    return [Finding("inconsistent", f"{fault}: {reason}")]


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual and what linear faults of the model leave of it, both as they are and whitened.

    Attributes
    ----------
    linear : (K, L) array
        Columns of the linear faults.
    noise : Autoregression
        Of the residual.
    white_linear : (K', L) array
    white : (K',) array
        The whitened residual, less what the linear columns explain.
    linear_part : float
        The power that they explain.
    """

    linear: FloatArray
    noise: Autoregression
    white_linear: FloatArray
    white: FloatArray
    linear_part: float

    @classmethod
    def of(cls, run: ModelRun, rows: slice, dt: float) -> Residual:
        """Return that of a run over some rows."""
        error = run.error[rows] - run.error[rows].mean()
        columns = linear_columns(run, rows, dt), run.zeta[rows], run.nuisances[rows], np.ones((error.size, 1))
        linear, noise = np.hstack(columns), Autoregression.of(error)
        white_linear, left = noise.whiten(linear), without(error[:, None], linear)[:, 0]
        white = without(noise.whiten(error)[:, None], white_linear)[:, 0]
        return cls(linear, noise, white_linear, white, float(np.var(error - left)))

    def explained(self, columns: FloatArray) -> tuple[FloatArray, float, float]:
        """Return the weights (C,) with which columns (K, C) explain the residual, how surely, and how much power.

        How surely: the chi-square statistic over its limit; 0 where it may be chance, or the columns are linear ones.
        """
        nothing = np.zeros(columns.shape[1]), 0.0, 0.0
        columns = columns - columns.mean(axis=0)
        left = without(columns, self.linear)
        if not (lengths_of(left) > LEFT * lengths_of(columns)).all():
            return nothing
        z = without(self.noise.whiten(columns), self.white_linear)
        lengths = lengths_of(z)
        z = z / lengths
        basis = orthogonal(products(z, z))
        amounts = basis.T @ products(z, self.white[:, None])[:, 0]
        part = float(amounts @ amounts)
        free = max(self.white.size - self.linear.shape[1] - len(amounts), 1)
        variance = max(float(self.white @ self.white) - part, 0.0) / free
        statistic = part / max(variance * chi2_quantile(1.0 - FALSE_ALARM, max(len(amounts), 1)), np.finfo(float).tiny)
        if not statistic > 1.0:
            return nothing
        weights = basis @ amounts / lengths
        return weights, statistic, float(np.var(left @ weights))


def _scaled(u: FloatArray) -> FloatArray:
    """Return an input on a scale from -1 to 1; zero stays where it is if the input lies on both sides of it."""
    low, high = float(u.min()), float(u.max())
    middle = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    return np.asarray((u - middle) / max(high - middle, middle - low))


def _curves(v: FloatArray) -> Iterator[tuple[FloatArray, tuple[str, str]]]:
    """Yield curves (K, C) of the scaled input, and what they are where they grow less and more than straight ones."""
    from replant.kernels.filters.play_operator import play  # compiled: imported where it is used

    yield np.column_stack([v**3, v**5]), (SATURATES, DEAD)
    yield np.abs(v)[:, None], (LOPSIDED, LOPSIDED)
    yield np.column_stack([play(v, width) for width in WIDTHS]), (LOOSE, LOOSE)


def _grows_outward(v: FloatArray, curve: FloatArray) -> bool:
    """Return whether a curve's values (K,), beside the straight line through them, grow with the distance from zero."""
    straight = np.column_stack([v, np.ones(v.size)])
    return float(without(curve[:, None], straight)[:, 0] @ without((v * np.abs(v))[:, None], straight)[:, 0]) > 0.0


def _behind_the_plant(evidence: Evidence, run: ModelRun, curves: FloatArray) -> FloatArray:
    """Return the model's outputs (K, C) where the input is replaced by each of the curves (K, C), from the first on."""
    outputs, whole = np.zeros_like(curves), evidence.record.joined
    for column, curve in enumerate(curves.T):
        ran = run_model(run.structure, run.parameters, replace(whole, u=curve.copy()), evidence.dt)
        if ran is not None:
            outputs[:, column] = ran.forced
    return outputs
