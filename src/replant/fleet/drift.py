"""Drift: what has changed since an earlier identification of the same fleet, with the uncertainty of both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.errors import InvalidArgumentError
from replant.fleet.files import TABLE
from replant.fleet.oddness import BEFORE, FEWEST, compared, limit_of
from replant.fleet.quantities import Figures, figures_of, quantities_of
from replant.fleet.results import Fleet
from replant.fleet.robust import Location, located
from replant.fleet.store import read_table
from replant.model.structure import Structure


@dataclass(frozen=True)
class Drifted:
    """A rig that has changed.

    Attributes
    ----------
    rig : str
    distance : float
        In standard deviations, those of both estimates.
    words : str
        What has changed.
    """

    rig: str
    distance: float
    words: str


@dataclass(frozen=True)
class Drift:
    """What has changed in a fleet.

    Attributes
    ----------
    common : int
        Rigs that are in both.
    compared : int
        Rigs that were trusted and are.
    drifted : tuple of Drifted
        Those that have changed by more than chance, the most sure change first.
    fleet : tuple of str
        How the fleet as a whole has changed, by quantity.
    gone, new, lost : tuple of str
        Rigs that are no longer there, that were not, and that were trusted and are not.
    """

    common: int
    compared: int
    drifted: tuple[Drifted, ...]
    fleet: tuple[str, ...]
    gone: tuple[str, ...]
    new: tuple[str, ...]
    lost: tuple[str, ...]


def drift_between(before: Fleet, now: Fleet) -> Drift:
    """Return what has changed between two identifications of a fleet.

    A rig has drifted if the difference of both estimates, beside the covariances of both, has a probability below
    that of `replant.fleet.oddness.CHANCE` divided by the number of rigs.
    """
    import pyarrow

    check_comparable(before, now.structure, now.folder)
    old, new = (read_table(fleet.folder, TABLE) for fleet in (before, now))
    old_rows, new_rows = ({name: row for row, name in enumerate(of.column("rig").to_pylist())} for of in (old, new))
    both = [name for name in new_rows if name in old_rows]
    old, new = (
        of.take(pyarrow.array([rows[name] for name in both], pyarrow.int64()))  # of no rig, too
        for of, rows in ((old, old_rows), (new, new_rows))
    )
    was, is_now = (np.asarray(of.column("verdict").to_pylist(), object) == "trusted" for of in (old, new))
    found = _differences(old, new, was & is_now, now.structure)
    return Drift(
        len(both),
        int((was & is_now).sum()),
        tuple(sorted((Drifted(both[row], distance, words) for row, distance, words in found[0]),
                     key=lambda each: (-each.distance, each.rig))),
        found[1],
        tuple(name for name in old_rows if name not in new_rows),
        tuple(name for name in new_rows if name not in old_rows),
        tuple(name for name, trusted in zip(both, was & ~is_now, strict=True) if trusted),
    )  # fmt: skip


def check_comparable(before: Fleet, structure: Structure, folder: Path) -> None:
    """Check that results can be compared with those of a structure in a folder, before these are made."""
    if before.structure != structure:
        raise InvalidArgumentError(
            f"{before.folder}: its models are of {before.structure}, those of {folder} of {structure}; "
            "identify both with the same options"
        )
    if before.folder.resolve() == folder.resolve():
        raise InvalidArgumentError(
            f"{before.folder}: the new results would take the place of those that they are compared with; name another "
            "folder (out, --out)"
        )
    len(before)  # it can be read


def _differences(
    old: Any, new: Any, trusted: BoolArray, structure: Structure
) -> tuple[list[tuple[int, float, str]], tuple[str, ...]]:
    """Return row, distance and words of the rigs that have drifted, and how the fleet has."""
    first = figures_of(old, structure, trusted)
    second = figures_of(new, structure, trusted)
    if (first.signs != second.signs).any():
        return [], ("the signs of the coefficients have changed in the whole fleet",)
    usable = trusted & first.known & second.known
    if not usable.any():
        return [], ()
    off, P = second.x - first.x, first.covariances + second.covariances
    turned = first.reversed != second.reversed
    size = off.shape[1]
    place = Location(np.zeros(size), np.zeros((size, size)), 1.0)
    told: tuple[str, ...] = ()
    straight = usable & ~turned.any(axis=1)
    if straight.sum() >= FEWEST + size:
        around = located(off[straight], P[straight])
        place = Location(np.zeros(size), np.zeros((size, size)), around.scale)
        told = _of_fleet(second, around, P[straight], structure)
    squared = np.where(usable, place.squared_distances(off, P), 0.0)
    certainty = np.minimum(first.certainty, second.certainty)
    squared += np.where(turned & usable[:, None], np.square(certainty), 0.0).sum(axis=1)
    limit = limit_of(size, int(straight.sum()), int(usable.sum()))
    drifted = []
    for row in np.flatnonzero(usable & (squared > limit)).tolist():
        words = _of_rig(second, off[row], place.scale * P[row], turned[row], certainty[row], structure)
        drifted.append((row, math.sqrt(squared[row]), words))
    return drifted, told


def _of_fleet(figures: Figures, around: Location, P: FloatArray, structure: Structure) -> tuple[str, ...]:
    """Return by which ratio the fleet's quantities have changed, where that is more than chance."""
    said = []
    uncertain = np.linalg.inv(np.linalg.inv(around.spread + P).sum(axis=0)) * around.scale
    for quantity in quantities_of(structure):
        w = figures.weights(quantity)
        if w is None:
            continue
        moved, std = float(w @ around.centre), math.sqrt(float(w @ uncertain @ w))
        if abs(moved) > 4.0 * std > 0.0:
            said.append(compared(quantity, moved, std, beside=BEFORE))
    return tuple(said)


def _of_rig(
    figures: Figures, off: FloatArray, P: FloatArray, turned: BoolArray, certainty: FloatArray, structure: Structure
) -> str:
    said = []
    for quantity in quantities_of(structure):
        w = figures.weights(quantity)
        if w is None:
            continue
        log_ratio, std = float(w @ off), math.sqrt(float(w @ P @ w))
        is_reversed = bool(turned[w != 0.0].sum() % 2)
        sure = float(certainty[w != 0.0].min()) if is_reversed else 0.0
        words = compared(quantity, log_ratio, std, is_reversed=is_reversed, sure=sure, beside=BEFORE)
        said.append((max(abs(log_ratio) / std, sure), words))
    said.sort(key=lambda each: -each[0])
    return "; ".join([text for size, text in said if size >= 4.0][:2] or [text for _, text in said[:1]])
