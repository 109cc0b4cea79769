r"""The weights of a bank: dynamic model averaging over its members, begun with the evidence of the record.

While the record grows, the weights begin anew at growing counts with its evidence, as in the structure search
(`replant.fitting.structure_evidence`), so that poor predictions after a bad start of a member do not count.  Later
samples count by each member's prediction before it learns them (`replant.kernels.step.bank`).  Once the record is as
long as the memory of the weights, predictions alone count.

A model with a needless pole predicts as well as one without, once both are learned.  Forgetting therefore moves the
weights towards a prior that penalises each parameter by ln(RECENT) / 2, as the evidence of that many samples does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import prediction_error
from replant.fitting.structure_evidence import Evidence, numbers_of
from replant.kernels.schema import LAGS
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import quiet
from replant.online.estimate import Estimate

# the memory is the number of samples that the verdict uses, with a half-life of 6931 samples; with a tenth of it two
# structures must differ by ten times as much, as the penalty of a parameter hardly falls
FORGETTING = 1.0 - 1.0 / RECENT  # forgetting factor of the weights' evidence, per sample [number]

MOST = 10  # structures: a handful; replant fit searches more [count]
EVENTS = 100  # changes of the lead kept, the newest [count]
SIZE = LAGS + 1


@dataclass(frozen=True)
class Lead:
    """A change of the structure that is served.

    Attributes
    ----------
    taken : int
        Samples given before it.
    structure : Structure
        Structure of the model that is served from then on.
    weight : float
        Its weight.
    status : str
        Status of its verdict.
    """

    taken: int
    structure: Structure
    weight: float
    status: str


@dataclass(frozen=True, eq=False)
class Weights:
    """The weights of M members; `take` returns the weights after further samples."""

    joined: IntArray  # (M,): 1 if a member has a model and takes part, else 0
    prices: FloatArray  # (M,): logarithm of the prior
    logs: FloatArray  # (M,): logarithm of the weights, up to a constant; -inf for members that take no part
    least: float  # variance below which a residual is no evidence
    # errors, sums, autoregressions, variances and orders of the members, and shared numbers: see `weigh`
    past: FloatArray
    sums: FloatArray
    models: FloatArray
    variances: FloatArray
    orders: IntArray
    numbers: FloatArray
    counts: IntArray

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> Weights:
        """Return equal weights, before any member has a model."""
        count = len(structures)
        prices = np.array([-0.5 * numbers_of(each) * math.log(RECENT) for each in structures])
        models = np.zeros((count, SIZE, SIZE))
        models[:, :, 0] = 1.0
        return cls(
            np.zeros(count, np.int64), prices, np.full(count, -math.inf), 0.0, np.zeros((count, SIZE)),
            np.zeros((count, SIZE, SIZE)), models, np.ones((count, SIZE)), np.zeros(count, np.int64), np.zeros(1),
            np.zeros(3, np.int64),
        )  # fmt: skip

    @property
    def shares(self) -> FloatArray:
        """The weights (M,), whose sum is 1."""
        return shares_of(self.logs)

    def likeliest(self, before: int) -> int:
        """Return the most probable member; the one ``before`` unless another is 1 / `ALPHA` times as probable."""
        best = int(np.argmax(self.logs))
        if self.joined[before] and self.logs[best] - self.logs[before] <= -math.log(ALPHA):
            return before
        return best

    def take(self, errors: FloatArray) -> tuple[Weights, FloatArray]:
        """Take the a-priori errors (K, M) of the next samples; return the new state, and the weights (K, M)."""
        from replant.kernels.step.bank import weigh

        written = ("logs", "past", "sums", "models", "variances", "orders", "numbers", "counts")
        new, logs = replace(self, **{name: getattr(self, name).copy() for name in written}), np.empty(errors.shape)
        weigh(
            errors, new.joined, FORGETTING, new.least, new.prices, new.logs, new.past, new.sums, new.models,
            new.variances, new.orders, new.numbers, new.counts, logs, np.empty(36 + 2 * new.joined.size),
        )  # fmt: skip
        return new, shares_of(logs)

    def begun(self, members: Sequence[Estimate], since: int) -> Weights:
        """Return the weights by the evidence of the newest samples, after the first ``since`` accepted ones."""
        runs = {i: run for i, each in enumerate(members) if (run := _Run.of(each, since)) is not None}
        if not runs:
            return self
        # outliers by the member with the smallest error are left out for all: others have a wider scatter
        first = min(runs.values(), key=lambda run: run.scatter).record
        again = ((i, _Run.of(members[i], since, first.is_measured)) for i in runs)
        runs = {i: run for i, run in again if run is not None}
        evidence = Evidence(first, at_rest=False)
        new = Weights.of([each.structure for each in members])
        for i, run in runs.items():
            new.joined[i] = 1
            new.logs[i], noise = evidence.of_error(members[i].structure, run.error)
            new.sums[i], new.models[i], new.variances[i] = noise.sums, noise.models, noise.variances
            new.orders[i], new.numbers[0] = noise.order, noise.count if noise.sums.any() else 0.0
        return replace(new, least=evidence.least)


@dataclass(frozen=True, eq=False)
class _Run:
    """The run of a member's present model over the newest samples; the initial state is fitted to valid outputs."""

    record: Record  # with the outputs that count as measured
    error: FloatArray  # (K,)

    @property
    def scatter(self) -> float:
        """Median size of the error."""
        return float(np.median(np.abs(self.error[self.record.is_measured])))

    @classmethod
    @quiet
    def of(cls, member: Estimate, since: int, counts: BoolArray | None = None) -> _Run | None:
        """Return the run after the first ``since`` accepted samples, on valid outputs ``counts`` (K,); None: no run."""
        if member._settings is None:
            return None
        kept = RecentSamples.of(member._state)
        kept = kept[max(len(kept) - (member._state.samples - since), 0) :].since_last_gap(member.dt)
        record = kept.record(member.dt, member.input_hold)
        counts = record.is_measured & ~kept.is_bridged if counts is None else counts
        if counts.size != record.u.size or not counts.any():
            return None
        if not counts.all():
            record = replace(record, y=np.where(counts, record.y, kept.bridged), measured=counts)
        error = prediction_error(member.structure, member.parameters, record, member.dt)
        return None if error is None else cls(record, error)


def shares_of(logs: FloatArray) -> FloatArray:
    """Return weights (.., M) with a sum of 1 from their logarithms; equal ones if all are -inf.

    >>> shares_of(np.log([1.0, 3.0]))
    array([0.25, 0.75])
    """
    top = logs.max(axis=-1, keepdims=True)
    parts = np.exp(logs - np.where(np.isfinite(top), top, 0.0))
    total = parts.sum(axis=-1, keepdims=True)
    return np.where(total > 0.0, parts / np.where(total > 0.0, total, 1.0), 1.0 / logs.shape[-1])
