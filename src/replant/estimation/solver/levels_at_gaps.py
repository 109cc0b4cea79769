r"""Gaps of a record over which the output's level has changed: a load that has begun meanwhile.

Behind a gap the initial state is unknown, the offset is that of before.  Freed of the initial states, and whitened, the
residual e_i of each part has c_i of an offset of one in it.  Parts that share an offset leave

.. math:: \sum e_i^T e_i - (\sum c_i^T e_i)^2 / \sum c_i^T c_i .

Each part has an offset of its own at first; gap by gap, the offsets on both sides become one where that costs least,
until all gaps left are surely those of a load.
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
    """What samples that share an offset tell of it."""

    begin: int
    length: float  # c'c
    told: float  # c'e

    @property
    def explained(self) -> float:
        """The power that their offset explains."""
        return self.told**2 / self.length if self.length > 0.0 else 0.0

    def joined(self, later: _Part) -> _Part:
        """Return what they tell of the offset that they share with the samples behind them."""
        return _Part(self.begin, self.length + later.length, self.told + later.told)


@quiet
def loads_at_gaps(structure: Structure, record: Record, theta: FloatArray, noise: Autoregression) -> tuple[int, ...]:
    """Return the gaps over which the offset beside a model (T,) has surely changed, each the sample that follows it."""
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
    """Return the power that a model (T,) leaves of a record, whitened, with other offsets since some of its gaps."""
    (first, *others), power = _parts_of(structure, record, theta, noise)
    sharing = [first]
    for part in others:
        if part.begin in record.begins or part.begin in loads:
            sharing.append(part)
        else:
            sharing[-1] = sharing[-1].joined(part)
    return max(power - sum(part.explained for part in sharing), ROUNDING * sum_of_squares(record.y))


def price(count: int) -> float:
    """Return by how much likelier another offset must make so many samples: by its number, and the odds against it."""
    return 0.5 * math.log(count) - math.log(ALPHA)


def _more(before: _Part, since: _Part) -> float:
    """Return by how much more is left where two parts share an offset."""
    return max(before.explained + since.explained - before.joined(since).explained, 0.0)


def _parts_of(
    structure: Structure, record: Record, theta: FloatArray, noise: Autoregression
) -> tuple[list[_Part], float]:
    """Return what each part of a record tells of its offset, and the power that is left without one."""
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
