"""Overview of a record that is too long for memory: thinned signals for plots, and the newest samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.runs.thinning import Thinned, Thinner

POINTS = 36_000
"""Points of each signal at most: a screen is 2,000 columns wide, so nine-fold zoom loses nothing [count]."""


@dataclass(frozen=True, eq=False)
class Overview:
    """What is kept of a record that is too long for memory.

    Attributes
    ----------
    input, output, model, residual : Thinned
        Raw input, measured and simulated output, and their difference, over the whole record.
    newest_input, newest_output : (N,) arrays
        The newest samples, unchanged.
    samples : int
        Samples of the record.
    newest_times : (N,) array or None
        Of an irregular clock: when the newest samples were taken, in s since the first sample of the record.
    """

    input: Thinned
    output: Thinned
    model: Thinned
    residual: Thinned
    newest_input: FloatArray
    newest_output: FloatArray
    samples: int
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
