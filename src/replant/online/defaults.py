"""Defaults: cutoff, scaling, step size and buffer chosen from the data where the user chose none (docs/defaults.md)."""

from __future__ import annotations

from replant.arguments import FloatArray
from replant.engine.record_regressors import regressors
from replant.offline.least_squares import choose_filter
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.optimizer import Replay
from replant.regressor.filters import RefinedFilter
from replant.regressor.preprocess import centre
from replant.regressor.scaling import Scaling
from replant.settings import (
    AUTO,
    DEFAULT_OPTIMIZER,
    Request,
    Settings,
)
from replant.statistics.linear_algebra import quiet

UNKNOWN_LENGTH = 2_000  # samples to come that an optimizer is tuned for where nobody knows better [samples]


@quiet
def settle(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    length: int | None = None,
    *,
    reference: bool = False,
    t: FloatArray | None = None,
) -> Settings:
    """Return definite settings: what is "auto" is chosen from a record."""
    structure, dt, instruments = request.structure, request.dt, request.wants_instruments
    preprocess = request.preprocess.resolve(u, y)
    replay = _choose_replay(request)
    optimizer = request.optimizer
    if not isinstance(optimizer, Optimizer):
        updates = (length or UNKNOWN_LENGTH) * (replay.batch_size if replay else 1)
        optimizer = OPTIMIZERS[DEFAULT_OPTIMIZER if optimizer == AUTO else optimizer].suggested(dt, updates)
    chosen = request.filter
    if isinstance(chosen, str):
        follows = instruments and optimizer.keeps_covariance
        chosen = RefinedFilter() if follows else choose_filter(structure, dt, preprocess, u, y, t)
    if chosen.follows_estimate and not structure.bias:
        preprocess = centre(preprocess, u, y)
    scaling = request.scaling
    if scaling is None or (scaling == AUTO and optimizer.keeps_colour):  # its estimate does not depend on the scaling
        scaling = Scaling.none(structure)
    elif not isinstance(scaling, Scaling):
        assumed = chosen.fixed or choose_filter(structure, dt, preprocess, u, y, t)
        phi, _ = regressors(structure, dt, assumed, preprocess, u, y, t)
        scaling = Scaling.from_record(y - float(preprocess.output_offset), phi)
    return Settings(
        structure, dt, chosen, scaling, optimizer, replay, instruments, request.normalize, preprocess, u.size, reference
    )


def _choose_replay(request: Request) -> Replay | None:
    """Return the replay buffer; None for an optimizer that keeps a covariance, which remembers every sample."""
    if request.replay is None or isinstance(request.replay, Replay):
        return request.replay
    optimizer = request.optimizer
    if isinstance(optimizer, str):
        return None if OPTIMIZERS[DEFAULT_OPTIMIZER if optimizer == AUTO else optimizer].keeps_covariance else Replay()
    return None if optimizer.keeps_covariance else Replay()
