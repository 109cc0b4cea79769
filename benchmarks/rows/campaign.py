"""Random rows through the identifier beside the truth, and how often the start leads to the minimum near the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import replant as rp
from campaign.outcome import GOOD, WORST
from replant.estimation.simulation.miso import Row, RowRecord, evaluate
from replant.estimation.solver.miso_steps import refine, start
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from rows.known import steps
from rows.plants import Experiment, drawn, drawn_plant, scaled

BESIDE = 1.0001  # cost of a start's minimum over that of the one near the truth, up to which they are the same
LIKE = (-0.35, 0.35)  # of the branches of a start: the powers of ten of their sizes
STARTED, STARTED_BY = 2000, 10.0**-0.5  # samples; deviation of the noise beside the output's


@dataclass(frozen=True)
class Outcome:
    """What came of one record: the fit of the output without noise in percent, and the verdict."""

    number: int
    what: str
    fit: float
    status: str
    reason: str
    deviation: float  # largest error of a coefficient, in its standard deviations

    @property
    def is_good(self) -> bool:
        """Whether the model explains the output."""
        return self.fit >= GOOD


def judged(seed: int, inputs: int, number: int) -> Outcome:
    """Identify one record in one pass, solved again as a whole at its end, as `fit` does."""
    made = drawn(seed, number, inputs)
    ident = rp.Identifier(**made.asked, dt=made.dt)
    ident.update_many(made.u, made.y)
    ident.finish()
    verdict, fit, deviation = ident.assess(), WORST, math.nan
    if ident.has_model:
        fit = explained(ident.transfer_functions, made)
        std = np.sqrt(np.diag(ident.covariance))
        if (std > 0.0).all():
            deviation = float(np.abs((ident.parameters - made.truth) / std).max())
    return Outcome(made.number, made.what, fit, verdict.status, verdict.reasons[0], deviation)


def explained(plant: Sequence[rp.TransferFunction], made: Experiment) -> float:
    """Return the simulated fit of an output without noise, in percent."""
    with np.errstate(all="ignore"):
        parts = [g.simulate(each.copy(), made.dt) for g, each in zip(plant, made.u.T, strict=True)]
        left = made.clean - np.sum(parts, axis=0)
        spread = float(np.linalg.norm(made.clean - made.clean.mean()))
        fit = 100.0 * (1.0 - float(np.linalg.norm(left - left.mean())) / spread)
    return max(fit, WORST) if math.isfinite(fit) else WORST


def lines(found: Sequence[Outcome]) -> Iterator[tuple[str, str, str]]:
    """Yield what was counted, how many, and what is wanted."""
    good, bad = ([one for one in found if one.is_good is which] for which in (True, False))
    yield "records explained to over 90 %", f"{len(good)} of {len(found)}", ""
    for name, group, share in (("good", good, "at least 93 %"), ("bad", bad, "at most 2 %")):
        trusted = sum(one.status == "trusted" for one in group)
        yield f"{name} models that are trusted", f"{trusted} of {len(group)}", share


def is_started(seed: int, inputs: int, correlation: float, number: int) -> bool:
    """Return whether the start leads to the minimum near the truth, of one or two poles each, white noise of 10 dB."""
    rng = np.random.default_rng([seed, number, inputs, 5])
    plant, dt = drawn_plant(rng, inputs, orders=(1, 2), zeros=0)
    u = steps(rng, STARTED, inputs)
    u[:, 1:] = correlation * u[:, :1] + np.sqrt(1.0 - correlation**2) * u[:, 1:]
    plant, parts = scaled(rng, plant, u, dt, LIKE)
    clean = parts.sum(axis=1)
    y = clean + STARTED_BY * clean.std() * rng.standard_normal(STARTED)
    structures = tuple(rp.Structure(g.den.size - 1, g.num.size - 1, delay=g.delay) for g in plant)
    ready = RowRecord.of(u, y, dt)
    row = Row(structures, ready.record, ready.inputs)
    white = Autoregression.white(1.0, row.count)
    truth: FloatArray = np.concatenate([np.append(g.den[1:], g.num) for g in plant])
    near = refine(row, truth, white, evaluate(row, truth, white)).cost
    costs = [refine(row, point.theta, white, point).cost for point in start(structures, row.record, row.inputs)]
    return min(costs, default=math.inf) <= BESIDE * near
