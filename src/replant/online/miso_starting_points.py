"""Where a solution of several inputs begins, and whether another begin may lead to a better one."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from replant.estimation.simulation.miso import Point, Row, evaluate
from replant.fitting.miso_solve import RowSolution, started
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.verdict.miso_tests import lacking, untold


class Begins(NamedTuple):
    """Where a solution begins: at models (P,) that were found with a noise model, or at none."""

    noise: Autoregression | None = None
    models: tuple[FloatArray, ...] = ()

    def there(self, row: Row) -> Callable[[Autoregression], list[Point]]:
        """Return what begins at the models."""
        points = []
        if self.noise is not None:
            points = [evaluate(row.from_outside, each, self.noise) for each in self.models]
        return lambda _: points

    def afresh(
        self, row: Row, *, also_white: bool = False, newest: int | None = None
    ) -> Callable[[Autoregression], list[Point]]:
        """Return what begins at a start, too: without a noise model only where none is known, or that is asked for."""
        others, outside = self.there(row), row.from_outside
        is_coloured = self.noise is not None and self.noise.order > 0 and not also_white
        # where but the colour of the noise is in doubt, a start of the newest samples tells of other models
        begin = started(row if newest is None else row.last(min(newest, row.record.u.size)))

        def begins(noise: Autoregression) -> list[Point]:
            points = begin(noise) if noise.order or not is_coloured else []
            if newest is not None:
                points = [evaluate(outside, each.theta, noise) for each in points]
            return [*points, *others(noise)]

        return begins


def is_settled(solution: RowSolution | None) -> bool:
    """Return whether nothing is found against a solution that another begin may mend."""
    if solution is None:
        return False
    row, found, _ = solution
    findings = [*found.findings, *untold(row, row.record, found.point, found.covariance)]
    return not (findings or any(lacking(row, found.point, found.noise)))


def is_white(solution: RowSolution | None) -> bool:
    """Return whether the noise has no colour: an autoregression may have taken a slow branch, until samples tell."""
    return solution is not None and solution.found.noise.order == 0
