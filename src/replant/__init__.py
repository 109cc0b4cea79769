"""Identify continuous-time transfer functions while the plant runs.

>>> import replant as rp
>>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from replant.public import *  # noqa: F403 - their names are listed below

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
    "InUseError",
    "IntegralCost",
    "InvalidArgumentError",
    "KalmanTracking",
    "Log",
    "LogError",
    "MissingCheckpointError",
    "MissingDependencyError",
    "Model",
    "ModelComparison",
    "ModelFileError",
    "NAdam",
    "NoiseModel",
    "Preprocess",
    "RMSProp",
    "RecursiveLeastSquares",
    "RefinedFilter",
    "ReplantError",
    "Replay",
    "Scaling",
    "StateVariableFilter",
    "Structure",
    "SystemRefusedError",
    "Trace",
    "TransferFunction",
    "Uncertainty",
    "UnsupportedDependencyError",
    "Validation",
    "__version__",
    "bandpass",
    "compare",
    "decimate",
    "detrend",
    "examples",
    "figures",
    "fit",
    "fit_percent",
    "fleet",
    "from_rest",
    "load",
    "load_model",
    "read_log",
    "resample",
    "run",
    "search",
]


def __getattr__(name: str) -> Any:
    """Return a public name; the first use of one imports all of them, which `replant --help` thus does not."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from replant import public

    globals().update({known: getattr(public, known) for known in __all__ if known != "__version__"})
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
