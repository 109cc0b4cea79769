"""Identify continuous-time transfer functions G(s) while the plant runs.

What most programs need, in this order; help(rp.fit) and so on says more:

    fit         G(s) of a whole record: fit(log, poles=1), or fit(u, y, dt, poles=1)
    run         the same record sample by sample, as if the plant ran
    Identifier  one sample at a time: update(u, y), then model and assess()
    Model       what is kept: G(s) with uncertainty and verdict; step(), bode(), simulate(u), validate(log), save(path)
    search      the numbers of poles and zeros and the dead time with the most evidence
    compare     several models over one record
    read_log    a record from a file: csv, mat, parquet and more; Log of arrays; examples.motor() for a first try
    bandpass, decimate, detrend, from_rest, resample    a record conditioned before it is identified
    load_model, load    what Model.save and Identifier.save have written
    fleet       models of many rigs; those that are odd, those that drift

>>> import replant as rp
>>> log = rp.examples.motor()
>>> fitted = rp.fit(log, poles=1, delay=0.01)
>>> print(fitted.transfer_function, fitted.verdict.status)
3721 / (s + 2.23) exp(-0.01 s) trusted
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
    "MatrixFit",
    "MatrixModel",
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
    "RowFit",
    "RowModel",
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
