r"""Review: the estimate of a long record beside its newest samples, and a new beginning where these contradict it.

An estimate that forgets nothing follows a change the more slowly, the longer the record is.  A change that makes the
residual grow is noticed by its CUSUM test (`online.change_response`).  A gain that is off by a tenth, or by a quarter
where the noise is strong, makes it grow little: that shows in the estimate.  Where this moves by more than chance
(`online.estimate_movement`), and the change would show in the output if it went on, a model of the samples kept is
solved for.  It takes the place of the estimate if it predicts samples that it has not seen better, beyond chance.
"""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.evidence import LEAST_POWER, RESTED
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm
from replant.offline.srivc import refine
from replant.online.estimate_movement import asked_for
from replant.online.restart import clear_doubt, is_driven, restart
from replant.online.solve_again import MOST_DOUBTED, next_solution, remembers_all
from replant.settings import Settings
from replant.simulation.model_run import run_model
from replant.statistics.autoregression import likelihood_ratio
from replant.statistics.linear_algebra import quiet

EVERY = RECENT // 2
"""Samples between two reviews, and the fewest that one uses [samples].
Derivation: half of the newest samples: as far back as the past estimates reach.
"""

MATTERS = 0.05
"""Change of the simulated output below which a change of the plant does not matter [part of the output's amplitude].
Derivation: half of the error of abs G with which a model is trusted.
Sensitivity: halved or doubled, nothing changes on these records.
"""

RATIO = 1e-3
"""Chance that a model which is no better predicts samples that it has not seen so much better [probability].
Level: 0.1 %: a likelihood ratio of mean one exceeds 1 / RATIO with no greater probability (Markov's inequality).
"""


def next_renewal(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which the record is solved again, or later reviewed; 0: never."""
    return next_solution(state, settings) or (state.samples + EVERY if settings.optimizer.keeps_covariance else 0)


def is_at_rest(state: State) -> bool:
    """Return whether the input has rested since half of the time between two reviews."""
    newest = RecentSamples.of(state, RESTED).input
    return len(newest) == RESTED and float(np.var(newest)) < LEAST_POWER * state.largest_power


@quiet
def review(old: State, settings: Settings) -> State | None:
    """Return the state that begins at a model of the newest samples, where these contradict the estimate; else None."""
    begin = max(old.record_began, old.gap_at)
    if old.alarm or not (old.adapt and remembers_all(old, settings)) or old.samples - begin < EVERY:
        return None
    if is_at_rest(old):  # nothing that comes now could test another model
        return None
    asked = asked_for(old, settings)
    if asked is None:
        return None
    kept = RecentSamples.since(old, begin)
    record = kept.record(settings.dt, settings.filter.input_hold)
    if kept.doubted > MOST_DOUBTED or not _matters(settings, old.physical, asked, record.last(EVERY // 2)):
        return None
    seen = 2 * record.u.size // 3
    known = refine(settings.structure, record.first(seen), [old.physical], afresh=True)
    if known is None or not _predicts_better(settings, known.theta, old.physical, record, seen):
        return None
    refined = refine(settings.structure, record, [known.theta, old.physical])
    if refined is None or not (refined.settled and is_driven(settings, refined, record)):
        return None
    new = restart(old, settings, refined, record, old.samples - len(kept))
    clear_doubt(new, kept)
    new.past_kept, new.past_due = 0, new.samples
    new.alarm, new.change_began = Alarm.NONE, new.samples
    return new


def _matters(settings: Settings, model: FloatArray, change: FloatArray, record: Record) -> bool:
    """Return whether a change of the coefficients changes the simulated output by more than `MATTERS`."""
    run = run_model(settings.structure, model[: settings.structure.size], record, settings.dt)
    return run is not None and float(np.std(run.zeta @ change)) > MATTERS * float(run.forced.std())


def _predicts_better(settings: Settings, model: FloatArray, other: FloatArray, record: Record, seen: int) -> bool:
    """Return whether a model differs from another, and predicts the samples after the first ``seen`` better than it.

    Better means beyond chance, of samples that the first has not been fitted to.
    """
    size = settings.structure.size
    runs = [run_model(settings.structure, parameters[:size], record, settings.dt) for parameters in (model, other)]
    if runs[0] is None:
        return False
    if runs[1] is None:
        return True
    if not float(np.std(runs[0].forced - runs[1].forced)) > MATTERS * float(runs[1].forced.std()):
        return False
    return likelihood_ratio(runs[0].error[seen:], runs[1].error[seen:]) > -math.log(RATIO)
