r"""Gaps of a record across which the output's level has changed, by a load that has begun in the gap.

After a gap the initial state is unknown, the offset is that of before.  Whitened, and with the initial states projected
out, part i has the residual e_i, and the response c_i to a unit offset.  Parts with a common offset leave the power

.. math:: \sum e_i^T e_i - (\sum c_i^T e_i)^2 / \sum c_i^T c_i .

At first each part has its own offset; gap by gap, the offsets on both sides are merged where that costs least, until
all remaining gaps surely have a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, stability_margin
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, ROUNDING
from replant.numerics.linear_algebra import inner, quiet, sum_of_squares
from replant.numerics.projections import LEFT, without


class _Part(NamedTuple):
    """The information of samples on their common offset."""

    begin: int
    length: float  # c'c
    told: float  # c'e

    @property
    def explained(self) -> float:
        """The power that their offset explains."""
        return self.told**2 / self.length if self.length > 0.0 else 0.0

    def joined(self, later: _Part) -> _Part:
        """Return the information of these and later samples on a common offset."""
        return _Part(self.begin, self.length + later.length, self.told + later.told)


@quiet
def loads_at_gaps(structure: Structure, record: Record, theta: FloatArray, noise: Autoregression) -> tuple[int, ...]:
    """Return the gaps across which the offset has surely changed, given a model (T,), each as the sample after it."""
    parts, power = _parts_of(structure, record, theta, noise)
    least, rounding = price(record.count), ROUNDING * sum_of_squares(record.y)
    while gaps := [place for place, part in enumerate(parts) if place and part.begin not in record.begins]:
        usual = max(power - sum(part.explained for part in parts), rounding)
        if not 0.0 < usual < math.inf:
            return ()
        more, place = min((_more(*parts[each - 1 : each + 1]), each) for each in gaps)
        if 0.5 * record.count * math.log1p(more / usual) > least:
            break
        parts[place - 1 : place + 1] = [parts[place - 1].joined(parts[place])]
    return tuple(parts[place].begin for place in gaps)


@quiet
def cost_beside(
    structure: Structure, record: Record, theta: FloatArray, noise: Autoregression, loads: Sequence[int] = ()
) -> float:
    """Return the power of the whitened residual of a model (T,), with new offsets after some gaps of the record."""
    (first, *others), power = _parts_of(structure, record, theta, noise)
    sharing = [first]
    for part in others:
        if part.begin in record.begins or part.begin in loads:
            sharing.append(part)
        else:
            sharing[-1] = sharing[-1].joined(part)
    return max(power - sum(part.explained for part in sharing), ROUNDING * sum_of_squares(record.y))


def price(count: int) -> float:
    """Return the least log-likelihood gain of another offset with ``count`` samples: price, and odds against it."""
    return 0.5 * math.log(count) - math.log(ALPHA)


def _more(before: _Part, since: _Part) -> float:
    """Return the increase of the residual power if two parts share an offset."""
    return max(before.explained + since.explained - before.joined(since).explained, 0.0)


def _parts_of(
    structure: Structure, record: Record, theta: FloatArray, noise: Autoregression
) -> tuple[list[_Part], float]:
    """Return the information of each part of a record on its offset, and the residual power without an offset."""
    model = AuxiliaryModel(structure, record.dt, record.input_hold, margin=stability_margin(record))
    nuisances, entries = structure.poles + 1, np.zeros(model.entries)
    entries[: structure.coefficients] = theta[: structure.coefficients]
    parts, power = [], 0.0
    for rows in record.parts:
        part = record.part(rows)
        done = model.run(entries, part)
        white = part.whitened(noise, np.column_stack([done.phi[:, -nuisances:], done.error]))
        offset, error = without(white[:, [0, -1]], white[:, 1:-1]).T
        length, told = sum_of_squares(offset), inner(offset, error)
        if length <= LEFT**2 * sum_of_squares(white[:, 0]):  # the initial state explains all of it
            length = told = 0.0
        parts.append(_Part(rows.start, length, told))
        power += sum_of_squares(error)
    return parts, power
