"""Identify continuous-time transfer functions while the plant runs.

>>> import replant as rp
>>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
"""

from replant.assessment import fit_percent
from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, MissingDependencyError, ReplantError
from replant.filters import StateVariableFilter
from replant.identifier import Identifier
from replant.logs import Log, read_log
from replant.offline import FitResult, fit
from replant.optimizers import AdaDelta, AdaGrad, Adam, AMSGrad, Gradient, IntegralCost, NAdam, RMSProp
from replant.preprocess import Preprocess
from replant.replay import Replay
from replant.scaling import Scaling
from replant.structure import Structure
from replant.trace import Trace
from replant.transfer_function import TransferFunction

__version__ = "0.1.0"

__all__ = [
    "AMSGrad",
    "AdaDelta",
    "AdaGrad",
    "Adam",
    "ArgumentTypeError",
    "FitResult",
    "Gradient",
    "Identifier",
    "IntegralCost",
    "InvalidArgumentError",
    "Log",
    "LogError",
    "MissingDependencyError",
    "NAdam",
    "Preprocess",
    "RMSProp",
    "ReplantError",
    "Replay",
    "Scaling",
    "StateVariableFilter",
    "Structure",
    "Trace",
    "TransferFunction",
    "__version__",
    "fit",
    "fit_percent",
    "read_log",
]
