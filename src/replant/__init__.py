"""Identify continuous-time transfer functions while the plant runs.

>>> import replant as rp
>>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
"""

from replant.assessment import fit_percent
from replant.data.logs import Log, read_log
from replant.errors import (
    ArgumentTypeError,
    CheckpointError,
    DamagedCheckpointError,
    InvalidArgumentError,
    LogError,
    MissingCheckpointError,
    MissingDependencyError,
    ReplantError,
)
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.fit import FitResult, fit
from replant.online.ensemble import Ensemble
from replant.online.identifier import Identifier
from replant.online.resume import load
from replant.online.trace import Trace
from replant.optimizers import (
    AdaDelta,
    AdaGrad,
    Adam,
    AMSGrad,
    Gradient,
    IntegralCost,
    KalmanTracking,
    NAdam,
    RecursiveLeastSquares,
    RMSProp,
)
from replant.optimizers.replay import Replay
from replant.regressor.filters import RefinedFilter, StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.regressor.scaling import Scaling

__version__ = "0.1.0"

__all__ = [
    "AMSGrad",
    "AdaDelta",
    "AdaGrad",
    "Adam",
    "ArgumentTypeError",
    "CheckpointError",
    "DamagedCheckpointError",
    "Ensemble",
    "FitResult",
    "Gradient",
    "Identifier",
    "IntegralCost",
    "InvalidArgumentError",
    "KalmanTracking",
    "Log",
    "LogError",
    "MissingCheckpointError",
    "MissingDependencyError",
    "NAdam",
    "Preprocess",
    "RMSProp",
    "RecursiveLeastSquares",
    "RefinedFilter",
    "ReplantError",
    "Replay",
    "Scaling",
    "StateVariableFilter",
    "Structure",
    "Trace",
    "TransferFunction",
    "Uncertainty",
    "__version__",
    "fit",
    "fit_percent",
    "load",
    "read_log",
]
