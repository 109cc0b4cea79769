"""Records of any length: batches of samples, signals thinned for drawing, an overview."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from replant.arguments import BoolArray, FloatArray

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


@dataclass(frozen=True, eq=False)
class Thinned:
    """A signal as it is drawn: evenly spaced points, counted in samples of the whole signal."""

    # (V,): NaN where the signal has nothing to show
    values: FloatArray
    first: float  # first, step: position of the first point and distance of the points, in samples
    step: float

    def times(self, dt: float) -> FloatArray:
        """Return when each point is, (V,), in s."""
        return np.asarray(dt * (self.first + self.step * np.arange(self.values.size)))

    @property
    def places(self) -> FloatArray:
        """Which sample each point is, (V,); a fraction lies between two samples."""
        return np.asarray(self.first + self.step * np.arange(self.values.size))

    def among(self, t: FloatArray) -> FloatArray:
        """Return when each point is, (V,), in the signal whose samples came at the times ``t`` (K,), evenly or not."""
        last = float(t[-1] - t[-2]) if t.size > 1 else 0.0
        beyond = last * np.maximum(self.places - (t.size - 1), 0.0)
        return np.asarray(np.interp(self.places, np.arange(t.size), t) + beyond)

    def indices(self, length: int) -> npt.NDArray[np.intp]:
        """Return the index (V,) of the sample nearest below each point, in the signal of ``length`` samples."""
        places = self.first + self.step * np.arange(self.values.size)
        return np.minimum(places.astype(np.intp), length - 1)

    def again(self, points: int) -> Thinned:
        """Return the same, thinned further."""
        drawn = thin(self.values, points)
        return Thinned(drawn.values, self.first + self.step * drawn.first, self.step * drawn.step)


def thin(signal: FloatArray, points: int) -> Thinned:
    """Return at most ``points`` points that show every peak of ``signal`` (K,); all samples where they are few enough.

    The signal is cut into stretches of equal length, one for each column of a picture; of each the least and the
    greatest finite value are kept, in the order in which they came.
    """
    thinner = Thinner(signal.size, points)
    thinner.take(signal)
    return thinner.thinned


class Thinner:
    """Does what `thin` does, of a signal of ``length`` samples that comes batch by batch."""

    def __init__(self, length: int, points: int) -> None:
        self._width = 1 if length <= points else -(-length // max(1, points // 2))
        self._rest, self._parts = np.empty(0), [np.empty(0)]

    def take(self, signal: FloatArray) -> None:
        """Take the next samples (K,)."""
        if self._width == 1:
            self._parts.append(np.where(np.isfinite(signal), signal, np.nan))
            return
        known = np.concatenate([self._rest, signal])
        whole = known.size // self._width * self._width
        self._parts.append(_extremes(known[:whole].reshape(-1, self._width)))
        self._rest = known[whole:].copy()

    @property
    def thinned(self) -> Thinned:
        """The signal so far, as it is drawn."""
        if self._width == 1:
            return Thinned(np.concatenate(self._parts), 0.0, 1.0)
        last = np.full(self._width if self._rest.size else 0, np.nan)
        last[: self._rest.size] = self._rest
        values = np.concatenate([*self._parts, _extremes(last.reshape(-1, self._width))])
        return Thinned(values, 0.25 * self._width, 0.5 * self._width)


def _extremes(rows: FloatArray) -> FloatArray:
    """Return the least and the greatest finite value of each row, in the order in which they came, (2 R,)."""
    missing = ~np.isfinite(rows)
    least, greatest = np.where(missing, np.inf, rows), np.where(missing, -np.inf, rows)
    places = np.sort(np.stack([least.argmin(axis=1), greatest.argmax(axis=1)]), axis=0)
    values = np.take_along_axis(rows, places.T, axis=1).ravel()
    values[~np.isfinite(values)] = np.nan
    return np.asarray(values)


POINTS = 36_000  # points of a signal at most: nine-fold zoom on 2,000 columns loses nothing [count]


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
