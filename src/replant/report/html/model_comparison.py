"""Several models beside one record: outputs, step responses, frequency responses and poles in common axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.arguments import instance
from replant.assessment import Assessment, Simulation
from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.identified.model import Model
from replant.identified.validation import Validation
from replant.log import Log
from replant.plotting.diagrams import Shown
from replant.report.figures.models import draw_models
from replant.report.number_format import percent, uncertain
from replant.runs.result import Clock, Result
from replant.runs.run_log import Contender, best
from replant.simulation.stretches import stretches_of

HEADINGS = ("model", "verdict", "simulated", "one step", "poles", "zeros", "dead time", "DC gain", "time constants [s]")


@dataclass(frozen=True, eq=False, repr=False)
class ModelComparison(Shown):
    """Several models beside one record.

    Attributes
    ----------
    models : dict of Model
        By name.
    validations : dict of Validation
        Of each model by the record, by the same names.
    log : Log
        The record.
    """

    models: Mapping[str, Model]
    validations: Mapping[str, Validation]
    log: Log

    @property
    def best(self) -> str:
        """Name of the model whose simulated output fits the record best."""
        found = best(self.contenders)
        return next(iter(self.models)) if found is None else found.name

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table: a row of words for each model, see `HEADINGS`."""
        return [self._row(name) for name in self.models]

    @property
    def contenders(self) -> list[Contender]:
        """The models with their outputs as results, for the figures."""
        return [Contender(name, self._result(name)) for name in self.models]

    def plot(self, axes: Any = None) -> Any:
        """Draw outputs, step responses, magnitudes and poles of all models; return four axes of matplotlib.

        Parameters
        ----------
        axes : four matplotlib axes, optional
            Drawn into; without them a figure is made.
        """
        results = {each.name: each.result for each in self.contenders if each.result is not None}
        return draw_models(self.models, results, self.log, self.best, axes)

    def __repr__(self) -> str:
        rows = [f"{name}: {self.models[name].transfer_function}, {self.validations[name]!r}" for name in self.models]
        more = [f"... {len(rows) - 10} more"] if len(rows) > 10 else []
        return "\n  ".join([f"<ModelComparison over {self.log!r}", *rows[:10], *more]) + ">"

    def _row(self, name: str) -> tuple[str, ...]:
        model, found = self.models[name], self.validations[name]
        structure, known = model.structure, model.uncertainty
        gain = uncertain(float(model.transfer_function.dc_gain), math.nan if known is None else known.dc_gain_std)
        modes = [
            uncertain(mode.time_constant, None if known is None else known.modes[i].time_constant_std)
            for i, mode in enumerate(model.transfer_function.modes)
        ]
        size = (str(structure.poles), str(structure.zeros), f"{structure.delay:.4g} s")
        return name, found.verdict.status, percent(found.fit), percent(found.one_step), *size, gain, "; ".join(modes)

    def _result(self, name: str) -> Result:
        found = self.validations[name]
        simulation = Simulation(found.output, found.offset, found.fit, is_prediction=found.is_prediction)
        verdict = Assessment(found.verdict.status, found.verdict.reasons, found.verdict.excited, found.samples)
        return Result(
            self.models[name], found.one_step, simulation, found.samples, {}, verdict, 0.0,
            left_out=stretches_of(~np.isfinite(found.residual)), clock=Clock.of(self.log.dt, self.log.stamps),
        )  # fmt: skip


def compare(models: Mapping[str, Model] | Sequence[Model], log: Log) -> ModelComparison:
    """Compare several models over one record; of each, offset and initial state are estimated and nothing else.

    Parameters
    ----------
    models : dict or sequence of Model
        By name; of a sequence the names are "model 1" and so on.
    log : Log
        A record that they were not made from tells most.

    Returns
    -------
    ModelComparison
        With a table, the validation of each model, and a plot of all.

    Raises
    ------
    ArgumentTypeError
        If one is no model, or the log no log.
    InvalidArgumentError
        If there is no model.

    Examples
    --------
    >>> import replant as rp
    >>> log = rp.examples.motor()
    >>> found = compare({"one pole": rp.fit(log, poles=1, delay=0.01).model, "two": rp.fit(log, poles=2).model}, log)
    >>> found.best, len(found.rows)
    ('two', 2)
    """
    if not isinstance(models, Mapping | Sequence):
        raise ArgumentTypeError("models must be several: compare([model, other], log); model.validate(log) takes one")
    named = dict(models) if isinstance(models, Mapping) else {f"model {k + 1}": each for k, each in enumerate(models)}
    if not named:
        raise InvalidArgumentError("there is no model to compare")
    named = {name: instance(f"models, {name},", model, Model) for name, model in named.items()}
    log = instance("log", log, Log)
    return ModelComparison(named, {name: model.validate(log) for name, model in named.items()}, log)
