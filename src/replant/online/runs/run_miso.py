"""One online pass over a log of several inputs, solved as a whole at the end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.fitting.miso_fit import RowFit
from replant.logs.log import Log
from replant.online.miso_identifier import RowIdentifier

CHUNK = 8192  # samples taken between two marks of progress [samples]


def first_model(samples: int) -> int:
    """Return from how many samples the first model is made where nobody says: a tenth, at most `RECENT`."""
    return min(max(samples // 10, 1), RECENT)


def run_row(
    log: Log,
    orders: dict[str, Any],
    startup: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> RowFit:
    """Return the row that a `RowIdentifier` makes of a log; ``orders`` are poles, zeros and dead time of each input."""
    count, first = len(log), first_model(len(log)) if startup is None else startup
    ident = RowIdentifier(
        dt=log.dt, startup=first, input_hold=log.input_hold, input_names=log.input_names, **orders
    )  # fmt: skip
    u, y, t, r = log.inputs, log.output, log.stamps, log.reference
    for begin in range(0, count, CHUNK):
        rows = slice(begin, begin + CHUNK)
        stamps, references = (None if each is None else each[rows] for each in (t, r))
        ident.update_many(u[rows], y[rows], stamps, references)
        progress(min(begin + CHUNK, count))
    if startup is None or not ident.has_model:
        ident.finish()
    model = ident.model.of_log(log.input_names, log.output_name, log.path.name)
    none, missing = np.zeros(0, np.int64), np.flatnonzero(~np.isfinite(y))
    return RowFit(model, model.validate(log).output, none, none, missing)
