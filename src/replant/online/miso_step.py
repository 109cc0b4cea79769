"""Single samples of several inputs: the recursion for a chunk of one sample, in arrays that are allocated once.

A recursion is never changed in place.  Copying it at each sample takes a hundred times as long as the sample.  So a
step works on a copy of its own, and its owner keeps the samples since: a recursion that takes these as a chunk has the
same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from replant.estimation.engine.state import GAP
from replant.kernels.filters.autoregressions import JITTER
from replant.kernels.schema import LARGEST, LEAP
from replant.numerics.arguments import FloatArray
from replant.online.miso_recursion import SURPRISE
from replant.online.miso_state import RowState

SINCE = 256  # single samples that a state takes as one chunk [samples]


class RowStep:
    """Takes samples one by one after a state that has a model; the state is not changed."""

    def __init__(self, state: RowState) -> None:
        from replant.kernels.step.miso import branch, learn

        assert state.recursion is not None
        recursion = state.recursion
        self._learn, self._branch = learn, branch
        self._models, size = recursion.models.copy(), recursion.delta.size
        self._theta, self._dt = recursion.theta, recursion.dt
        self._origin, self._level = recursion.origin.tolist(), recursion.level
        self._rows = np.vstack([np.empty((1, size + 1)), recursion.tail])  # the first sample shifts the oldest row out
        self._newest, self._error = self._rows[-1], np.empty(1)
        self._interval, self._usual = np.empty(1), np.empty(1, np.int64)
        self._branches: list[tuple[Any, ...]] = []
        self._u = [np.empty(1) for _ in self._origin]
        slope, constant, slowest = 0, recursion.theta.size, recursion.slowest
        free = constant + 1
        for i, (model, structure, u) in enumerate(zip(self._models.models, recursion.structures, self._u, strict=True)):
            zeta, output = np.empty((1, model.entries)), np.empty(1)
            given = *model.arrays, u, self._interval, i == slowest, zeta, output
            parts = (
                (self._newest[slope : slope + structure.size], zeta[0, : structure.coefficients]),
                (self._newest[free : free + structure.poles], zeta[0, -structure.poles :]),
                *(i == slowest) * ((self._newest[constant : constant + 1], zeta[0, structure.coefficients :][:1]),),
            )
            self._branches.append((given, output, parts))
            slope, free = slope + structure.size, free + structure.poles
        noise = recursion.noise
        self._before = (
            self._rows, np.zeros((0, size)), np.ones(1, np.int64), self._usual, state.adapts, noise.order, noise.models,
            noise.powers, recursion.delta.copy(), recursion.factor.copy(), recursion.diagonal.copy(),
            recursion.counts.copy(), recursion.squares.copy(), recursion.harmless, SURPRISE, self._error,
        )  # fmt: skip
        self._work, self._estimate = np.empty(4 * size + 1), recursion.delta[: self._theta.size][None].copy()

    @property
    def parameters(self) -> FloatArray:
        """The estimate (P,)."""
        return np.asarray(self._theta + self._estimate[0])

    def take(self, u: Sequence[float], y: float, interval: float) -> tuple[float, bool]:
        """Take a finite sample; return its error, and whether it raises an alarm."""
        self._rows[:-1] = self._rows[1:]
        self._interval[0], self._usual[0] = interval, abs(interval - self._dt) <= JITTER * self._dt
        error = y - self._level
        for place, value, origin, (given, output, parts) in zip(self._u, u, self._origin, self._branches, strict=True):
            place[0] = value - origin
            self._branch(*given)
            for into, of in parts:
                into[:] = of
            error -= output.item()
        self._newest[-1] = error
        estimate = np.empty((1, self._theta.size))  # a new array, as another thread may read the one before
        is_alarm = self._learn(*self._before, estimate, self._work) < 1.0
        self._estimate = estimate
        return self._error.item(), is_alarm


class Kept(NamedTuple):
    """The state after the last chunk, the step for single samples, and the single samples since: u, y, t."""

    state: RowState
    step: RowStep | None
    since: list[tuple[float, ...]]

    @property
    def now(self) -> RowState:
        """The state after the single samples."""
        return self.state.take_all(self.since) if self.since else self.state

    def interval_to(self, u: Sequence[float], y: float, t: float | None) -> float | None:
        """Return the interval in s to a sample that needs the recursion alone; None for other samples."""
        state, _, since = self
        known = state.recursion
        if known is None or state.references or state.stamped != (t is not None):
            return None
        if 0 < state.due <= state.samples + len(since) + 1 or len(u) != len(known.structures):
            return None
        if known.instruments is not None or known.waits != 0.0:  # references, or a dead time after a gap
            return None
        if not (abs(y) <= LARGEST and all(abs(each) <= LARGEST for each in u)):
            return None
        if t is None:
            interval = state.settings.dt if since else (state.taken - state.last_time) * state.unit
        else:
            shift = state.clock.shift
            interval = t + shift - (since[-1][-1] + shift if since else state.last_time)
        longest = min(GAP * known.dt, LEAP * state.settings.dt)
        return interval if interval > 0.0 and state.closest <= interval <= longest else None

    def with_more(self, step: RowStep, sample: tuple[float, ...], *, is_alarm: bool) -> Kept:
        """Return the kept values after a sample that a step has taken."""
        self.since.append(sample)
        if is_alarm:
            return Kept(self.now, None, [])
        return Kept(self.now, step, []) if len(self.since) >= SINCE else Kept(self.state, step, self.since)
