"""The optimizers as a user chooses them, registered here; their loops lie in `kernels.optimizers`."""

from replant.estimation.optimizers.gradient import (
    AdaDelta,
    AdaGrad,
    Adam,
    AMSGrad,
    Gradient,
    IntegralCost,
    NAdam,
    RMSProp,
)
from replant.estimation.optimizers.optimizer import KalmanTracking, Optimizer, RecursiveLeastSquares

#: Every optimizer by the name that the command line takes; CONTRIBUTING.md says how to add one.
OPTIMIZERS: dict[str, type[Optimizer]] = {
    "gradient": Gradient,
    "adam": Adam,
    "amsgrad": AMSGrad,
    "integral-cost": IntegralCost,
    "adagrad": AdaGrad,
    "rmsprop": RMSProp,
    "nadam": NAdam,
    "adadelta": AdaDelta,
    "recursive-least-squares": RecursiveLeastSquares,
    "kalman-tracking": KalmanTracking,
}

__all__ = [
    "OPTIMIZERS", "AMSGrad", "AdaDelta", "AdaGrad", "Adam", "Gradient", "IntegralCost", "KalmanTracking", "NAdam",
    "Optimizer", "RMSProp", "RecursiveLeastSquares",
]  # fmt: skip
