"""What an identification of several inputs was asked for, and the newest samples that it keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray

LEAST = 4  # outputs for the first model, at the least [count for each unknown]
ROOM = 256  # rows that there is room for at first [samples]


class RowSettings(NamedTuple):
    """The settings of an identification: sampling time in s; outputs for the first model; raw samples kept; names."""

    structures: tuple[Structure, ...]
    dt: float
    startup: int
    history: int
    input_hold: str
    input_names: tuple[str, ...]

    @property
    def size(self) -> int:
        """How many parameters there are."""
        return sum(each.size for each in self.structures)


@dataclass(frozen=True, eq=False)
class RowHistory:
    """The newest samples, at most ``most``; rows behind ``end`` belong to whoever appends to the newest history."""

    rows: FloatArray  # (R, q + p + 2): inputs, references, output, time in s
    most: int
    begin: int = 0
    end: int = 0

    @property
    def values(self) -> FloatArray:
        """The rows (K, q + p + 2)."""
        return self.rows[self.begin : self.end]

    @property
    def measured(self) -> int:
        """How many of them have an output."""
        return int(np.isfinite(self.values[:, -2]).sum())

    def with_more(self, rows: FloatArray) -> RowHistory:
        """Return the history with further rows (K, q + p + 2)."""
        room, begin, end = self.rows, self.begin, self.end
        if end + len(rows) > len(room):
            room = np.empty((max(ROOM, 2 * (end - begin + len(rows))), room.shape[1]))
            room[: end - begin] = self.values
            begin, end = 0, end - begin
        room[end : end + len(rows)] = rows
        end += len(rows)
        return RowHistory(room, self.most, max(begin, end - self.most), end)

    def copy(self) -> RowHistory:
        """Return a history that is appended to by itself."""
        return RowHistory(self.values.copy(), self.most, 0, self.end - self.begin)


def fewest(structures: tuple[Structure, ...]) -> int:
    """Return the fewest outputs for a first model: `LEAST` for each coefficient, initial state and offset."""
    return LEAST * sum(each.size + each.poles + 1 for each in structures)
