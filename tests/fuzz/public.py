"""The public API as a list of calls, each with ordinary arguments: every name of `replant.__all__` and every method."""

from __future__ import annotations

import functools
import inspect
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant import rigs, signals
from replant.fitting.model_fields import Provenance
from replant.sklearn import TransferFunctionRegressor
from support.builders import identifier, record

DT, SAMPLES = 0.1, 300
PLANT = rp.TransferFunction([2.0], [1.0, 0.5])
U, Y = record(PLANT, 1, SAMPLES, DT, noise=0.01)
TWO = np.column_stack([U, np.roll(U, 7)])
T = DT * np.arange(SAMPLES) + 0.01 * np.sin(np.arange(SAMPLES))
LOG = rp.Log(U, Y, DT, None, "u [V]", "y", Path("log.csv"))
PAIR = [[1e-4, 0.0], [0.0, 1e-4]]
NOISE = rp.NoiseModel([1.0, -0.5], 1e-4, 2e-4, DT)
MODEL_FIELDS: dict[str, Any] = {
    "structure": rp.Structure(1), "parameters": [0.5, 2.0], "dt": DT, "covariance": PAIR, "noise": NOISE,
    "input_hold": "zoh", "input_map": "identity", "input_level": 1.0, "output_level": 2.0, "input_name": "u [V]",
    "output_name": "y", "simulated_fit": 90.0, "one_step_fit": 95.0, "rejected": (("outlier", 3),),
    "provenance": Provenance("given", date="2026-01-01"),
}  # fmt: skip

ROW: dict[str, Any] = {
    "structures": (rp.Structure(1), rp.Structure(1)), "parameters": [0.5, 2.0, 3.0, 4.0], "dt": DT, "noise": NOISE,
    "covariance": np.eye(4).tolist(), "input_names": ("a", "b"), "input_levels": [1.0, 2.0], "output_level": 3.0,
}  # fmt: skip

Call = tuple[Callable[..., Any], dict[str, Any]]


@functools.cache
def folder() -> Path:
    """A folder with a log, a fleet of two rigs, a model and a checkpoint."""
    root = Path(tempfile.mkdtemp(prefix="replant-calls-"))
    (root / "rigs").mkdir()
    for name in ("a", "b"):
        np.savez(root / "rigs" / f"{name}.npz", t=DT * np.arange(SAMPLES), u=U, y=Y)
    np.savetxt(
        root / "log.csv", np.column_stack([DT * np.arange(SAMPLES), U, Y]), "%.6g", ",", header="t,u,y", comments=""
    )
    model().save(root / "model.json")
    identifier().save(root / "state.replant")
    return root


@functools.cache
def fitted() -> rp.FitResult:
    return rp.fit(U, Y, DT, poles=1)


@functools.cache
def row() -> rp.RowFit:
    return rp.fit(TWO, Y, DT, poles=(1, 1))


@functools.cache
def matrix() -> rp.MatrixModel:
    return rp.MatrixModel((row().model,))


@functools.cache
def online() -> Any:
    return rp.run(U, Y, DT, poles=1)


@functools.cache
def found() -> Any:
    return model().validate(U, Y).correlations


@functools.cache
def model() -> rp.Model:
    return rp.Model(**MODEL_FIELDS)


@functools.cache
def _learned(optimizer: str) -> rp.Identifier:
    ident = rp.Identifier(poles=1, dt=DT, optimizer=optimizer, startup=100)
    ident.update_many(U, Y)
    return ident


def ident() -> rp.Identifier:
    return _learned("auto").clone()


def fixed() -> rp.Identifier:
    return identifier(structure=rp.Structure(1), dt=DT)


def ensemble() -> rp.Ensemble:
    return rp.Ensemble(fixed(), 3)


def regressor() -> TransferFunctionRegressor:
    return TransferFunctionRegressor(poles=1, dt=DT).fit(U[:, None], Y)


RECORD = {"u": U, "y": Y, "dt": DT}
STRUCTURE = {"poles": 1, "zeros": 0, "delay": 0.2}
STEP = {"step_size": 0.01, "epsilon": 1e-8}
BETAS = {"beta1": 0.9, "beta2": 0.999}

