"""How good a model is, and whether to trust it: free run, fit percent, residual tests, excitation, verdict."""

from replant.assessment.judge import WORST_CONDITION, judge
from replant.assessment.simulation import Simulation, fit_percent, simulate
from replant.assessment.verdict import Assessment, Verdict

__all__ = ["WORST_CONDITION", "Assessment", "Simulation", "Verdict", "fit_percent", "judge", "simulate"]
