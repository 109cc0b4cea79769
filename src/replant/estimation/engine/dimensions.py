"""Dimensions: the size of every array of a state, as integers, before any array is allocated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.estimation.settings import STORED, Request, Settings
from replant.kernels.schema import ROOM, ROWS, StateSlots, dimensions
from replant.kernels.slot_tables import Numbers, Slot
from replant.model.structure import Structure

DENSEST = 4.0  # highest rate of samples for which the inputs of the dead time are kept [nominal rates]


@dataclass(frozen=True)
class Dimensions:
    """The numbers that define the sizes of the kernels' arrays, named as the slots of a state."""

    order: int  # poles, n
    entries: int  # entries of the regressor, T
    ring_size: int  # past inputs kept
    memory_size: int = 0  # numbers of the optimizer's memory, M
    settings_size: int = 0  # numbers of its settings, S
    batch_size: int = 1  # updates a sample
    capacity: int = 1  # rows of the buffer
    recent_size: int = 0  # raw samples kept
    instruments: bool = False  # whether a row of the buffer also holds the instruments
    examines_output: bool = False  # whether outputs are examined before they are learned
    has_reference: bool = False  # whether there is a reference, which is kept with the raw samples
    path_size: int = ROOM  # rows of the estimate's path

    @classmethod
    def of_settings(cls, settings: Settings, recent: int, path: int | None = None) -> Dimensions:
        """Return the dimensions of an identifier with these settings, ``recent`` raw samples and ``path`` rows."""
        structure, replay, optimizer = settings.structure, settings.replay, settings.optimizer
        entries = entries_of(structure, refined=settings.filter.follows_estimate)
        if path is None:
            path = ROOM if recent >= FEWEST_JUDGED else 0
        return cls(
            structure.poles,
            entries,
            ring_of(structure, settings.dt),
            optimizer.memory(entries).size,
            optimizer.settings(settings.dt, np.ones(entries)).size,
            batch_size=replay.batch_size if replay else 1,
            capacity=replay.capacity if replay else 1,  # without replay only the newest sample is learned
            recent_size=recent,
            instruments=settings.instruments,
            examines_output=optimizer.keeps_covariance,
            has_reference=settings.reference,
            path_size=path,
        )

    @classmethod
    def of_request(cls, request: Request, recent: int, *, reference: bool) -> Dimensions:
        """Return the dimensions of a start-up, which collects samples before there are filters and an estimate."""
        ring, examines = ring_of(request.structure, request.dt), request.keeps_covariance
        return cls(1, 1, ring, recent_size=recent, examines_output=examines, has_reference=reference)

    @property
    def numbers(self) -> Numbers:
        """The dimensions by their names in the schema."""
        return dimensions(**vars(self))

    @property
    def begins(self) -> dict[Slot[Any], int]:
        """The begin of each block in ``reals``."""
        begins = StateSlots.begins(self.numbers)
        return {block: begins[block.name] for block in StateSlots.blocks}

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each array of a state, by its name."""
        from replant.kernels.filters import bank

        return {
            "ints": (ROWS + self.batch_size,),
            "reals": (StateSlots.size(self.numbers),),
            "banks": (3, bank.size(self.order, self.entries)),
            "buffer": (self.capacity, (2 if self.instruments else 1) * self.entries + 2),
            "recent": (self.recent_size, 6 if self.has_reference else 5 if self.examines_output else 3),
        }


def entries_of(structure: Structure, *, refined: bool) -> int:
    """Return the number T of regressor entries; the refined filter adds a constant and an initial state."""
    n = structure.poles
    return n + structure.zeros + 1 + (1 + n if refined else int(structure.bias))


def ring_of(structure: Structure, dt: float) -> int:
    """Return how many past inputs are kept for the dead time."""
    return math.ceil(DENSEST * (structure.delay / dt)) + 8


def room_for(samples: int, most: int) -> int:
    """Return the rows allocated for raw samples after so many ``samples``: doubled when full, up to ``most``."""
    rows = min(FIRST_ROOM, most)
    while rows < most and rows <= samples:
        rows = min(2 * rows, most)
    return rows


def rooms(most: int) -> set[int]:
    """Return all numbers of rows that `room_for` may give with this ``most``."""
    return {room_for(samples, most) for samples in (0, *(FIRST_ROOM << power for power in range(most.bit_length())))}


def collects_at_most(request: Request) -> int:
    """Return the most samples that a start-up collects."""
    return max(STORED, request.first_hold)


# a verdict holds out half of the samples, and needs a hundred of these (`verdict.evidence.FEWEST`)
FEWEST_JUDGED = 200  # raw samples kept below which a verdict is made from running sums [samples]
# two start-ups; all copies together cost less than twice the last one
FIRST_ROOM = 1024  # raw samples that there is room for at first; the room doubles when it is full [samples]
RECENT = 10_000  # newest raw samples used to solve a growing start-up again, and for assessment [samples]
