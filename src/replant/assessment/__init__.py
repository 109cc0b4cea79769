"""Model validation: simulated fit, residual tests, excitation of the input, uncertainty, and the verdict on a model."""

from replant.assessment.assess import assess_record, assess_running, assess_starting
from replant.assessment.record_tests import WORST_CONDITION
from replant.assessment.verdict import Assessment, Verdict
from replant.simulation.fitted_run import Simulation, fit_percent, simulate

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
