"""Restart: a state that begins at an estimate of the samples kept, and goes on at the newest of them."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dimensions import STORED
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import REGULAR, State
from replant.kernels.schema import Doubt
from replant.model.structure import Structure
from replant.offline.refined import Refined
from replant.offline.solve import Solution
from replant.online.begin_recursion import initialize
from replant.online.startup import carry_over, note_doubts, warm_up
from replant.settings import Settings
from replant.simulation.auxiliary_model import SLOWEST
from replant.simulation.model_run import run_model
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import roots

EXPLAINED = 0.3
"""Part of the output's power that the input must explain, where a model is to replace another one after a change [part
of the output's power].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SURE = 15.0
"""Gain in the logarithm of the likelihood below which a change may be chance [nats].
Derivation: more than as many coefficients as a usual model has would gain by chance.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""


def restart(old: State, settings: Settings, refined: Refined, record: Record, origin: int) -> State:
    """Return a state that begins at a refined estimate and goes on at the newest sample of ``old``.

    Parameters
    ----------
    old : State
    settings : Settings
    refined : Refined
        The estimate of ``record``.
    record : Record
        The newest samples; the filters are run over it.
    origin : int
        Accepted samples before the record that the estimate is made from.
    """
    new = State.of_settings(settings, STORED)
    initialize(new, settings, refined, record)
    stamps = REGULAR
    if record.intervals.size > 1:
        stamps = old.last_time - (record.intervals.sum() - np.cumsum(record.intervals))
    with new.without_preprocessing():
        warm_up(new, record.u, record.y, stamps, record.r, learn=False)
    new.ready_at = new.elapsed
    carry_over(old, new)
    new.record_began, new.solved_at = origin, old.samples
    return new


def restart_at(old: State, settings: Settings, solution: Solution, origin: int) -> State:
    """Return `restart` at the solution of a record as it was measured; what it left out is in doubt from now on."""
    new = restart(old, settings, solution.found, solution.record, origin)
    note_doubts(new, solution)
    return new


def left_by_input(
    structure: Structure, parameters: FloatArray, record: Record, dt: float, seen: int = 0, *, certain: bool = True
) -> tuple[float, bool]:
    """Return the variance of a model's residual, and whether the input explains a part of the output.

    What counts is what the model's numerator adds, to the residual and to the residual whitened: of an output that
    wanders an integrated input explains much by chance, and nothing once both are whitened.  The variance is infinite
    where a signal leaves float64.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array or longer
    record : Record
    dt : float
        Sampling time in s.
    seen : int
        Samples at the beginning that do not count.
    certain : bool
        False for a model that was known before: then the part alone counts, not whether it may be chance.
    """
    still = parameters[: structure.size].copy()
    still[structure.numerator] = 0.0
    run, alone = (run_model(structure, each, record, dt) for each in (parameters[: structure.size], still))
    if run is None or alone is None:
        return math.inf, False
    errors = [each.error[seen:] - each.error[seen:].mean() for each in (run, alone)]
    left, power = (float(np.mean(error**2)) for error in errors)
    if not left < (1.0 - EXPLAINED) * power:
        return left, False
    if not certain:
        return left, True
    white = [Autoregression.of(error) for error in errors]
    least = np.finfo(float).tiny
    gain = math.log(max(white[1].power, least) / max(white[0].power, least))
    return left, errors[0].size * gain > SURE


def is_driven(settings: Settings, refined: Refined, record: Record) -> bool:
    """Return whether a model is stable, or the input explains what it would not predict without it."""
    structure = settings.structure
    poles = roots(np.concatenate([[1.0], refined.theta[structure.denominator]]))
    if poles.real.max() < -SLOWEST / record.span:
        return True
    return left_by_input(structure, refined.theta, record, settings.dt)[1]


def clear_doubt(state: State, kept: RecentSamples) -> None:
    """Bridge the newest samples by the outputs that the model was solved with; no doubt is left of a measured one."""
    doubted = np.flatnonzero(kept.is_bridged & (kept.output != kept.bridged))
    rows, recent = (state.samples - len(kept) + doubted) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows] = kept.output[doubted]
    recent.doubt[rows[recent.output[rows] == recent.bridged[rows]]] = Doubt.NONE
