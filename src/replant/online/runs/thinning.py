"""Records of any length: batches of samples, and an overview."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from replant.numerics.arguments import BoolArray, FloatArray
from replant.plotting.over_time import POINTS, Thinned, Thinner

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
    """Yield a record in batches of ``size``, however it came, the last one shorter; of an empty one one batch."""
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


@dataclass(frozen=True, eq=False)
class Overview:
    """What is kept of a record that is too long for memory."""

    # input, output, model, residual: raw input, measured and simulated output, and their difference, over the whole
    # record
    input: Thinned
    output: Thinned
    model: Thinned
    residual: Thinned
    newest_input: FloatArray  # newest_input, newest_output: (N,): the newest samples, unchanged
    newest_output: FloatArray
    samples: int  # samples of the record
    # (N,): of an irregular clock: when the newest samples were taken, in s since the first sample of the record
    newest_times: FloatArray | None = None


class Recorder:
    """Collects the overview of a record and of its modelled output, which come batch by batch."""

    def __init__(self, length: int, newest: int | None = None) -> None:
        self.samples = 0
        self._newest = length if newest is None else newest
        self._kept: list[tuple[FloatArray, ...]] = []
        self._began: float | None = None
        self._thinners = [Thinner(length, POINTS) for _ in range(4)] if self._newest < length else []

    def take(
        self,
        u: FloatArray,
        y: FloatArray,
        modelled: FloatArray,
        used: BoolArray | np.bool_ = np.True_,
        t: FloatArray | None = None,
    ) -> None:
        """Take the next samples."""
        if t is not None and self._began is None and t.size:
            self._began = float(t[0])
        self._kept.append((u, y, modelled) if t is None else (u, y, modelled, t))
        self.samples += u.size
        while sum(part[0].size for part in self._kept[1:]) >= max(self._newest, 1):
            del self._kept[0]
        if self._thinners:
            with np.errstate(over="ignore", invalid="ignore"):
                signals = (u, y, modelled, np.where(used, y - modelled, np.nan))
            for thinner, signal in zip(self._thinners, signals, strict=True):
                thinner.take(signal)

    def output(self, shift: float) -> FloatArray:
        """Return the newest samples of the modelled output, ``shift`` added."""
        return self._last(2) + shift

    def overview(self, shift: float) -> Overview | None:
        """Return the overview, ``shift`` added to the modelled output; None if every sample is kept."""
        if not self._thinners:
            return None
        u, y, model, residual = (thinner.thinned for thinner in self._thinners)
        model = replace(model, values=model.values + shift)
        residual = replace(residual, values=residual.values - shift)
        times = None if self._began is None else self._last(3) - self._began
        return Overview(u, y, model, residual, self._last(0), self._last(1), self.samples, times)

    def _last(self, which: int) -> FloatArray:
        whole = np.concatenate([np.empty(0), *(part[which] for part in self._kept)])
        return whole[max(0, whole.size - self._newest) :]
