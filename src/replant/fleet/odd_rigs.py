"""The odd rigs of a fleet, and the rigs that have drifted since an earlier identification."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.fleet.fit import Fleet
from replant.fleet.job import Shape
from replant.fleet.statistics import (
    Figures,
    Location,
    Quantity,
    deviations,
    distances,
    figures_of,
    limit_of,
    located,
    unit_factor,
)
from replant.fleet.store import FAILED, column, verdicts_of
from replant.numerics.arguments import BoolArray, FloatArray
from replant.report.findings import much_rejected

FEWEST = 8  # trusted rigs beyond the number of coefficients that suffice to determine what is usual [count]
# a normal variable exceeds it in one of 16,000 cases
FEW_SIGMA = 4.0  # deviation of a quantity from which it is named, too [standard deviations]
# records are often at rest for a tenth or two; the verdict detects a sensor that is stuck for less
STANDING = 0.2  # constant part of an output that is a finding, unless it is usual in the fleet [part of the record]
# a usual rig has nearly the fleet's usual fit; a wrong signal gives a fit near 0
POOR = 0.5  # part of the fleet's usual fit below which the fit of a rig that is not trusted is a finding [part]
# the limit is relative to the 90 % quantile of the trusted rigs, whose noise varies by less; by benchmarks/fleet a
# wrong column leaves at least 10 times as much
UNEXPLAINED = 4.0  # unexplained output from which a rig is odd, over that quantile [ratio of 100 % - fit]


@dataclass(frozen=True, eq=False)
class Oddness:
    """The oddness of each rig of a fleet."""

    # (N,): rows of the table by rank: odd rigs, then failed ones, then those not trusted, then others by distance
    order: np.ndarray[tuple[int], np.dtype[np.int64]]
    odd: BoolArray  # (N,)
    words: tuple[str, ...]  # why a rig is odd; empty if it is not
    # (N,): distance from the fleet in standard deviations of spread and estimate together; NaN if unknown
    distance: FloatArray
    # physical quantities, their median in the fleet, and the usual ratio of rigs to it
    usual: tuple[tuple[Quantity, float, float], ...]


def oddness_of(table: Any, shape: Shape) -> Oddness:
    """Return the odd rigs of a fleet: trusted ones at a distance less probable than `CHANCE` over the number of rigs.

    Rigs that are not trusted do not affect what is usual; they are odd if their signals show the reason.
    """
    verdicts, figures = verdicts_of(table), figures_of(table, shape)
    trusted = verdicts == "trusted"
    words = [""] * len(verdicts)
    distance = np.full(len(verdicts), math.nan)
    usual: tuple[tuple[Quantity, float, float], ...] = ()
    base = trusted & figures.known & ~figures.reversed.any(axis=1)
    if base.sum() >= FEWEST + len(figures.names):
        place = located(figures.x[base], figures.covariances[base])
        squared = distances(figures, place)
        distance[figures.known] = np.sqrt(squared[figures.known])
        weighed = figures.weighed(shape)
        usual = tuple(_usual(figures, place, *each) for each in weighed)
        limit = limit_of(len(figures.names), int(base.sum()), len(verdicts))
        for row in np.flatnonzero(trusted & figures.known & (squared > limit)).tolist():
            words[row] = _of_figures(figures, place, row, weighed)
    for row, said in _of_signals(table, shape, verdicts).items():
        words[row] = said
    odd = np.array([bool(each) for each in words], bool)
    rank = np.select([odd, verdicts == FAILED, ~trusted], [0, 1, 2], 3)
    by_signal = odd & ~trusted
    far = np.where(np.isfinite(distance), distance, 0.0)
    order = np.lexsort((np.arange(len(words)), -far, ~by_signal & odd, rank))
    return Oddness(order, odd, tuple(words), distance, usual)


def _usual(figures: Figures, place: Location, quantity: Quantity, w: FloatArray) -> tuple[Quantity, float, float]:
    """Return a quantity, its median in the fleet, and the usual ratio of rigs to it."""
    middle = math.prod(figures.signs[w != 0.0]) * quantity.factor * math.exp(float(w @ place.centre))
    return quantity, middle, math.exp(math.sqrt(max(float(w @ place.spread @ w), 0.0)))


def _of_figures(figures: Figures, place: Location, row: int, weighed: list[tuple[Quantity, FloatArray]]) -> str:
    """Return a text on the deviations of a rig from the fleet, the largest first."""
    total = (place.spread + figures.covariances[row]) * place.scale
    off = figures.x[row] - place.centre
    found = deviations(weighed, off, total, figures.reversed[row], figures.certainty[row], bound=1.0)
    turned, factor = any(each.turned % 2 and each.quantity.name == "gain" for each in found), unit_factor(found)
    found.sort(key=lambda each: -each.size)
    head = [f"reversed sign: {each.words()}" for each in found if turned and each.turned % 2][:1]
    if not head and factor:
        head = [f"wrong unit? {factor}"]
    rest = [each.words() for each in found if each.size >= FEW_SIGMA]
    if not head:
        rest = rest or [each.words() for each in found[:1]] or ["the coefficients together are far from the fleet's"]
    rest = [text for text in rest if not (head and text in head[0])]
    return "; ".join([*head, *(rest[:2] if not factor or turned else [])])


def _of_signals(table: Any, shape: Shape, verdicts: Any) -> dict[int, str]:
    """Return texts, by row, on what the signals of rigs that are not trusted show."""
    trusted = verdicts == "trusted"
    held, moved, fit = (column(table, name) for name in ("output_held", "output_std", "fit"))
    entered = [(f"input {name}" if name else "input", f"input_std{end}") for name, end, _ in shape.branches]
    usual_held = float(np.nanquantile(held[trusted], 0.9)) if trusted.any() else 0.0
    usual_fit = float(np.nanmedian(fit[trusted])) if trusted.any() else math.nan
    least_fit = _least_fit(fit[trusted])
    reasons = table.column("reasons").to_pylist()
    still = {int(row): name for name, of in entered for row in np.flatnonzero(column(table, of) == 0.0)}
    found = {}
    for row in np.flatnonzero(~trusted & (verdicts != FAILED)):
        if row in still:
            found[int(row)] = f"the {still[int(row)]} does not move"
        elif moved[row] == 0.0 or (held[row] >= STANDING and held[row] > 4.0 * usual_held):
            found[int(row)] = f"stuck sensor? the output stands still over {100.0 * held[row]:.0f} % of the record"
        elif math.isfinite(usual_fit) and not fit[row] >= max(POOR * usual_fit, least_fit):
            shown = f"{fit[row]:.0f} %" if math.isfinite(fit[row]) else "nothing"
            guess = "" if fit[row] >= POOR * usual_fit else "; wrong column?"
            found[int(row)] = f"the model explains {shown}, the fleet's {usual_fit:.0f} %: {reasons[row]}{guess}"
    return found


def _least_fit(trusted: FloatArray) -> float:
    """Return the fit in percent at which 100 % - fit is `UNEXPLAINED` times its 90 % quantile over trusted rigs."""
    known = trusted[np.isfinite(trusted)]
    if known.size < FEWEST:
        return -math.inf
    return 100.0 - UNEXPLAINED * float(np.quantile(100.0 - known, 0.9))


def lost_samples_of(table: Any) -> list[str]:
    """Return by the rule of a report which part of each rig's record is rejected, and why; empty if it is small."""
    if "recorded" not in table.column_names:  # results of an older version
        return [""] * table.num_rows
    rejected, recorded = ([count or 0 for count in table.column(name).to_pylist()] for name in ("rejected", "recorded"))
    why = table.column("rejected_why").to_pylist()
    return [much_rejected(*each) for each in zip(rejected, recorded, why, strict=True)]