#: How each class is made of ordinary arguments.
CLASSES: dict[Callable[..., Any], dict[str, Any]] = {
    rp.Structure: {"poles": 3, "zeros": 1, "delay": 0.2, "bias": True, "feedthrough": False},
    rp.Replay: {"capacity": 100, "batch_size": 7, "warmup": 3, "seed": 5},
    rp.NoiseModel: {"coefficients": [1.0, -0.5], "variance": 1.0, "residual_variance": 2.0, "dt": DT},
    rp.RowModel: ROW,
    rp.MatrixModel: {"rows": (rp.RowModel(**ROW),)},
    rp.Scaling: {"output": 2.0, "regressor": (1.0, 2.0, 3.0)},
    rp.Preprocess: {"input_map": "square", "input_offset": 2.0, "output_offset": 3.0},
    rp.StateVariableFilter: {"cutoff": 2.0, "method": "exact", "input_hold": "zoh", "alpha": 0.5},
    functools.partial(rp.StateVariableFilter): {"denominator": [1.0, 3.0, 2.0]},
    rp.RefinedFilter: {"input_hold": "foh"},
    rp.Gradient: {"gain": 2.0},
    rp.IntegralCost: {"gain": 2.0, "forgetting_rate": 1.0},
    **{kind: {**STEP, **BETAS} for kind in (rp.Adam, rp.AMSGrad, rp.NAdam)},
    rp.AdaGrad: STEP,
    **{kind: {**STEP, "rho": 0.9} for kind in (rp.RMSProp, rp.AdaDelta)},
    rp.RecursiveLeastSquares: {"forgetting_factor": 0.99, "initial_covariance": 100.0},
    functools.partial(rp.RecursiveLeastSquares): {"time_constant": 20.0},
    rp.KalmanTracking: {"process_noise": (1e-3, 1e-3), "noise_time_constant": 20.0, "initial_covariance": 100.0},
    rp.TransferFunction: {"num": [3.0, 2.0], "den": [1.0, 3.0, 2.0], "delay": 0.2},
    rp.Uncertainty: {"structure": rp.Structure(1), "parameters": [0.5, 2.0], "covariance": PAIR},
    rp.Identifier: {
        **STRUCTURE, "dt": DT, "filter": "auto", "scaling": "auto", "optimizer": "auto", "replay": "auto",
        "instruments": "auto", "normalize": True, "preprocess": rp.Preprocess(), "startup": 100, "history": 1000,
    },
    functools.partial(rp.Identifier): {"structure": rp.Structure(1), "dt": DT, "optimizer": "amsgrad", "startup": 50},
    identifier: {"structure": rp.Structure(1), "dt": DT, "optimizer": rp.Gradient(1.0)},
    rp.Ensemble: {"identifiers": fixed(), "members": 2, "n_jobs": 1},
    rp.Log: {
        "input": U, "output": Y, "dt": DT, "time": T, "input_name": "u [V]", "output_name": "y",
        "path": Path("log.csv"), "earlier": 3, "reference": U, "reference_name": "r", "begin": 0.0, "end": 9.0,
        "irregular": True, "input_hold": "zoh", "sha256": "",
    },
    rp.Model: MODEL_FIELDS,
    rigs.Rig: {
        "plant": PLANT, "dt": DT, "input_map": "identity", "input_rest": 1.0, "output_rest": 2.0, "noise": 0.1,
        "creep": 0.1,
    },
    TransferFunctionRegressor: {**STRUCTURE, "dt": DT, "method": "auto", "column": 0},
}  # fmt: skip

