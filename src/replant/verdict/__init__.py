"""Model validation: simulated fit, residual tests, excitation of the input, uncertainty, and the verdict on a model."""

from replant.estimation.simulation.fitted_run import Simulation, fit_percent, simulate
from replant.verdict.assess import assess_record, assess_running, assess_starting
from replant.verdict.sensor_and_excitation import WORST_CONDITION
from replant.verdict.verdict import Assessment, Verdict

__all__ = [
    "WORST_CONDITION",
    "Assessment",
    "Simulation",
    "Verdict",
    "assess_record",
    "assess_running",
    "assess_starting",
    "fit_percent",
    "simulate",
]
