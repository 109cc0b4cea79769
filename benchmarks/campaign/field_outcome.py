"""One record of the field through `replant.fit` and the online default, beside the anchor and the truth."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.linalg import lstsq

import replant as rp
from campaign.anchor import anchor
from campaign.exact import Clock, forced, free, poles_apart
from campaign.field import BEFORE, FieldRecord, drawn
from campaign.outcome import GOOD, WORST
from replant.errors import ReplantError

EARLIER = 8  # samples before the record whose inputs may still act through the dead time


@dataclass(frozen=True)
class Estimate:
    """What one way of identification gave.

    Attributes
    ----------
    fit : float
        Of the output without noise, in percent.
    response : float
        Of the plant's response to the input alone, in percent: of a plant that was pushed before the record, the output
        is that and what the push left, which a model may explain that knows little of the input's effect.
    status, reason : str
        The verdict.
    seconds : float
        Processor time of the estimate.
    judging : float
        Processor time of the verdict.
    """

    fit: float
    response: float
    status: str
    reason: str
    seconds: float
    judging: float

    @property
    def is_good(self) -> bool:
        """Whether it explains the output."""
        return self.fit >= GOOD

    @property
    def is_right(self) -> bool:
        """Whether it explains the response to the input, too."""
        return self.is_good and self.response >= GOOD

    @property
    def is_trusted(self) -> bool:
        """Whether its verdict is so."""
        return self.status == "trusted"


@dataclass(frozen=True)
class FieldOutcome:
    """What came of one record.

    Attributes
    ----------
    number : int
    what : str
        The record in words.
    half : bool
        Whether its dead time lies between two samples.
    features : tuple of str
        What the record has.
    anchor : float
        Fit of the anchor, in percent.
    anchor_seconds : float
    offline, finished, running : Estimate
        Of `replant.fit`, and of the online default with and without `finish`.
    """

    number: int
    what: str
    half: bool
    features: tuple[str, ...]
    anchor: float
    anchor_seconds: float
    offline: Estimate
    finished: Estimate
    running: Estimate


@cache
def warm_up() -> None:
    """Import what is imported at its first use, once a process, so that no record's time has it."""
    record = drawn(0, 4)
    for stamps in (record.t, None):
        online_estimates(replace(record, t=stamps), record.plant.delay)
        offline_estimate(replace(record, t=stamps))


def judged(record: FieldRecord, kept_at: Path) -> FieldOutcome:
    """Identify the plant of a record offline, online and by the anchor, which is kept in a file."""
    warm_up()
    model, offline = offline_estimate(record)
    delay = delays(record)[0] if model is None else model.delay
    ident, finished, running = online_estimates(record, delay)
    begun = time.process_time()
    others = [] if model is None else [("fit", model.den)]
    others += [("online", ident.transfer_function.den)] if ident.has_model else []
    best = anchor(record, others, kept_at)
    seconds = time.process_time() - begun
    fit = explained(record, rp.TransferFunction(best.num, best.den, record.plant.delay))
    return FieldOutcome(
        record.number, record.what, record.half, features_of(record), fit, seconds, offline, finished, running
    )


def delays(record: FieldRecord) -> tuple[float, ...]:
    """Return the dead times in s that a user could give: one that lies between two samples is not known so well."""
    samples = record.plant.delay / record.dt
    whole = (math.floor(samples), math.ceil(samples)) if record.half else (round(samples),)
    return tuple(k * record.dt for k in whole)


def offline_estimate(record: FieldRecord) -> tuple[rp.TransferFunction | None, Estimate]:
    """Return what `fit` finds; of two dead times what simulates the record better."""
    begun = time.process_time()
    found, problem = None, ""
    for delay in delays(record):
        structure = rp.Structure(record.structure.poles, record.structure.zeros, delay)
        try:
            fitted = rp.fit(record.u, record.y, record.dt, structure, t=record.t)
        except ReplantError as error:
            problem = str(error)
            continue
        if found is None or fitted.simulation.fit > found.simulation.fit:
            found = fitted
    seconds = time.process_time() - begun
    if found is None:
        return None, Estimate(WORST, WORST, "no model", problem, seconds, 0.0)
    model = found.transfer_function
    return model, verdict_on(record, model, lambda: found.verdict, seconds)


