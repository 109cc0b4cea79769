r"""The score test: what a named alternative could explain of a model's residual, and whether that may be chance.

| alternative | columns of its score test |
|---|---|
| other dynamics | the input, the simulated output and their states, delayed by powers of two samples |
| a nonlinear plant | the square and the cube of the simulated output |
| the reference explains more | Laguerre functions of it, the square and the cube of what it makes of the output |
| another column of the file | those of other dynamics, made of it (`other_columns`) |
| actuator, hold, dead time | see `input_faults` |

Known columns Z, the model's own slopes and nuisances, have had their part already.  All are filtered by the
autoregression that whitens the residual e,

.. math:: w = D e, \qquad C' = D C - Z' (Z'^T Z')^{-1} Z'^T D C, \qquad Z' = D Z,

and what is left of the columns explains of w, where the model is right,

.. math:: w^T C' (C'^T C')^{-1} C'^T w / \sigma^2 \sim \chi^2.

As nothing of Z is left in C', the samples that the model was made from can test it.  Noise of more colour than D takes
widens the scores: by how much is seen in those of stretches of the record.  How large the part is, is told by the
columns as they are in the output.  Under feedback the input answers the residual of a right model, too, at once and
later: the columns of a sample hold only what was known before it (of a model with a direct path one sample late).

Sources: Rao (1948), "Large sample tests of statistical hypotheses concerning several parameters", Proc. Cambridge Phil.
Soc. 44; Ljung (1999), "System Identification: Theory for the User", sections 16.5 and 16.6; Soderstrom and Stoica
(1989), "System Identification", section 11.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import chi2_quantile, combined, products, sum_of_squares
from replant.numerics.projections import LEFT, TAKEN_AWAY, lengths_of, orthogonal
from replant.verdict.evidence import Evidence, Runs

LARGEST_PART = (1.0 / 16.0) ** 2
"""What an alternative could still explain, up to which a model is trusted with a caveat: a sixteenth of the output's
amplitude. With its doubt added it must stay below it [part of the output's power].
Origin: real plants are never quite linear, nor of finite order; an unknown dead time of half a time constant, which
moves the coefficients of three poles by a half, leaves .67 %.
Sensitivity: at 1 %, of 417 verdicts on right models of field records three more are "trusted", and that one.
"""

NEGLIGIBLE = 0.01 * MATTERS  # what could still be explained that is not worth a word [part of the output's power]
STRETCHES = 16  # of the record, whose scores tell their scatter: of two columns and more to a quarter [count]
WIDER = 4.0  # scatter of the scores beyond which it is no chance [standard deviations]


@dataclass(frozen=True, eq=False)
class Explained:
    """What an alternative could still explain of a residual."""

    weights: FloatArray  # (C,): of its columns
    power: float = 0.0  # mean square of the part, less its expected value under noise alone
    std: float = 0.0  # of ``power``
    statistic: float = 0.0  # over its limit: above 1 the part is no chance
    spread: float = math.inf  # standard deviation of the weight of a single column

    @property
    def is_sure(self) -> bool:
        """Whether the part is no chance."""
        return self.statistic > 1.0

    @property
    def is_large(self) -> bool:
        """Whether, of a part of the output's power, it may exceed what a trusted model may leave unexplained."""
        return self.power + self.std > LARGEST_PART

    def beside(self, evidence: Evidence, error: FloatArray, output: FloatArray) -> Explained:
        """Return it as a part of an output's power, found of an error (K,), over the samples of ``evidence.known``."""
        power = power_of(evidence, output)
        # as Python's floats, which become infinite without a warning where the output is constant
        most = float(np.var(error[evidence.used[evidence.known]]))
        return replace(self, power=min(float(self.power), most) / power, std=float(self.std) / power)


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual (K,) less what known columns explain of it, whitened, over the U samples used."""

    noise: Autoregression  # of the residual
    known: FloatArray  # (K, N): the known columns, scaled to one
    white_known: FloatArray  # (U, N): whitened
    from_known: FloatArray  # (N, R): what makes them orthonormal
    white: FloatArray  # (U,): the whitened residual
    lengths: FloatArray  # (N,): of the known columns as they were given
    past: IntArray  # (K,): how many samples in a row come before each
    used: BoolArray  # (K,)

    @classmethod
    def of(
        cls, error: FloatArray, known: FloatArray, past: IntArray, used: BoolArray, noise: Autoregression | None = None
    ) -> Residual:
        """Return that of an error (K,) and known columns (K, N); a constant is always known."""
        known = np.column_stack([known, np.ones(error.size)])
        lengths = lengths_of(known)
        known = known / lengths
        error = error - error[used].mean()
        noise = Autoregression.of_residual(error, past, error.size) if noise is None else noise
        white_known, white = noise.whiten_known(known, past)[used], noise.whiten_known(error, past)[used]
        basis = orthogonal(products(white_known, white_known))
        explained = basis @ (basis.T @ products(white_known, white[:, None])[:, 0])
        white = white - np.einsum("ij,j->i", white_known, explained)
        return cls(noise, known, white_known, basis, white, lengths, past, used)

    def beside(self, error: FloatArray, effect: FloatArray) -> Residual:
        """Return that of the same error (K,), whitened by the noise that an effect (K,) leaves of it."""
        left = error - effect
        noise = Autoregression.of_residual(left - left[self.used].mean(), self.past, left.size)
        return Residual.of(error, self.known[:, :-1], self.past, self.used, noise)

    def weights_of(self, columns: FloatArray) -> FloatArray:
        """Return the weights (N, C) with which the known columns make up for columns (K, C)."""
        along = products(self.white_known, self._whitened(columns))
        return np.asarray(self.from_known @ (self.from_known.T @ along) / self.lengths[:, None])

    def explained(self, columns: FloatArray, spent: int = 0) -> Explained:
        """Return what columns (K, C) could explain of it."""
        weights = np.zeros(columns.shape[1])
        columns = columns - columns[self.used].mean(axis=0)
        filtered = self._whitened(columns)
        before = lengths_of(filtered)
        along = self.from_known @ (self.from_known.T @ products(self.white_known, filtered))
        left = filtered - combined(self.white_known, along)
        lengths = lengths_of(left)
        told = columns.any(axis=0) & (lengths > LEFT * before) & (before > TAKEN_AWAY * lengths_of(columns))
        if not told.any() or not sum_of_squares(self.white) > 0.0:
            return Explained(weights)
        left = left[:, told] / lengths[told]
        whole = (columns - combined(self.known, along))[self.used][:, told] / lengths[told]
        basis = orthogonal(products(left, left))
        amounts = basis.T @ products(left, self.white[:, None])[:, 0]
        count, part = amounts.size, sum_of_squares(amounts)
        if not count:
            return Explained(weights)
        weights[told] = basis @ amounts / lengths[told]
        rest = self.white - combined(left, basis @ amounts)
        variance = sum_of_squares(rest) / max(self.white.size - count - self.from_known.shape[1], 1)
        if not variance > 0.0:
            return Explained(weights, float(np.mean((combined(whole, basis @ amounts)) ** 2)), 0.0, math.inf, 0.0)
        variance *= _widening(combined(left, basis), rest, variance)
        gram = basis.T @ products(whole, whole) @ basis
        output = gram @ amounts
        size = self.white.size
        power = (float(amounts @ output) - variance * float(np.trace(gram))) / size
        std = math.sqrt(variance * (2.0 * variance * float(np.sum(gram**2)) + 4.0 * sum_of_squares(output))) / size
        limit = variance * float(chi2_quantile(1.0 - ALPHA, max(count - spent, 1)))
        spread = math.sqrt(variance) / float(lengths[told][0]) if count == 1 else math.inf
        return Explained(weights, max(power, 0.0), std, part / limit, spread)

    def _whitened(self, columns: FloatArray) -> FloatArray:
        return np.asarray(self.noise.whiten_known(columns, self.past)[self.used])


def _widening(basis: FloatArray, rest: FloatArray, variance: float) -> float:
    """Return by how much colour widens the scores of stretches of a residual's rest (K,); 1 where it may be chance."""
    # of a white rest the squares of the scores have the mean of those of the columns (K, R) there, times its variance
    parts = np.array_split(np.arange(rest.size), STRETCHES)
    squares = sum(float(np.sum((products(basis[part], rest[part])) ** 2)) for part in parts)
    wider = squares / (basis.shape[1] * variance)
    chance = WIDER * math.sqrt(2.0 / (STRETCHES * basis.shape[1]))
    return wider if wider > 1.0 + chance else 1.0


def power_of(evidence: Evidence, output: FloatArray) -> float:
    """Return the variance of an output (K,) over the samples of ``evidence.known`` that are used; never zero."""
    return max(float(np.var(output[evidence.used[evidence.known]])), float(np.finfo(float).tiny))


def residual_of(evidence: Evidence, error: FloatArray, known: FloatArray) -> Residual:
    """Return the residual of an error (K,) and known columns (K, N) over the samples of ``evidence.known``."""
    return Residual.of(error, known, evidence.past, evidence.used[evidence.known])


def known_columns(evidence: Evidence, run: ModelRun) -> FloatArray:
    """Return what has had its part of the residual (K, N): the slopes only of an estimate made from the samples."""
    rows = evidence.known
    fitted = evidence.adapts and evidence.instruments
    return np.hstack([run.zeta[rows], run.nuisances[rows]]) if fitted else run.nuisances[rows]


def unexplained(
    evidence: Evidence, runs: Runs, *, feedback: bool = False, known: FloatArray | None = None
) -> Explained:
    """Return what other dynamics could explain, beside further known columns (K, N); under feedback by the past."""
    run, rows = runs.now, evidence.known
    error, own = run.error[rows], known_columns(evidence, run)
    residual = residual_of(evidence, error, own if known is None else np.hstack([own, known]))
    output = run.forced - run.forced[rows].mean()
    powers = np.column_stack([output**2, output**3])[rows]
    columns = np.hstack([dynamics(evidence, run, feedback=feedback), powers])
    return residual.explained(columns).beside(evidence, error, evidence.record.y[rows])


def unexplained_before(evidence: Evidence, runs: Runs) -> Explained:
    """Return what the input could explain of what the earlier estimate leaves of the samples that it has not used."""
    newest, run = replace(evidence, follows=True), runs.old  # `known` is then what was held out
    rows = newest.known
    residual = residual_of(newest, run.error[rows], run.nuisances[rows])
    # other coefficients are no less a fault of it than other dynamics are, as of a plant that has changed
    found = residual.explained(np.hstack([dynamics(newest, run), run.zeta[rows]]))
    part = found.beside(newest, run.error[rows], evidence.record.y[rows])
    # its own error counts as samples held out over samples learned
    return replace(part, statistic=part.statistic / (1.0 + evidence.held_out / max(evidence.learned, 1)))


def dynamics(evidence: Evidence, run: ModelRun, *, feedback: bool = False) -> FloatArray:
    """Return the columns (K, C) of other dynamics over the samples that the estimate should explain."""
    return run.dynamics(evidence.known, evidence.dt, evidence.record.span, feedback=feedback)
