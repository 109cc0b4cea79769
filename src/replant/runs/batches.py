"""Records that come batch by batch: of any length, from memory or from a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from replant.arguments import FloatArray


class Source(Protocol):
    """A record of known length, that can be gone through again and again in batches of any sizes."""

    @property
    def samples(self) -> int:
        """How many there are."""

    @property
    def complete(self) -> bool:
        """Whether every one of them is finite."""

    def batches(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Go through raw input and output."""


@dataclass(frozen=True, eq=False)
class Arrays:
    """A record in memory as a source: input and output (K,)."""

    input: FloatArray
    output: FloatArray

    @property
    def samples(self) -> int:
        """How many there are."""
        return self.input.size

    @property
    def complete(self) -> bool:
        """Whether every one of them is finite."""
        return bool(np.isfinite(self.input).all() and np.isfinite(self.output).all())

    def batches(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Give the record as one batch."""
        yield self.input, self.output


def batched(batches: Iterable[tuple[FloatArray, FloatArray]], size: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Cut a record anew into batches of ``size`` samples, the last one of what is left; an empty one of nothing.

    So what is made of a record does not depend on how it came.

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