def online_estimates(record: FieldRecord, delay: float) -> tuple[rp.Identifier, Estimate, Estimate]:
    """Return the online default after a pass, and what it gives finished and before."""
    begun = time.process_time()
    ident = rp.Identifier(rp.Structure(record.structure.poles, record.structure.zeros, delay), record.dt)
    ident.update_many(record.u, record.y, record.t)
    seconds = time.process_time() - begun
    model = ident.transfer_function if ident.has_model else None
    running = verdict_on(record, model, ident.assess, seconds)
    begun = time.process_time()
    ident.finish()
    seconds += time.process_time() - begun
    model = ident.transfer_function if ident.has_model else None
    return ident, verdict_on(record, model, ident.assess, seconds), running


def verdict_on(
    record: FieldRecord, model: rp.TransferFunction | None, verdict: Callable[[], rp.Assessment], seconds: float
) -> Estimate:
    """Return a model with its fit and verdict."""
    begun = time.process_time()
    said = verdict()
    judging = time.process_time() - begun
    fit, response = (WORST, WORST) if model is None else (explained(record, model), response_explained(record, model))
    return Estimate(fit, response, said.status, said.reasons[0], seconds, judging)


def explained(record: FieldRecord, model: rp.TransferFunction) -> float:
    """Return the simulated fit of the output without noise (K,), in percent, offset and initial state fitted to it.

    The model is run from all of the plant's input, that in lost rows and shortly before the record too.
    """
    t, poles = record.stamps, poles_apart(np.roots(model.den))
    since = slice(BEFORE - EARLIER, None)
    clock = Clock.of(record.all_t[since], record.all_u[since], model.delay, t)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        output = forced(poles, model.num.size - 1, clock) @ model.num
        columns = np.column_stack([np.ones(t.size), free(poles, t - t[0])])
        lengths = np.linalg.norm(columns, axis=0)
    if not (np.isfinite(output).all() and np.isfinite(lengths).all()):
        return WORST
    lengths[lengths == 0.0] = 1.0
    weights = lstsq(columns / lengths, record.clean - output, cond=1e-11)[0]
    left = record.clean - output - columns / lengths @ weights
    fit = 100.0 * (1.0 - float(np.linalg.norm(left) / np.linalg.norm(record.clean - record.clean.mean())))
    return max(fit, WORST) if math.isfinite(fit) else WORST


def response_explained(record: FieldRecord, model: rp.TransferFunction) -> float:
    """Return the fit of the response from rest to the input about its mean, in percent, a constant taken away."""
    t = record.all_t[BEFORE:]
    u = record.all_u[BEFORE:] - record.all_u[BEFORE:].mean()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        wanted, found = (
            forced(poles_apart(np.roots(one.den)), one.num.size - 1, Clock.of(t, u, one.delay, t)) @ one.num
            for one in (record.plant, model)
        )
    fit = 100.0 * (1.0 - float(np.std(wanted - found) / np.std(wanted)))
    return max(fit, WORST) if math.isfinite(fit) else WORST


def features_of(record: FieldRecord) -> tuple[str, ...]:
    """Return what a record has, in words that the table counts."""
    damping = "damping below 0.03" if record.damping < 0.03 else "damping 0.03 to 0.3"
    regular = record.missing and record.t is None
    clock = "regular" if record.t is None else "lost rows" if not record.jitter else "jitter and lost rows"
    return (
        f"input: {record.input}",
        f"noise: {record.noise}",
        f"noise: {'10 to 20' if record.decibels < 20.0 else '20 to 30'} dB",
        "damping: one pole or more, all real" if record.damping > 0.99 else f"{damping.replace(' ', ': ', 1)}",
        f"poles: {record.structure.poles}",
        f"zeros: {record.structure.zeros}",
        f"sensor: {'as it is' if not record.bits else '8 to 9 bits' if record.bits < 10 else '10 to 12 bits'}",
        f"outputs: {'all' if not record.missing else 'some missing, no stamps' if regular else 'some missing, stamps'}",
        f"clock: {'jitter' if record.jitter and not record.lost else clock}",
        f"rows: {'up to 500' if record.u.size <= 500 else '500 to 1,000' if record.u.size <= 1000 else 'over 1,000'}",
    )
