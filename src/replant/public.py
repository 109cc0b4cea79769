"""The public names of `replant`, for type checkers; at run time the table in `replant` says where each one is."""

from replant.verdict import fit_percent as fit_percent
from replant.online.resume import load as load
from replant.online.ensemble import Ensemble as Ensemble
from replant.errors import (
    ArgumentTypeError as ArgumentTypeError,
    CheckpointError as CheckpointError,
    DamagedCheckpointError as DamagedCheckpointError,
    InUseError as InUseError,
    InvalidArgumentError as InvalidArgumentError,
    LogError as LogError,
    MissingCheckpointError as MissingCheckpointError,
    MissingDependencyError as MissingDependencyError,
    ModelFileError as ModelFileError,
    ReplantError as ReplantError,
    SystemRefusedError as SystemRefusedError,
    UnsupportedDependencyError as UnsupportedDependencyError,
)
from replant.estimation.filters import RefinedFilter as RefinedFilter, StateVariableFilter as StateVariableFilter
from replant.online.identifier import Identifier as Identifier
from replant.logs.filtering import bandpass as bandpass, decimate as decimate, resample as resample
from replant.logs.conditioning import detrend as detrend, from_rest as from_rest, leave_out as leave_out
from replant.logs import Log as Log, read_log as read_log
from replant.fitting.model import Model as Model
from replant.fitting.several_outputs import MatrixFit as MatrixFit, MatrixModel as MatrixModel, load_model as load_model
from replant.fitting.miso_model import RowModel as RowModel
from replant.fitting.validation import Validation as Validation
from replant.fitting.fit import fit as fit
from replant.fitting.miso_fit import RowFit as RowFit
from replant.fitting.fit_result import FitResult as FitResult
from replant.estimation.optimizers import (
    AdaDelta as AdaDelta,
    AdaGrad as AdaGrad,
    Adam as Adam,
    AMSGrad as AMSGrad,
    Gradient as Gradient,
    IntegralCost as IntegralCost,
    KalmanTracking as KalmanTracking,
    NAdam as NAdam,
    RecursiveLeastSquares as RecursiveLeastSquares,
    RMSProp as RMSProp,
)
from replant.model.preprocess import Preprocess as Preprocess
from replant.model.noise import NoiseModel as NoiseModel
from replant.estimation.optimizers.optimizer import Replay as Replay
from replant.estimation.settings import Scaling as Scaling
from replant.model.structure import Structure as Structure
from replant.online.trace import Trace as Trace
from replant.model.transfer_function import TransferFunction as TransferFunction
from replant.model.uncertainty import Uncertainty as Uncertainty
from replant.fitting.structure_search import search as search
from replant.report import figures as figures
from replant.report.compared_page import ModelComparison as ModelComparison, compare as compare
from replant.online.runs.run_log import run as run
from replant import examples as examples
from replant import fleet as fleet
from replant import rigs as rigs
from replant import signals as signals