BEFORE = "what it was"


@dataclass(frozen=True)
class Drifted:
    """A rig that has changed."""

    rig: str
    distance: float  # in standard deviations of both estimates together
    words: str  # the change


@dataclass(frozen=True)
class Drift:
    """The changes of a fleet between two identifications."""

    common: int  # rigs in both
    compared: int  # rigs trusted in both
    drifted: tuple[Drifted, ...]  # rigs with a significant change, the most significant first
    fleet: tuple[str, ...]  # changes of the fleet as a whole, by quantity
    gone: tuple[str, ...]  # rigs that no longer exist
    new: tuple[str, ...]  # rigs that did not exist before
    lost: tuple[str, ...]  # rigs that are no longer trusted


def drift_between(before: Fleet, now: Fleet) -> Drift:
    """Return the changes between two identifications: differences less probable than `CHANCE` over the rigs' number."""
    import pyarrow

    check_comparable(before, now.shape, now.folder)
    tables = before.table(), now.table()
    old_rows, new_rows = ({name: row for row, name in enumerate(of.column("rig").to_pylist())} for of in tables)
    both = [name for name in new_rows if name in old_rows]
    old, new = (
        of.take(pyarrow.array([rows[name] for name in both], pyarrow.int64()))  # typed, as the list may be empty
        for of, rows in zip(tables, (old_rows, new_rows), strict=True)
    )
    was, is_now = (verdicts_of(of) == "trusted" for of in (old, new))
    drifted, of_fleet = _differences(both, old, new, was & is_now, now.shape)
    return Drift(
        len(both),
        int((was & is_now).sum()),
        drifted,
        of_fleet,
        tuple(name for name in old_rows if name not in new_rows),
        tuple(name for name in new_rows if name not in old_rows),
        tuple(name for name, trusted in zip(both, was & ~is_now, strict=True) if trusted),
    )


