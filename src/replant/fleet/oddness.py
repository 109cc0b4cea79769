"""Oddness: how far each rig lies from its fleet, with the uncertainty of each; which are odd, and why, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.fleet.quantities import Figures, Quantity, figures_of, quantities_of, unit_factor
from replant.fleet.robust import Location, located
from replant.fleet.store import FAILED, column
from replant.model.structure import Structure

CHANCE = 0.01
"""Probability that a fleet without an odd rig has one named [probability].
Level: a hundredth for the whole fleet, divided among its rigs.
"""
EFFICIENCY = 1.5
"""By how many times fewer rigs tell the scale than there are, as it is made from quantiles [number].
Origin: of fleets without an odd rig one is then named in 7 of 600 with 20 rigs, 3 of 400 with 50, 1 of 200 with 300;
with 1 in 13 of 300, 3 of 100 and 2 of 100.
Sensitivity: halved or doubled, nothing changes on these records.
"""
FEWEST = 8  # trusted rigs beyond their coefficients from which on there is something usual [count]
FEW_SIGMA = 4.0
"""Distance in one quantity from which on it is named as well [standard deviations].
Level: a normal variable is so far in one of 16,000 cases.
"""
STANDING = 0.2
"""Part of a record over which an output that stands still is a finding, if the fleet's do not [part of the record].
Derivation: a tenth or two of a record at rest are usual; a sensor that is stuck for less is the verdict's to notice.
"""
POOR = 0.5
"""Share of the fleet's usual fit below which one that is not trusted is a finding [part].
Derivation: a rig of the fleet has a fit near the usual one; a wrong signal one near 0.
"""
UNEXPLAINED = 4.0
"""What the model leaves of the output of a rig that is not trusted, beside the most that the fleet usually leaves,
from which on it is a finding [ratio of 100 % - fit].
Derivation: the most usual is the 90 % quantile of the trusted rigs, whose noise differs by less; by benchmarks/fleet a
wrong column leaves 10 times as much and more.
"""


@dataclass(frozen=True, eq=False)
class Oddness:
    """What is said of each rig of a fleet.

    Attributes
    ----------
    order : (N,) array of int
        Rows of the table by rank: the odd ones first, then those that failed, those not trusted, and the others by
        their distance.
    odd : (N,) array of bool
    words : tuple of str
        Why a rig is odd; empty where it is not.
    distance : (N,) array
        From the fleet, in standard deviations, those of its estimate among them; NaN where it is not known.
    usual : tuple of (Quantity, float, float)
        Physical quantities, their median in the fleet, and the ratio by which rigs usually differ from it.
    """

    order: np.ndarray[tuple[int], np.dtype[np.int64]]
    odd: BoolArray
    words: tuple[str, ...]
    distance: FloatArray
    usual: tuple[tuple[Quantity, float, float], ...]


def oddness_of(table: Any, structure: Structure) -> Oddness:
    """Return what is odd in a fleet's table of results.

    A trusted rig is odd if its distance has a probability below `CHANCE` divided by the number of rigs.  Rigs that are
    not trusted do not move what is usual; they are odd where their signals show why.
    """
    verdicts = np.asarray(table.column("verdict").to_pylist(), object)
    trusted, figures = verdicts == "trusted", figures_of(table, structure)
    words = [""] * len(verdicts)
    distance = np.full(len(verdicts), math.nan)
    usual: tuple[tuple[Quantity, float, float], ...] = ()
    base = trusted & figures.known & ~figures.reversed.any(axis=1)
    if base.sum() >= FEWEST + len(figures.names):
        place = located(figures.x[base], figures.covariances[base])
        squared = _squared_distances(figures, place)
        distance[figures.known] = np.sqrt(squared[figures.known])
        usual = _usual(figures, place, quantities_of(structure))
        limit = limit_of(len(figures.names), int(base.sum()), len(verdicts))
        for row in np.flatnonzero(trusted & figures.known & (squared > limit)).tolist():
            words[row] = _of_figures(figures, place, row, usual)
    for row, said in _of_signals(table, verdicts).items():
        words[row] = said
    odd = np.array([bool(each) for each in words], bool)
    rank = np.select([odd, verdicts == FAILED, ~trusted], [0, 1, 2], 3)
    by_signal = odd & ~trusted
    far = np.where(np.isfinite(distance), distance, 0.0)
    order = np.lexsort((np.arange(len(words)), -far, ~by_signal & odd, rank))
    return Oddness(order, odd, tuple(words), distance, usual)


def limit_of(size: int, base: int, rigs: int) -> float:
    """Return the squared distance that is reached by chance in one of 1/`CHANCE` fleets."""
    from scipy.stats import f

    return float(size * f.isf(CHANCE / rigs, size, max((base - size) / EFFICIENCY, 1.0)))


def _squared_distances(figures: Figures, place: Location) -> FloatArray:
    """Return squared distances (N,); a coefficient of the other sign counts by how sure that sign is."""
    squared = place.squared_distances(figures.x, figures.covariances)
    spread = np.diag(place.spread)
    turned = 4.0 / (spread + 1.0 / np.square(figures.certainty)) / place.scale
    return np.asarray(squared + np.where(figures.reversed, turned, 0.0).sum(axis=1))


def _usual(figures: Figures, place: Location, quantities: list[Quantity]) -> tuple[tuple[Quantity, float, float], ...]:
    found = []
    for quantity in quantities:
        w = figures.weights(quantity)
        if w is None:
            continue
        sign = math.prod(figures.signs[figures.names.index(name)] for name, _ in quantity.weights)
        middle = sign * quantity.factor * math.exp(float(w @ place.centre))
        found.append((quantity, middle, math.exp(math.sqrt(max(float(w @ place.spread @ w), 0.0)))))
    return tuple(found)


def _of_figures(figures: Figures, place: Location, row: int, usual: tuple[tuple[Quantity, float, float], ...]) -> str:
    """Return in words how a rig differs from the fleet, the quantity that differs most first."""
    off = figures.x[row] - place.centre
    total = (place.spread + figures.covariances[row]) * place.scale
    said: list[tuple[float, str]] = []
    gain_turned = False
    for quantity, _, _ in usual:
        w = figures.weights(quantity)
        assert w is not None
        log_ratio, std = float(w @ off), math.sqrt(float(w @ total @ w))
        turned = bool(figures.reversed[row][w != 0.0].sum() % 2)
        sure = min(float(figures.certainty[row][w != 0.0].min()), 1.0 / std) if turned else 0.0
        said.append(
            (max(abs(log_ratio) / std, sure), compared(quantity, log_ratio, std, is_reversed=turned, sure=sure))
        )
        gain_turned |= turned and quantity.name == "gain"
    said.sort(key=lambda each: -each[0])
    factor = unit_factor(usual, figures, place, row)
    head = [f"reversed sign: {text}" for _, text in said if gain_turned and "opposite sign" in text][:1]
    if not head and factor:
        head = [f"wrong unit? {factor}"]
    rest = [text for size, text in said if size >= FEW_SIGMA and not (head and text in head[0])]
    if not head:
        rest = rest or [text for _, text in said[:1]] or ["the coefficients together lie far from the fleet's"]
    return "; ".join([*head, *(rest[:2] if not factor or gain_turned else [])])


def _of_signals(table: Any, verdicts: Any) -> dict[int, str]:
    """Return in words, by row, what the signals of rigs that are not trusted show."""
    trusted = verdicts == "trusted"
    held, moved, entered, fit = (
        column(table, name) for name in ("output_held", "output_std", "input_std", "fit")
    )  # fmt: skip
    usual_held = float(np.nanquantile(held[trusted], 0.9)) if trusted.any() else 0.0
    usual_fit = float(np.nanmedian(fit[trusted])) if trusted.any() else math.nan
    least_fit = _least_fit(fit[trusted])
    reasons = table.column("reasons").to_pylist()
    found = {}
    for row in np.flatnonzero(~trusted & (verdicts != FAILED)):
        if entered[row] == 0.0:
            found[int(row)] = "the input does not move"
        elif moved[row] == 0.0 or (held[row] >= STANDING and held[row] > 4.0 * usual_held):
            found[int(row)] = f"stuck sensor? the output stands still over {100.0 * held[row]:.0f} % of the record"
        elif math.isfinite(usual_fit) and not fit[row] >= max(POOR * usual_fit, least_fit):
            shown = f"{fit[row]:.0f} %" if math.isfinite(fit[row]) else "nothing"
            said = reasons[row].partition("; ")[0].partition(": ")[0]
            guess = "" if fit[row] >= POOR * usual_fit else "wrong column? "
            found[int(row)] = f"{guess}the model explains {shown}, the fleet's {usual_fit:.0f} %: {said}"
    return found


def _least_fit(trusted: FloatArray) -> float:
    """Return the fit in percent below which the model leaves `UNEXPLAINED` times as much as it usually does at most.

    Examples
    --------
    >>> _least_fit(np.full(20, 95.0)), _least_fit(np.array([]))
    (80.0, -inf)
    """
    known = trusted[np.isfinite(trusted)]
    if known.size < FEWEST:
        return -math.inf
    return 100.0 - UNEXPLAINED * float(np.quantile(100.0 - known, 0.9))


MEDIAN, BEFORE = "the fleet's median", "what it was"


def compared(
    quantity: Quantity,
    log_ratio: float,
    std: float,
    *,
    is_reversed: bool = False,
    sure: float = 0.0,
    beside: str = MEDIAN,
) -> str:
    """Return a quantity beside another value of it in words.

    >>> compared(Quantity("time constant", ()), math.log(2.1), math.log(2.1) / 14)
    "time constant 2.1 times the fleet's median, 14 standard deviations"
    """
    times = _ratio(math.exp(min(max(log_ratio, -700.0), 700.0)))
    if is_reversed:
        return f"{quantity.name} of the opposite sign, {times} times {beside}, {sure:,.0f} standard deviations"
    return f"{quantity.name} {times} times {beside}, {abs(log_ratio) / std:,.0f} standard deviations"


def _ratio(value: float) -> str:
    """Return a ratio with two digits, near one with three.

    Examples
    --------
    >>> _ratio(2.143), _ratio(1.052), _ratio(1234.0)
    ('2.1', '1.05', '1,234')
    """
    if 0.9 < value < 1.1:
        return f"{value:.3g}"
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}" if value < 1e6 else f"{value:.1e}"
