"""The optimizers as a user chooses them, one class a file, registered here; their loops lie in `kernels.optimizers`.

To add one: its kernel, code and line in `learn` of `replant.kernels.optimizers.gradient` (or `step`, with a
covariance), its class in a file of this folder, its name in `OPTIMIZERS` below.  The tests of every optimizer come from
that list.
"""

from replant.optimizers.adadelta import AdaDelta
from replant.optimizers.adagrad import AdaGrad
from replant.optimizers.adam import Adam
from replant.optimizers.amsgrad import AMSGrad
from replant.optimizers.gradient import Gradient
from replant.optimizers.integral_cost import IntegralCost
from replant.optimizers.kalman_tracking import KalmanTracking
from replant.optimizers.nadam import NAdam
from replant.optimizers.optimizer import Optimizer
from replant.optimizers.recursive_least_squares import RecursiveLeastSquares
from replant.optimizers.rmsprop import RMSProp

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
    "OPTIMIZERS",
    "AMSGrad",
    "AdaDelta",
    "AdaGrad",
    "Adam",
    "Gradient",
    "IntegralCost",
    "KalmanTracking",
    "NAdam",
    "Optimizer",
    "RMSProp",
    "RecursiveLeastSquares",
]