#: Functions, and methods of an object that is made anew for each call.
FUNCTIONS: dict[str, Callable[[], Call]] = {
    "signals.square": lambda: (signals.square, {"samples": 100, "period": 4.0, "dt": 1.0, "amplitude": 2.0}),
    "signals.prbs": lambda: (signals.prbs, {"samples": 100, "bits": 10, "hold": 3, "amplitude": 2.0, "seed": 5}),
    "signals.random_steps": lambda: (
        signals.random_steps, {"samples": 100, "shortest": 2, "longest": 20, "low": 1.0, "high": 2.0, "seed": 5}
    ),
    "signals.multisine": lambda: (
        signals.multisine, {"samples": 100, "dt": 1.0, "frequencies": [0.125, 0.25], "amplitude": 2.0}
    ),
    "signals.chirp": lambda: (
        signals.chirp, {"samples": 100, "dt": 1.0, "first": 1.0, "last": 2.0, "amplitude": 2.0}
    ),
    "signals.white_noise": lambda: (signals.white_noise, {"samples": 100, "rms": 2.0, "seed": 5}),
    "rigs.deap_rig": lambda: (rigs.deap_rig, {"noise": 1e-3, "creep": 0.1}),
    "rigs.motor_rig": lambda: (rigs.motor_rig, {"noise": 0.2}),
    "rigs.deap_voltage": lambda: (rigs.deap_voltage, {"samples": 100, "seed": 3}),
    "Rig.measure": lambda: (rigs.motor_rig().measure, {"u": U, "seed": 3}),
    "Rig.crept": lambda: (rigs.deap_rig(creep=0.1).crept, {"samples": 100}),
    "decimate": lambda: (rp.decimate, {"log": LOG, "factor": 2}),
    "bandpass": lambda: (rp.bandpass, {"log": LOG, "low": 0.5, "high": 2.0}),
    "detrend": lambda: (rp.detrend, {"log": LOG}),
    "from_rest": lambda: (rp.from_rest, {"log": LOG}),
    "leave_out": lambda: (rp.leave_out, {"log": LOG, "stretches": [(0.1, 0.3)], "use": [(0.0, 0.5)]}),
    "resample": lambda: (rp.resample, {"log": LOG, "dt": 0.15}),
    "fit": lambda: (rp.fit, {**RECORD, **STRUCTURE, "method": "auto", "t": T, "reference": U}),
    "fit by least squares": lambda: (
        rp.fit,
        {**RECORD, "structure": rp.Structure(1), "method": "least_squares", "filter": rp.StateVariableFilter(2.0)},
    ),
    "fit of a log": lambda: (rp.fit, {"u": LOG, "poles": 1}),
    "run": lambda: (rp.run, {**RECORD, **STRUCTURE, "optimizer": "auto", "t": T}),
    "search": lambda: (rp.search, {**RECORD, "poles": (1, 2), "zeros": (0,), "delays": (0.0, 0.1), "bias": False}),
    "fit_percent": lambda: (rp.fit_percent, {"measured": Y, "modelled": Y + 0.1}),
    "load": lambda: (rp.load, {"path": folder() / "state.replant"}),
    "load_model": lambda: (rp.load_model, {"path": folder() / "model.json"}),
    "read_log": lambda: (
        rp.read_log, {"path": folder() / "log.csv", "input": "u", "output": "y", "time": "t", "begin": 1.0, "end": 20.0}
    ),
    "read_log with dt": lambda: (rp.read_log, {"path": folder() / "log.csv", "input": 1, "output": 2, "dt": DT}),
    "examples.motor_step": lambda: (rp.examples.motor_step, {}),
    "fleet.fit": lambda: (
        rp.fleet.fit,
        {"logs": str(folder() / "rigs"), "by": "file", "input": "u", "output": "y", **STRUCTURE, "method": "fit",
         "executor": "threads:2", "dt": None, "time": "t", "begin": 0.0, "end": 20.0},
    ),
    "fleet.fit online": lambda: (
        rp.fleet.fit,
        {"logs": str(folder() / "rigs"), "by": "file", "input": "u", "output": "y", "poles": 1, "dt": DT,
         "optimizer": "auto"},
    ),
    "fleet.sweep": lambda: (
        rp.fleet.sweep,
        {"function": {"poles": [1, 2], "delay": [0.0]}, "records": [(U, Y, DT)], "executor": "threads:2"},
    ),
    "fleet.load": lambda: (rp.fleet.load, {"folder": folder()}),
    "Structure.wanted": lambda: (rp.Structure.wanted, {"structure": None, **STRUCTURE}),
    "Structure.transfer_function": lambda: (rp.Structure(1).transfer_function, {"parameters": [0.5, 2.0]}),
    "StateVariableFilter.discretize": lambda: (
        rp.StateVariableFilter(2.0).discretize, {"poles": 2, "dt": DT, "delay": 0.25}
    ),
    "StateVariableFilter.discretize by gbt": lambda: (
        rp.StateVariableFilter(2.0, method="gbt").discretize, {"poles": 2, "dt": DT, "delay": 0.25}
    ),
    "StateVariableFilter.polynomial": lambda: (rp.StateVariableFilter(2.0).polynomial, {"poles": 2}),
    "NoiseModel.spectrum": lambda: (NOISE.spectrum, {"frequency": [0.0, 1.0]}),
    "Uncertainty.response": lambda: (model().uncertainty.response, {"frequency": [0.1, 1.0]}),  # type: ignore[union-attr]
    "TransferFunction.response": lambda: (PLANT.response, {"frequency": [0.0, 1.0]}),
    "TransferFunction.simulate": lambda: (
        rp.TransferFunction([2.0], [1.0, 0.5], 0.25).simulate, {"u": U, "dt": DT, "input_hold": "foh"}
    ),
    "TransferFunction.free_responses": lambda: (PLANT.free_responses, {"samples": 10, "dt": DT}),
    "TransferFunction.from_control": lambda: (
        rp.TransferFunction.from_control, {"system": PLANT.to_control(), "delay": 0.1}
    ),
    "TransferFunction.from_scipy": lambda: (rp.TransferFunction.from_scipy, {"system": PLANT.to_scipy(), "delay": 0.1}),
    "TransferFunction.to_control": lambda: (rp.TransferFunction([2.0], [1.0, 1.0], 0.1).to_control, {"pade": 2}),
    "Preprocess.resolve": lambda: (rp.Preprocess("square", "first", "mean").resolve, {"u": U, "y": Y}),
    "Preprocess.map_input": lambda: (rp.Preprocess("square").map_input, {"u": U}),
    "Scaling.sigmas": lambda: (rp.Scaling(1.0, (1.0, 2.0)).sigmas, {"structure": rp.Structure(1)}),
    "Scaling.none": lambda: (rp.Scaling.none, {"structure": rp.Structure(1)}),
    "Identifier.update": lambda: (ident().update, {"u": 1.0, "y": 2.0, "t": 31.0}),
    "Identifier.update of a first sample": lambda: (
        rp.Identifier(poles=1, dt=DT).update, {"u": 1.0, "y": 2.0, "t": 3.0, "r": 1.0}
    ),
    "Identifier.update_many": lambda: (ident().update_many, {"u": U, "y": Y, "t": 30.0 + T}),
    "Identifier.update_many with a fixed filter": lambda: (fixed().update_many, {"u": U, "y": Y}),
    "Identifier.update_many of a first chunk": lambda: (
        rp.Identifier(poles=1, dt=DT, startup=100).update_many, {"u": U, "y": Y, "t": T, "r": U}
    ),
    "Identifier.save": lambda: (ident().save, {"path": folder() / "saved", "progress": {"sequence": 1}}),
    "Identifier.to_bytes": lambda: (ident().to_bytes, {"progress": {"sequence": 1}}),
    "Identifier.from_bytes": lambda: (rp.Identifier.from_bytes, {"data": fixed().to_bytes()}),
    "Ensemble.update": lambda: (ensemble().update, {"u": [1.0, 2.0, 3.0], "y": 2.0}),
    "Ensemble.update_many": lambda: (ensemble().update_many, {"u": U, "y": np.column_stack([Y, Y, Y])}),
    "Ensemble.trace": lambda: (ensemble().trace, {"u": U, "y": Y}),
    "Ensemble.member": lambda: (ensemble().member, {"number": 1}),
    "Model.simulate": lambda: (model().simulate, {"u": U, "t": T, "y": Y}),
    "Model.predict": lambda: (model().predict, {"u": U, "y": Y, "horizon": 3, "t": T}),
    "Model.of_log": lambda: (
        model().of_log, {"input_name": "u", "output_name": "y", "source": "log.csv", "sha256": "0"}
    ),
    "Model.step": lambda: (model().step, {"duration": 3.0}),
    "Model.impulse": lambda: (model().impulse, {"duration": 3.0}),
    "Model.bode": lambda: (model().bode, {"frequency": [0.1, 1.0]}),
    "Model.nyquist": lambda: (model().nyquist, {"frequency": [0.1, 1.0]}),
    "Model.plot": lambda: (model().plot, {"axes": None}),
    "Model.contributions": lambda: (model().contributions, {"u": U, "t": T}),
    "Model.linear_input": lambda: (model().linear_input, {"u": U}),
    "Model.validate": lambda: (model().validate, {"log": U, "y": Y, "t": T, "reference": U}),
    "Model.validate with a log": lambda: (model().validate, {"log": LOG}),
    "Model.score": lambda: (model().score, {"log": U, "y": Y, "t": T}),
    "Model.to_control": lambda: (model().to_control, {"pade": None}),
    "Model.from_json": lambda: (rp.Model.from_json, {"written": model().to_json()}),
    "Model.save": lambda: (model().save, {"path": folder() / "saved.json"}),
    "Validation.plot": lambda: (model().validate(U, Y).plot, {"axes": None}),
    "compare": lambda: (rp.compare, {"models": {"one": model()}, "log": LOG}),
    "ModelComparison.plot": lambda: (rp.compare([model()], LOG).plot, {"axes": None}),
    "Trace.index": lambda: (ensemble().trace(U, Y)[0].index, {"true": [0.5, 2.0]}),
    "Trace.to_pandas": lambda: (ensemble().trace(U, Y)[0].to_pandas, {"dt": DT}),
    "Trace.to_xarray": lambda: (ensemble().trace(U, Y)[0].to_xarray, {"dt": DT}),
    "fit of two inputs": lambda: (rp.fit, {"u": TWO, "y": Y, "dt": DT, "poles": (1, 1), "delay": (0.0, 0.1)}),
    "RowModel.of_input": lambda: (row().model.of_input, {"which": 1}),
    "RowModel.of_log": lambda: (
        row().model.of_log, {"input_names": ("a", "b"), "output_name": "y", "source": "log.csv", "sha256": ""},
    ),
    "RowModel.step": lambda: (row().model.step, {"duration": 3.0}),
    "RowModel.bode": lambda: (row().model.bode, {"frequency": [0.1, 1.0]}),
    "RowModel.simulate": lambda: (row().model.simulate, {"u": TWO, "t": T, "y": Y}),
    "RowModel.predict": lambda: (row().model.predict, {"u": TWO, "y": Y, "horizon": 3, "t": T}),
    "RowModel.score": lambda: (row().model.score, {"log": TWO, "y": Y, "t": T}),
    "RowModel.validate": lambda: (row().model.validate, {"log": TWO, "y": Y, "t": T}),
    "RowModel.to_control": lambda: (row().model.to_control, {"pade": 2}),
    "RowModel.to_json": lambda: (row().model.to_json, {}),
    "RowModel.from_json": lambda: (rp.RowModel.from_json, {"written": row().model.to_json()}),
    "RowModel.save": lambda: (row().model.save, {"path": folder() / "row.json"}),
    "RowModel.contributions": lambda: (row().model.contributions, {"u": TWO, "t": T}),
    "RowModel.plot": lambda: (row().model.plot, {"axes": None}),
    "search of two inputs": lambda: (
        rp.search, {"u": TWO, "y": Y, "dt": DT, "poles": (1,), "zeros": 0, "delays": (0.0, 0.1), "bias": False},
    ),
    "fit of two outputs": lambda: (rp.fit, {"u": U, "y": TWO, "dt": DT, "poles": 1, "delay": 0.1}),
    "run of two outputs": lambda: (rp.run, {"u": U, "y": TWO, "dt": DT, "poles": 1, "delay": 0.1}),
    "MatrixModel.of_output": lambda: (matrix().of_output, {"which": 0}),
    "MatrixModel.simulate": lambda: (matrix().simulate, {"u": TWO, "t": T}),
    "MatrixModel.validate": lambda: (matrix().validate, {"log": TWO, "y": Y[:, None], "t": T}),
    "MatrixModel.plot": lambda: (matrix().plot, {"axes": None}),
    "MatrixModel.to_control": lambda: (matrix().to_control, {"pade": 2}),
    "MatrixModel.to_json": lambda: (matrix().to_json, {}),
    "MatrixModel.from_json": lambda: (rp.MatrixModel.from_json, {"written": matrix().to_json()}),
    "MatrixModel.save": lambda: (matrix().save, {"path": folder() / "matrix.json"}),
    "FitResult.bridged": lambda: (fitted().bridged, {"y": Y}),
    "sklearn fit": lambda: (TransferFunctionRegressor(poles=1, dt=DT).fit, {"X": U[:, None], "y": Y}),
    "sklearn partial_fit": lambda: (TransferFunctionRegressor(poles=1, dt=DT).partial_fit, {"X": U[:, None], "y": Y}),
    "sklearn predict": lambda: (regressor().predict, {"X": U[:, None]}),
    "sklearn score": lambda: (regressor().score, {"X": U[:, None], "y": Y}),
    "sklearn fit_percent": lambda: (regressor().fit_percent, {"X": U[:, None], "y": Y}),
    "figures.draw_fit": lambda: (rp.figures.draw_fit, {"result": online(), "u": U, "y": Y, "dt": DT}),
    "figures.draw_correlations": lambda: (rp.figures.draw_correlations, {"found": found(), "dt": DT}),
    "figures.draw_bode": lambda: (rp.figures.draw_bode, {"result": online(), "dt": DT}),
    "figures.draw_transients": lambda: (
        rp.figures.draw_transients, {"result": online(), "dt": DT, "truth": [0.5, 2.0]}
    ),
    "figures.save_figures": lambda: (
        rp.figures.save_figures, {"folder": folder() / "figures", "result": online(), "u": U, "y": Y, "dt": DT}
    ),
}  # fmt: skip

