"""The result of a search: candidates, and the one chosen; and the search for a dead time between grid points."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from replant.fitting.fit_result import FitResult
from replant.fitting.several_outputs import MatrixFit
from replant.fitting.structure_evidence import ALPHA, Trial
from replant.model.structure import Structure

# the loss a seventh of a standard deviation from the likeliest dead time
WORTH = 0.01  # predicted gain below which no dead time between two points of the grid is tried [log-likelihood]
# as many halvings would find it to a 256th of a sample; maxima of parabolas come as near in fewer steps
BETWEEN = 8  # most dead times tried between two points of the grid [count]
SHOWN = 6  # most candidates within chance of the best that are shown [count]


@dataclass(frozen=True, eq=False, repr=False)
class Candidate:
    """One structure of the grid.

    Attributes
    ----------
    structure : Structure or tuple of Structure
        With several inputs one for each.
    fit : float
        Fit in percent of the simulated output over all samples, with offset and initial state estimated; for an
        unstable model, which would run away, of the output predicted one step ahead.  Minus infinity if there is no
        model, or the structure was left early, as it could not win against a smaller one or a neighbouring dead time.
    likelihood : float
        Logarithm of the likelihood of all samples.
    criterion : float
        Bayesian information criterion: N ln(K) minus twice the log-likelihood, with N numbers fitted to K samples.
        Smaller is better.
    uncertainty : float
        Largest standard deviation of a coefficient, as a part of its size.
    """

    structure: Structure | tuple[Structure, ...]
    fit: float = -math.inf
    likelihood: float = -math.inf
    criterion: float = math.inf
    uncertainty: float = math.inf

    def __repr__(self) -> str:
        size = f"{self.of_inputs('poles')} poles, {self.of_inputs('zeros')} zeros, {self.of_inputs('delay')} s"
        return f"{size}: fit {self.fit:.1f} %" if self.was_tried else f"{size}: left early"

    @property
    def structures(self) -> tuple[Structure, ...]:
        """The structure of each input."""
        return self.structure if isinstance(self.structure, tuple) else (self.structure,)

    def of_inputs(self, name: str) -> str:
        """Return "poles", "zeros" or "delay" of each input in words."""
        return ", ".join(f"{getattr(each, name):g}" for each in self.structures)

    @property
    def was_tried(self) -> bool:
        """Whether there is a model of this structure."""
        return math.isfinite(self.fit)


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """The result of a search.

    Attributes
    ----------
    best : FitResult or RowFit
        The fit of the chosen structure to the whole record, its dead time found between the points of the grid.
    chosen : Candidate
    candidates : tuple of Candidate
        All of the grid, ascending, and the one chosen, if it is not on the grid; with several inputs those that were
        tried.
    between : bool
        Whether the dead time of the one chosen lies between the points of the grid.
    """

    best: Any  # FitResult; RowFit with several inputs or outputs
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    between: bool = False

    @property
    def delays(self) -> tuple[float, ...]:
        """Dead time from each input in s, found between the points of the grid."""
        return tuple(each.delay for each in self.chosen.structures)

    @property
    def likely(self) -> tuple[Candidate, ...]:
        """The relevant ones by evidence: within chance of the best, the best of each order, and the one chosen."""
        tried = sorted((each for each in self.candidates if each.was_tried), key=lambda each: each.criterion)
        best = {each.of_inputs("poles"): each for each in reversed(tried)}
        chance = [each for each in tried[:SHOWN] if each.criterion <= tried[0].criterion - 2.0 * math.log(ALPHA)]
        worth = {id(each) for each in (*chance, *best.values(), self.chosen)}
        return tuple(each for each in tried if id(each) in worth)

    @property
    def rest(self) -> str:
        """A line about the other candidates; empty without any."""
        more = len(self.candidates) - len(self.likely)
        early = sum(not each.was_tried for each in self.candidates)
        if not more:
            return ""
        return f"{more} more explain{'s' if more == 1 else ''} less" + (
            f", {early} of them left early" if early else ""
        )

    def __repr__(self) -> str:
        rows = [f"{each!r}, {0.5 * (self.chosen.criterion - each.criterion):+.1f} evidence" for each in self.likely]
        of = f"<SearchResult of {len(self.candidates)} structures: {self.best.model!r}"
        return "\n  ".join([of, *rows, *([self.rest] if self.rest else [])]) + ">"

    def _repr_html_(self) -> str:
        picture = self.best._repr_html_() if isinstance(self.best, FitResult) else ""
        return f"<pre>{html.escape(repr(self))}</pre>{picture}"


@dataclass(frozen=True, eq=False, repr=False)
class MatrixSearch:
    """The result of a search with several outputs, each searched for by itself.

    Parameters
    ----------
    rows : tuple of SearchResult
        One for each output; the best of each is a RowFit.
    """

    rows: tuple[SearchResult, ...]

    @property
    def best(self) -> MatrixFit:
        """The fit of the structures that were chosen for each output."""
        return MatrixFit(tuple(row.best for row in self.rows))

    def __repr__(self) -> str:
        return "\n".join(f"{row.best.model.output_name}: {row!r}" for row in self.rows)


def likeliest_between(
    trials: dict[float, Trial], low: float, high: float, dt: float, tried: Callable[[float, Trial], Trial | None]
) -> Trial:
    """Return the likeliest trial of dead times between two points of a grid; ``tried`` starts one from the nearest."""

    def is_tried(delay: float) -> bool:
        trial = tried(delay, trials[min(trials, key=lambda at: abs(at - delay))])
        if trial is not None:
            trials[delay] = trial
        return trial is not None

    best = max(trials, key=lambda at: trials[at].likelihood)
    # a zero can replace a part of a dead time, so that there may be several maxima
    sides = [0.5 * (best + end) for end in (low, high) if abs(end - best) > dt]
    for delay in sides:
        is_tried(delay)
    for _ in range(BETWEEN - len(sides)):
        delay, gain = top_of_parabola({at: trial.likelihood for at, trial in trials.items()}, low, high)
        if gain < WORTH or delay in trials or not is_tried(delay):
            break
    return max(trials.values(), key=lambda trial: trial.likelihood)


def top_of_parabola(values: Mapping[float, float], low: float, high: float) -> tuple[float, float]:
    """Return the maximum of the parabola through the best of some values and its neighbours, and its gain."""
    best = max(values, key=lambda place: values[place])
    near = sorted((place for place in values if place != best), key=lambda place: abs(place - best))
    if len(near) < 2:
        return (0.5 * (best + (near[0] if near else low + high - best)), math.inf)
    across = [place for place in near if (place < best) != (near[0] < best)]  # on the other side
    others = near[0], across[0] if across else near[1]
    slopes = [(values[place] - values[best]) / (place - best) for place in others]
    bend = (slopes[1] - slopes[0]) / (others[1] - others[0])
    if not -math.inf < bend < 0.0:
        return best, 0.0
    tilt = slopes[0] - bend * (others[0] - best)
    top = min(max(-0.5 * tilt / bend, low - best), high - best)
    return best + top, top * (tilt + bend * top)
