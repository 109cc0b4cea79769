"""An experiment: records of one kind, the methods that are tried on each, and what is promised of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

import replant as rp
from accuracy.bounds import Bound
from accuracy.feedback import Feedback
from accuracy.methods import Figures, figures_of
from accuracy.records import Measured
from replant.model.uncertainty import Uncertainty

Method = Callable[[rp.Structure, float, Measured], Figures]


@dataclass(frozen=True)
class Experiment:
    """What is measured.

    Attributes
    ----------
    key : str
        "A prbs": the scenario's letter first.
    title : str
        For the table: the plant, its input, the noise.
    structure : Structure
    dt : float
    runs : int
    record : callable
        From a run's number to its record.
    methods : mapping
        By the name that the table gives them.
    truth : mapping
        By figure; figures without a truth are left out.
    bounds : sequence of Bound
    counted : int
        Runs that enter the bounds and statistics, where coverage is measured on more; 0 for all.
    covered : sequence of str
        Methods whose coverage is promised.
    shows_coverage : bool
        Whether the coverage of every method that prints an interval is reported.
    reads_data : bool
        Whether it needs recorded logs.
    beside : bool
        Whether it is a neighbour of what is promised, shown for honesty: its bounds are compared, not promised.
    least_std : mapping
        Cramer-Rao bound by figure, where it is known: the least standard deviation of an unbiased estimator.
    feedback : Feedback or None
        Where a controller makes the input: by what errors are judged there, and what is promised of them.
    """

    key: str
    title: str
    structure: rp.Structure
    dt: float
    runs: int
    record: Callable[[int], Measured]
    methods: Mapping[str, Method]
    truth: Mapping[str, float] = field(default_factory=dict)
    bounds: tuple[Bound, ...] = ()
    counted: int = 0
    covered: tuple[str, ...] = ()
    shows_coverage: bool = False
    reads_data: bool = False
    beside: bool = False
    least_std: Mapping[str, float] = field(default_factory=dict)
    feedback: Feedback | None = None

    @property
    def scenario(self) -> str:
        """The scenario's letter."""
        return self.key.split()[0]

    def run(self, number: int) -> dict[str, Figures]:
        """Return the figures of every method on one record."""
        measured = self.record(number)
        return {name: method(self.structure, self.dt, measured) for name, method in self.methods.items()}


def truth_of(plant: rp.TransferFunction, structure: rp.Structure) -> dict[str, float]:
    """Return the true value of every figure of a plant.

    Examples
    --------
    >>> truth_of(rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(poles=2))["zeta"].__round__(4)
    1.1547
    """
    padded = np.zeros(structure.zeros + 1)
    padded[structure.zeros + 1 - plant.num.size :] = plant.num
    parameters = np.concatenate([plant.den[1:], padded])
    known = Uncertainty(structure, parameters, np.zeros((structure.size, structure.size)))
    return {name: value for name, (value, _) in figures_of(known).items()}
