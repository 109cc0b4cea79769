"""Records of any length that come batch by batch, from memory or from a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from replant.arguments import FloatArray

Batch = tuple[FloatArray, ...]  # input, output, the reference if there is one, the stamps if there are some; (K,) each


class Source(Protocol):
    """A record of known length whose batches, of any sizes, can be read repeatedly."""

    @property
    def samples(self) -> int:
        """Number of samples."""

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""

    def batches(self) -> Iterator[Batch]:
        """Yield raw input, output, the reference if there is one, and stamps in s if there are some, batch by batch."""


@dataclass(frozen=True, eq=False)
class Arrays:
    """A record in memory as a source: input, output, perhaps a reference, perhaps stamps of an irregular clock (K,)."""

    input: FloatArray
    output: FloatArray
    reference: FloatArray | None = None
    stamps: FloatArray | None = None

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.input.size

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""
        return all(bool(np.isfinite(signal).all()) for batch in self.batches() for signal in batch)

    def batches(self) -> Iterator[Batch]:
        """Yield the record as one batch."""
        every = self.input, self.output, self.reference, self.stamps
        yield tuple(signal for signal in every if signal is not None)


def batched(batches: Iterable[Batch], size: int) -> Iterator[Batch]:
    """Yield a record in batches of ``size`` samples, the last one shorter; one empty batch for an empty record.

    What is computed from a record then does not depend on the batches that it came in.

    Examples
    --------
    >>> parts = [(np.arange(3.0), np.zeros(3)), (np.arange(3.0, 5.0), np.zeros(2))]
    >>> [u.tolist() for u, _ in batched(parts, 2)]
    [[0.0, 1.0], [2.0, 3.0], [4.0]]
    """
    held: list[Batch] = []
    count, some = 0, False
    for batch in batches:
        begin, rows = 0, batch[0].size
        while count + rows - begin >= size:
            end = begin + size - count
            yield _joined([*held, tuple(signal[begin:end] for signal in batch)])
            held, count, begin, some = [], 0, end, True
        if begin < rows:
            held.append(tuple(signal[begin:] for signal in batch))
            count += rows - begin
    if held or not some:
        yield _joined(held)


def _joined(parts: list[Batch]) -> Batch:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return np.empty(0), np.empty(0)
    return tuple(np.concatenate(signals) for signals in zip(*parts, strict=True))
