"""One online pass over a record of several inputs, solved as a whole at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.dimensions import RECENT
from replant.estimation.simulation.miso import RowRecord
from replant.fitting.miso_fit import RowFit, check_numbers, columns_of, structures_of
from replant.fitting.miso_model import evaluated
from replant.fitting.miso_solve import references_of
from replant.fitting.samples import Samples
from replant.logs.log import without_rest
from replant.numerics.arguments import vector
from replant.numerics.limits import increasing
from replant.online.miso_identifier import RowIdentifier
from replant.online.miso_samples import RowClock, Screened

CHUNK = 8192  # samples taken between two marks of progress [samples]


def first_model(samples: int) -> int:
    """Return from how many samples the first model is made where nobody says: a tenth, at most `RECENT`."""
    return min(max(samples // 10, 1), RECENT)


def run_row(
    given: Samples,
    orders: dict[str, Any],
    startup: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> RowFit:
    """Return the row that a `RowIdentifier` makes of a record; ``orders`` are poles, zeros and delay of each input."""
    if given.begins:
        raise InvalidArgumentError("a pass over several inputs takes one log: give one, or use fit for several")
    u, y = columns_of(given.inputs), vector("y", given.y)
    structures_of(u.shape[1], **orders)
    for name, signal in (("u", u), ("t", given.t), ("reference", given.references)):
        if signal is not None and len(signal) != y.size:
            raise InvalidArgumentError(f"{name} has {len(signal)} rows and y {y.size} samples: give one row for each")
    check_numbers(given, u, y, references_of(given.references, y.size))
    t = None if given.t is None else increasing(given.t, y.size)
    first = first_model(y.size) if startup is None else startup
    ident = RowIdentifier(
        dt=given.dt, startup=first, input_hold=given.input_hold, input_names=given.input_names, **orders
    )  # fmt: skip
    screened = Screened.of(RowClock(), u, y, t, np.empty((y.size, 0)), -np.inf, given.dt)
    if t is None and not screened.is_taken.all():
        t = given.dt * np.arange(y.size, dtype=np.float64)  # a sample that is left out takes its time nevertheless
    for begin in range(0, y.size, CHUNK):
        rows = slice(begin, begin + CHUNK)
        stamps, references = (None if each is None else each[rows] for each in (t, given.references))
        ident.update_many(u[rows], y[rows], stamps, references)
        progress(min(begin + CHUNK, y.size))
    if startup is None or not ident.has_model:
        ident.finish()
    names, taken = ident.request.input_names, np.flatnonzero(screened.is_taken)
    of_newest = taken[taken.size - len(ident.recent[1]) :]
    others = {name: each[of_newest] for name, each in given.unused.items()}
    found = ident.fit_of_newest(others)
    newest = ident.model if found is None else found.model
    model = newest.of_log(names, given.output_name, given.source, given.sha256)
    rejected = without_rest(dict(model.rejected), "no output", given.rest)
    made = replace(model.provenance, samples=model.provenance.samples - given.rest)
    model = replace(model, rejected=tuple(rejected.items()), provenance=made)
    none, missing = np.zeros(0, np.int64), np.flatnonzero(~np.isfinite(y))
    began, *loads = (int(taken[each]) for each in ident.begins)
    ready = RowRecord.of(u, y, given.dt, t, given.input_hold, (began, *loads))
    output = ready.simulated(*evaluated(model, ready))
    output[:began] = np.nan  # what the estimate is not of
    return RowFit(model, output, none, none, missing)
