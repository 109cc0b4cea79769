"""Identify continuous-time transfer functions while the plant runs.

>>> import replant as rp
>>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
"""

from replant.assessment import fit_percent
from replant.checkpoint.resume import load
from replant.ensemble import Ensemble
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
from replant.filters import RefinedFilter, StateVariableFilter
from replant.identifier import Identifier
from replant.logs import Log, read_log
from replant.offline import FitResult, fit
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
from replant.preprocess import Preprocess
from replant.replay import Replay
from replant.scaling import Scaling
from replant.structure import Structure
from replant.trace import Trace
from replant.transfer_function import TransferFunction
from replant.uncertainty import Uncertainty

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
