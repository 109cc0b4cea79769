"""Records of any length that come batch by batch, from memory or from a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from replant.arguments import FloatArray


class Source(Protocol):
    """A record of known length whose batches, of any sizes, can be read repeatedly."""

    @property
    def samples(self) -> int:
        """Number of samples."""

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""

    def batches(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield raw input and output, (K,) each, batch by batch."""


@dataclass(frozen=True, eq=False)
class Arrays:
    """A record in memory as a source: input and output (K,)."""

    input: FloatArray
    output: FloatArray

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.input.size

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""
        return bool(np.isfinite(self.input).all() and np.isfinite(self.output).all())

    def batches(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the record as one batch."""
        yield self.input, self.output


def batched(batches: Iterable[tuple[FloatArray, FloatArray]], size: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield a record in batches of ``size`` samples, the last one shorter; one empty batch for an empty record.

    What is computed from a record then does not depend on the batches that it came in.

    Examples
    --------
    >>> parts = [(np.arange(3.0), np.zeros(3)), (np.arange(3.0, 5.0), np.zeros(2))]
    >>> [u.tolist() for u, _ in batched(parts, 2)]
    [[0.0, 1.0], [2.0, 3.0], [4.0]]
    """
    held: list[tuple[FloatArray, FloatArray]] = []
    count, some = 0, False
    for u, y in batches:
        begin = 0
        while count + u.size - begin >= size:
            end = begin + size - count
            yield _joined([*held, (u[begin:end], y[begin:end])])
            held, count, begin, some = [], 0, end, True
        if begin < u.size:
            held.append((u[begin:], y[begin:]))
            count += u.size - begin
    if held or not some:
        yield _joined(held)


def _joined(parts: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([np.empty(0), *(u for u, _ in parts)]), np.concatenate([np.empty(0), *(y for _, y in parts)])