def check_comparable(before: Fleet, shape: Shape, folder: Path) -> None:
    """Check that results can be compared with future ones of a shape in a folder."""
    if before.shape != shape:
        raise InvalidArgumentError(
            f"{before.folder}: its models are of {before.shape}, those of {folder} of {shape}; "
            "identify both with the same options"
        )
    if before.folder.resolve() == folder.resolve():
        raise InvalidArgumentError(
            f"{before.folder}: the new results would replace those that they are compared with; name another folder "
            "(out, --out)"
        )
    len(before)  # raises if it cannot be read


def _differences(
    rigs: list[str], old: Any, new: Any, trusted: BoolArray, shape: Shape
) -> tuple[tuple[Drifted, ...], tuple[str, ...]]:
    """Return the drifted rigs, the most significant change first, and the changes of the fleet as a whole."""
    first = figures_of(old, shape, trusted)
    second = figures_of(new, shape, trusted)
    if (first.signs != second.signs).any():
        return (), ("the signs of the coefficients have changed in the whole fleet",)
    usable = trusted & first.known & second.known
    if not usable.any():
        return (), ()
    off, P = second.x - first.x, first.covariances + second.covariances
    turned = first.reversed != second.reversed
    size, scale, told = off.shape[1], 1.0, tuple[str, ...]()
    straight = usable & ~turned.any(axis=1)
    if straight.sum() >= FEWEST + size:
        around = located(off[straight], P[straight])
        scale, none = around.scale, np.zeros(size)
        uncertain = np.linalg.inv(np.linalg.inv(around.spread + P[straight]).sum(axis=0)) * scale
        of_fleet = deviations(second.weighed(shape), around.centre, uncertain, none > 0.0, none)
        told = tuple(each.words(BEFORE) for each in of_fleet if abs(each.log_ratio) > FEW_SIGMA * each.std > 0.0)
    place = Location(np.zeros(size), np.zeros((size, size)), scale)
    squared = np.where(usable, place.squared_distances(off, P), 0.0)
    certainty = np.minimum(first.certainty, second.certainty)
    squared += np.where(turned & usable[:, None], np.square(certainty), 0.0).sum(axis=1)
    limit = limit_of(size, int(straight.sum()), int(usable.sum()))
    drifted, weighed = [], second.weighed(shape)
    for row in np.flatnonzero(usable & (squared > limit)).tolist():
        moved = deviations(weighed, off[row], scale * P[row], turned[row], certainty[row])
        moved.sort(key=lambda each: -each.size)
        sure = [each for each in moved if each.size >= FEW_SIGMA][:2] or moved[:1]
        drifted.append(Drifted(rigs[row], math.sqrt(squared[row]), "; ".join(each.words(BEFORE) for each in sure)))
    return tuple(sorted(drifted, key=lambda each: (-each.distance, each.rig))), told
