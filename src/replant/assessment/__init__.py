"""Model validation: simulated fit, residual tests, excitation of the input, uncertainty, and the verdict on a model."""

from replant.assessment.assess_offline import assess_record
from replant.assessment.assess_online import assess_running, assess_starting
from replant.assessment.excitation import WORST_CONDITION
from replant.assessment.verdict import Assessment, Verdict
from replant.simulation.offset_fit import Simulation, fit_percent, simulate

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
