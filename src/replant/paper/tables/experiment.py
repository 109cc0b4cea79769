"""Experiment: one row of a table, from the simulated plant to the performance indices."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.model import state_space
from replant.model.structure import Structure
from replant.online.ensemble import Ensemble
from replant.online.identifier import Identifier
from replant.online.trace import Trace
from replant.optimizers import Optimizer
from replant.optimizers.optimizer import Replay
from replant.regressor.filters import StateVariableFilter
from replant.regressor.scaling import Scaling
from replant.signals import square


@dataclass(frozen=True)
class Plant:
    """A simulated plant under a square wave, section 3 of the article.

    >>> plant = Plant(num=(1.25,), den=(1.0, 0.5), dt=1e-3, duration=10.0, period=1.25)
    >>> plant.samples, plant.true
    (10000, {'a0': 0.5, 'b0': 1.25})
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    dt: float
    duration: float
    period: float
    amplitude: float = 1.0
    drift: float = 0.0

    @property
    def samples(self) -> int:
        """Length of the record in samples."""
        return round(self.duration / self.dt)

    @property
    def true(self) -> dict[str, float]:
        """The true parameters by name."""
        names = Structure(poles=len(self.den) - 1, zeros=len(self.num) - 1).names
        return dict(zip(names, self.den[1:] + self.num, strict=True))

    def record(self) -> tuple[FloatArray, FloatArray]:
        """Return input and output (K,), simulated from rest by Tustin's rule: the article's alpha of 0.5.

        The output is C (x[k] + x[k+1]) / 2, by the mean of the state over the interval that begins at t_k.
        """
        u = square(self.samples, self.period, self.dt, self.amplitude)
        model = state_space.companion(np.asarray(self.den))
        transition, column = state_space.bilinear(model.matrix, model.column, self.dt, 0.5)
        row = np.zeros(column.size)
        row[column.size - len(self.num) :] = self.num
        states = np.zeros((u.size + 1, column.size))
        for k in range(u.size):
            states[k + 1] = transition @ states[k] + column * u[k]
        y = 0.5 * (states[:-1] + states[1:]) @ (row / model.scale)
        return u, y + self.drift * self.dt * np.arange(u.size)


@dataclass(frozen=True)
class Experiment:
    """One row of a table: a plant and the settings under which it is identified."""

    plant: Plant
    filter: StateVariableFilter
    scaling: Scaling | None
    optimizer: Optimizer
    replay: Replay | None = None
    bias: bool = False

    @property
    def structure(self) -> Structure:
        """The structure of the plant, with a bias if one is identified."""
        return Structure(poles=len(self.plant.den) - 1, zeros=len(self.plant.num) - 1, bias=self.bias)

    def identifier(self, seed: int = 0) -> Identifier:
        """Return the identifier before its first sample; ``seed`` is that of the replay buffer."""
        return Identifier(
            self.structure,
            self.plant.dt,
            filter=self.filter,
            scaling=self.scaling,
            optimizer=self.optimizer,
            replay=None if self.replay is None else dataclasses.replace(self.replay, seed=seed),
        )

    def indices(self, trace: Trace) -> dict[str, float]:
        """Return J of each plant parameter and their sum, (21); the bias, which has no true value, is left out."""
        true = self.plant.true
        values = trace.index([true.get(name, np.nan) for name in trace.names])
        indices = {f"J_{name}": float(J) for name, J in zip(trace.names, values, strict=True) if name in true}
        return indices | {"J_sum": sum(indices.values())}


def trace(experiment: Experiment, seed: int = 0, record: tuple[FloatArray, FloatArray] | None = None) -> Trace:
    """Run an experiment; return the estimate after every sample."""
    u, y = experiment.plant.record() if record is None else record
    return experiment.identifier(seed).update_many(u, y)


def run_seeds(
    experiment: Experiment, seeds: Iterable[int], record: tuple[FloatArray, FloatArray]
) -> list[dict[str, float]]:
    """Run an experiment with several seeds at once; return the performance indices of each."""
    ensemble = Ensemble([experiment.identifier(seed) for seed in seeds])
    return [experiment.indices(trace) for trace in ensemble.trace(*record)]


def run(experiment: Experiment, seed: int = 0, record: tuple[FloatArray, FloatArray] | None = None) -> dict[str, float]:
    """Run an experiment; return its performance indices by name: "J_a0", ..., "J_sum".

    >>> from replant.paper.tables.published import TABLES
    >>> indices = run(TABLES["table1"].row("Gradient, no buffer").experiment)
    >>> {name: f"{value:.2e}" for name, value in indices.items()}
    {'J_a0': '8.41e+02', 'J_b0': '1.64e+03', 'J_sum': '2.48e+03'}

    References
    ----------
    Bernat and Kolota (2023), (21).
    """
    return experiment.indices(trace(experiment, seed, record))
