"""One record through the online default and through `replant.fit`, beside the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import replant as rp
from accuracy.information import cramer_rao
from campaign.plants import Experiment
from replant.errors import ReplantError
from replant.numerics.arguments import FloatArray

GOOD = 90.0  # %: a model that explains at least so much of the output without noise is a good one
WORST = -100.0  # %: fits below are all alike
SIGMAS = 3.0
COLOURS = {"white": 0.0, "AR(.9)": 0.9}  # noises whose Cramer-Rao bound is known


@dataclass(frozen=True)
class Outcome:
    """What came of one record.

    Attributes
    ----------
    number : int
    what : str
        The experiment in words.
    noise : str
    stilled : bool
        Whether it is "not excited" because its input has come to rest: before that it was excited.
    offline, online : float
        Simulated fit of the output without noise, in percent.
    starting : bool
        Whether the online default has no model at the end.
    status, reason : str
        The verdict.
    deviation : float
        Largest error of a coefficient in its standard deviations, 0 where these are infinite; NaN without a model or a
        standard deviation.
    unknown : bool
        Whether the standard deviations are infinite, because a pole and a zero may cancel.
    beside_bound : float
        Root mean square of the coefficients' errors over their Cramer-Rao bound; NaN where that is not known.
    """

    number: int
    what: str
    noise: str
    stilled: bool
    offline: float
    online: float
    starting: bool
    status: str
    reason: str
    deviation: float
    unknown: bool
    beside_bound: float

    @property
    def is_good(self) -> bool:
        """Whether the online model explains the output."""
        return self.online >= GOOD


def judged(experiment: Experiment) -> Outcome:
    """Identify the plant of an experiment in one pass, and offline."""
    ident = identified(experiment, experiment.u.size)
    starting = ident.status == "starting"
    verdict = ident.assess()
    stilled = experiment.rests and verdict.status == "not excited"
    if stilled:
        moved = int(np.flatnonzero(experiment.u != experiment.u[-1])[-1]) + 1
        stilled = identified(experiment, moved).assess().status != "not excited"
    online = WORST if starting else explained(ident.transfer_function, experiment.u, experiment.clean, experiment.dt)
    try:
        fitted = rp.fit(experiment.u, experiment.y, experiment.dt, experiment.structure)
        offline = explained(fitted.transfer_function, experiment.u, experiment.clean, experiment.dt)
    except ReplantError:
        offline = WORST
    off = np.full(experiment.truth.size, math.nan) if starting else ident.parameters[: experiment.truth.size]
    off = off - experiment.truth
    std = None if starting else ident.uncertainty.std[: off.size]
    n, m = experiment.structure.poles, experiment.structure.zeros
    noisy = "no noise" if experiment.noise == "none" else f"{experiment.noise} {experiment.decibels:.0f} dB"
    return Outcome(
        experiment.number,
        f"{n} poles, {m} zeros, {experiment.input}, {noisy}, {experiment.u.size} samples"
        + (", comes to rest" if experiment.rests else ""),
        experiment.noise,
        stilled,
        offline,
        online,
        starting,
        verdict.status,
        verdict.reasons[0],
        _deviation(off, std),
        std is not None and bool(np.isinf(std).all()),
        _beside_bound(off, experiment),
    )


def identified(experiment: Experiment, samples: int) -> rp.Identifier:
    """Return the online default after a record's first samples, finished."""
    ident = rp.Identifier(experiment.structure, experiment.dt)
    ident.update_many(experiment.u[:samples], experiment.y[:samples])
    ident.finish()
    return ident


def explained(model: rp.TransferFunction, u: FloatArray, clean: FloatArray, dt: float) -> float:
    """Return the simulated fit of an output without noise (K,), in percent."""
    with np.errstate(over="ignore", invalid="ignore"):
        left = clean - model.simulate(u, dt)
        fit = 100.0 * (1.0 - float(np.linalg.norm(left - left.mean()) / _size(clean)))
    return max(fit, WORST) if math.isfinite(fit) else WORST


def _size(signal: FloatArray) -> float:
    return float(np.linalg.norm(signal - signal.mean()))


def _deviation(off: FloatArray, std: FloatArray | None) -> float:
    if std is None or not (std > 0.0).all():
        return math.nan
    return float(np.abs(off / std).max())


def _beside_bound(off: FloatArray, experiment: Experiment) -> float:
    if experiment.noise not in COLOURS or not np.isfinite(off).all():
        return math.nan
    try:
        bound = cramer_rao(
            experiment.plant, experiment.u, experiment.dt, experiment.decibels, COLOURS[experiment.noise]
        )  # fmt: skip
    except np.linalg.LinAlgError:
        return math.nan
    return float(np.sqrt(np.mean((off / bound) ** 2))) if (bound > 0.0).all() else math.nan
