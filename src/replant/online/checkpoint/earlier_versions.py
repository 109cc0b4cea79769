"""Checkpoints of the previous version: converted to the present one, or refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.estimation.settings import STORED
from replant.kernels.schema import ROOM, PathSlots, StateSlots, SumsSlots
from replant.kernels.slot_tables import Numbers
from replant.online.checkpoint.content_check import layout_of_state

BEFORE = 5  # format of the previous version [number]
LAYOUT_BEFORE = "8d799f7d9cd3f93f"  # fingerprint of its layout of a state


def from_before(header: dict[str, Any], body: memoryview) -> tuple[dict[str, Any], memoryview]:
    """Return header and arrays of a checkpoint, converted from the previous layout; those of others unchanged."""
    if header["layout"] != LAYOUT_BEFORE:
        return header, body  # it is refused later
    # before ``history`` each state kept 30,000 raw samples, a path of estimates and no sums; work arrays were stored
    declared: list[Any] = header["arrays"]
    ints, body = _first(declared[0], body, "<i8")
    reals, body = _first(declared[1], body, "<f8")
    begin = len(reals)
    ints = np.insert(ints, StateSlots.path_size.index, ROOM)
    ints = np.insert(ints, StateSlots.sums.index, begin)
    reals[ints[StateSlots.path.index] + PathSlots.kept.index] = 0.0  # its rows were estimates, not scores
    reals = without_work(np.append(reals, np.zeros(SumsSlots.size(Numbers()))), *work_of(ints))
    head = [["ints", "<i8", [len(ints)], len(ints)], ["reals", "<f8", [len(reals)], len(reals)]]
    header["attributes"]["_request"]["Request"]["history"] = STORED
    header |= {"layout": layout_of_state(), "arrays": [*head, *declared[2:]]}
    return header, memoryview(ints.astype("<i8").tobytes() + reals.astype("<f8").tobytes() + bytes(body))


def _first(declared: list[Any], body: memoryview, kind: str) -> tuple[np.ndarray[Any, Any], memoryview]:
    """Return the first array of the body, including rows that were not stored, and the rest of the body."""
    _, _, (size,), rows = declared
    if not 0 <= rows <= size <= math.floor(len(body) / 8) + ROOM * ROOM:
        raise ValueError("other arrays")
    array = np.zeros(size, kind)
    array[:rows] = np.frombuffer(body, kind, rows)
    return array, body[8 * rows :]


def work_of(ints: np.ndarray[Any, Any]) -> tuple[int, int]:
    """Return begin and end in ``reals`` of the work arrays, which no later sample reads."""
    return int(ints[StateSlots.backup.index]), int(ints[StateSlots.past.index])


def without_work(reals: np.ndarray[Any, Any], begin: int, end: int) -> np.ndarray[Any, Any]:
    """Return reals (R,) with the work arrays moved to the end and zeroed, so that they are not stored."""
    return np.concatenate([reals[:begin], reals[end:], np.zeros(end - begin)])


def with_work(reals: np.ndarray[Any, Any], begin: int, end: int) -> np.ndarray[Any, Any]:
    """Return reals (R,) in their original order, with zero work arrays: the inverse of `without_work`."""
    size = len(reals) - (end - begin)
    return np.concatenate([reals[:begin], np.zeros(end - begin), reals[begin:size]])
