"""The optimizers as a user chooses them, registered here; their loops lie in `kernels.optimizers`.

To add one: its kernel, code and line in `learn` of `replant.kernels.optimizers.gradient` (or `step`, with a
covariance), its place in `kernels.step.soundness`, its class in `gradient` or `covariance`, its name in `OPTIMIZERS`
below.  The tests of every optimizer come from that list.
"""

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

#: Every optimizer by the name that the command line takes.
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
