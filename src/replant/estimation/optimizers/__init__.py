"""The optimizers that a user can choose, registered here; their loops are in `kernels.optimizers`.

To add one: add its loop, its code and a line in `learn` of `replant.kernels.optimizers.gradient` (`covariance` if it
keeps a covariance), the number of its settings in `kernels.step.soundness`, its class in `gradient` or `optimizer`, and
its name in `OPTIMIZERS` below.  The tests of all optimizers are made from that list.
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

#: Every optimizer by its name on the command line.
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
