"""Identify continuous-time transfer functions G(s) while the plant runs.

What most programs need, in this order; help(rp.fit) and so on says more:

    fit         G(s) of a whole record: fit(log, poles=1), or fit(u, y, dt, poles=1)
    run         the same record sample by sample, as if the plant ran
    Identifier  one sample at a time: update(u, y), then model and assess()
    Model       what is kept: G(s) with uncertainty and verdict; step(), bode(), simulate(u), validate(log), save(path)
    search      the numbers of poles and zeros and the dead time with the most evidence
    compare     several models over one record
    read_log    a record from a file: csv, mat, parquet and more; Log of arrays; examples.motor() for a first try
    bandpass, decimate, detrend, from_rest, leave_out, resample    a record conditioned before it is identified
    load_model, load    what Model.save and Identifier.save have written
    fleet       models of many rigs; those that are odd, those that drift

>>> import replant as rp
>>> log = rp.examples.motor()
>>> fitted = rp.fit(log, poles=1, delay=0.01)
>>> print(fitted.transfer_function, fitted.verdict.status)
3741 / (s + 2.308) exp(-0.01 s) trusted
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from replant.public import *  # noqa: F403 - their names are listed below

__version__ = "0.1.0"

#: Where each public name is: the module is imported when the name is first used.
_PLACES = {
    "examples": "replant.examples",
    "fleet": "replant.fleet",
    "rigs": "replant.rigs",
    "signals": "replant.signals",
    "ArgumentTypeError": "replant.errors",
    "CheckpointError": "replant.errors",
    "DamagedCheckpointError": "replant.errors",
    "InUseError": "replant.errors",
    "InvalidArgumentError": "replant.errors",
    "LogError": "replant.errors",
    "MissingCheckpointError": "replant.errors",
    "MissingDependencyError": "replant.errors",
    "ModelFileError": "replant.errors",
    "ReplantError": "replant.errors",
    "SystemRefusedError": "replant.errors",
    "UnsupportedDependencyError": "replant.errors",
    "RefinedFilter": "replant.estimation.filters",
    "StateVariableFilter": "replant.estimation.filters",
    "AdaDelta": "replant.estimation.optimizers",
    "AdaGrad": "replant.estimation.optimizers",
    "Adam": "replant.estimation.optimizers",
    "AMSGrad": "replant.estimation.optimizers",
    "Gradient": "replant.estimation.optimizers",
    "IntegralCost": "replant.estimation.optimizers",
    "KalmanTracking": "replant.estimation.optimizers",
    "NAdam": "replant.estimation.optimizers",
    "RecursiveLeastSquares": "replant.estimation.optimizers",
    "RMSProp": "replant.estimation.optimizers",
    "Replay": "replant.estimation.optimizers.optimizer",
    "Scaling": "replant.estimation.settings",
    "fit": "replant.fitting.fit",
    "FitResult": "replant.fitting.fit_result",
    "load_model": "replant.fitting.several_outputs",
    "MatrixFit": "replant.fitting.several_outputs",
    "MatrixModel": "replant.fitting.several_outputs",
    "Model": "replant.fitting.model",
    "RowFit": "replant.fitting.miso_fit",
    "RowModel": "replant.fitting.miso_model",
    "search": "replant.fitting.structure_search",
    "Validation": "replant.fitting.validation",
    "Log": "replant.logs",
    "read_log": "replant.logs",
    "bandpass": "replant.logs.filtering",
    "decimate": "replant.logs.filtering",
    "detrend": "replant.logs.conditioning",
    "from_rest": "replant.logs.conditioning",
    "leave_out": "replant.logs.conditioning",
    "resample": "replant.logs.filtering",
    "NoiseModel": "replant.model.noise",
    "Preprocess": "replant.model.preprocess",
    "Structure": "replant.model.structure",
    "TransferFunction": "replant.model.transfer_function",
    "Uncertainty": "replant.model.uncertainty",
    "Ensemble": "replant.online.ensemble",
    "Identifier": "replant.online.identifier",
    "load": "replant.online.resume",
    "run": "replant.online.runs.run_log",
    "Trace": "replant.online.trace",
    "figures": "replant.report.figures",
    "compare": "replant.report.compared_page",
    "ModelComparison": "replant.report.compared_page",
    "fit_percent": "replant.verdict",
}

__all__ = sorted(["__version__", *_PLACES])


def __getattr__(name: str) -> Any:
    """Return a public name; its module is imported at its first use, and of the others those that this one needs."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_PLACES[name])
    globals()[name] = getattr(module, name, module)  # some names are modules themselves
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