#: Methods that the package calls, with arguments that are checked: those of optimizers and filters, and inner steps.
INNER = {
    "begins_with", "check", "memory", "settings", "suggested", "fixed_at", "of_slots", "from_record", "call_map",
    "output_row",
}  # fmt: skip


def classes() -> list[tuple[str, Callable[[], Call]]]:
    """Every class as a call, by name."""
    return [(_name(kind), lambda kind=kind, given=given: (kind, given)) for kind, given in CLASSES.items()]


def _name(kind: Any) -> str:
    return f"{kind.func.__name__} otherwise" if isinstance(kind, functools.partial) else str(kind.__name__)


def missing() -> Iterator[str]:
    """Every public name that takes arguments and that no call here is of."""
    for name in rp.__all__:
        thing = getattr(rp, name)
        if inspect.isclass(thing) and not issubclass(thing, Exception):
            if name not in RESULTS and thing not in CLASSES:
                yield name
            for method, function in inspect.getmembers(thing, callable):
                takes = method[0] != "_" and len(inspect.signature(function).parameters) > 0
                own = takes and set(inspect.signature(function).parameters) - {"self"}
                if own and method not in INNER and not _listed(f"{name}.{method}"):
                    yield f"{name}.{method}"
        elif callable(thing) and not inspect.isclass(thing) and not _listed(name):
            yield name
    for module in (rp.fleet, rp.figures, signals, rigs):
        for name, thing in inspect.getmembers(module, inspect.isfunction):
            public = thing.__module__.startswith("replant") and name in getattr(module, "__all__", dir(module))
            mine = thing.__module__ == module.__name__ or hasattr(module, "__all__")
            label = f"{module.__name__.rpartition('.')[2]}.{name}"
            if public and mine and not _listed(label) and name not in TAKE_RESULTS:
                yield label


#: Made by the package and never by a caller: their numbers are our own.
RESULTS = {"FitResult", "RowFit", "MatrixFit", "ModelComparison", "Trace", "Validation"}
#: Of these functions every argument is an object of ours, a file or axes.
TAKE_RESULTS = {
    "write_page", "draw_excitation", "draw_outputs", "draw_overlay", "draw_poles_and_zeros", "draw_responses",
    "draw_spectrum", "draw_step",
}  # fmt: skip


def _listed(name: str) -> bool:
    return any(known == name or known.startswith(f"{name} ") for known in FUNCTIONS)
