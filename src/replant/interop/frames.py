"""Frames: traces and logs as tables of pandas and datasets of xarray, which are imported when they are needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.interop.units import unit_of, without_unit
from replant.limits import duration


def trace_frame(
    names: Sequence[str], parameters: FloatArray, errors: FloatArray, dt: float | None, time: FloatArray | None = None
) -> Any:
    """Return the estimate and the error of each sample as a `pandas.DataFrame`.

    >>> trace_frame(["a0"], np.array([[0.0], [0.5]]), np.array([1.0, 0.1]), dt=0.1)
               a0  error
    time [s]
    0.0       0.0    1.0
    0.1       0.5    0.1
    """
    along, clock = _along(errors.size, dt, time)
    index = _index(along, clock)
    frame = _pandas().DataFrame(parameters, columns=list(names), index=index, copy=True)
    frame["error"] = errors
    frame.attrs = {**_sampling(dt), "units": {**parameter_units(names), "error": "y"}}
    return frame


def trace_dataset(
    names: Sequence[str], parameters: FloatArray, errors: FloatArray, dt: float | None, time: FloatArray | None = None
) -> Any:
    """Return the estimate and the error of each sample as an `xarray.Dataset`.

    >>> dataset = trace_dataset(["a0"], np.array([[0.0], [0.5]]), np.array([1.0, 0.1]), dt=0.1)
    >>> dict(dataset.sizes)
    {'time': 2, 'parameter': 1}
    """
    along, clock = _along(errors.size, dt, time)
    return _xarray().Dataset(
        {
            "parameters": ((along, "parameter"), parameters.copy(), {"long_name": "estimate after the sample"}),
            "errors": ((along,), errors.copy(), {"long_name": "a-priori output error", "units": "y"}),
        },
        coords={
            along: _axis(along, clock),
            "parameter": list(names),
            "unit": ("parameter", list(parameter_units(names).values())),
        },
        attrs=_sampling(dt),
    )


def log_frame(signals: Mapping[str, tuple[str, FloatArray]], time: FloatArray | None, dt: float, source: str) -> Any:
    """Return a log as a `pandas.DataFrame`.

    >>> signals = {"input": ("u", np.zeros(2)), "output": ("y [rpm]", np.ones(2))}
    >>> log_frame(signals, None, 0.5, "log.csv").attrs["units"]
    {'y [rpm]': 'rpm'}
    """
    names = [name for name, _ in signals.values()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        both = " and ".join(role for role, (name, _) in signals.items() if name == twice)
        raise InvalidArgumentError(f"{both} are both named {twice!r}: give them names of their own")
    clock = _clock(next(iter(signals.values()))[1].size, dt) if time is None else time
    frame = _pandas().DataFrame(dict(signals.values()), index=_index("time", clock))
    frame.attrs = {
        **_sampling(dt),
        **{role: name for role, (name, _) in signals.items()},
        "units": {name: unit_of(name) for name in names if unit_of(name)},
        "source": source,
    }
    return frame


def log_dataset(signals: Mapping[str, tuple[str, FloatArray]], time: FloatArray | None, dt: float, source: str) -> Any:
    """Return a log as an `xarray.Dataset`, whose variables have the names of the roles.

    >>> signals = {"input": ("u", np.zeros(2)), "output": ("y", np.ones(2))}
    >>> list(log_dataset(signals, None, 0.5, "log.csv"))
    ['input', 'output']
    """
    clock = _clock(next(iter(signals.values()))[1].size, dt) if time is None else time
    described = {
        role: (("time",), samples.copy(), {"long_name": without_unit(name), "units": unit_of(name)})
        for role, (name, samples) in signals.items()
    }
    return _xarray().Dataset(
        described, coords={"time": _axis("time", clock.copy())}, attrs={**_sampling(dt), "source": source}
    )


def parameter_units(names: Sequence[str]) -> dict[str, str]:
    """Return the unit of each parameter, in terms of the units y of the output and u of the input.

    Examples
    --------
    >>> parameter_units(["a1", "a0", "b0", "bias"])
    {'a1': '1/s', 'a0': '1/s^2', 'b0': 'y/u/s^2', 'bias': 'y'}
    """
    poles = sum(name.startswith("a") for name in names)
    units = {}
    for name in names:
        if name == "bias":
            units[name] = "y"
            continue
        order = poles - int(name[1:])
        seconds = "" if order == 0 else "/s" if order == 1 else f"/s^{order}"
        units[name] = f"1{seconds}" if name[0] == "a" else f"y/u{seconds}"
    return units


def _along(samples: int, dt: float | None, time: FloatArray | None) -> tuple[str, FloatArray]:
    """Return the name of a trace's first axis, and its values."""
    if dt is None and time is not None:
        return "time", time.copy()
    return "sample" if dt is None else "time", _clock(samples, dt)


def _clock(samples: int, dt: float | None) -> Any:
    """Return the time of each sample in s, starting at 0; without ``dt`` the sample's number."""
    return np.arange(samples) if dt is None else duration("dt", dt) * np.arange(samples)


def _index(name: str, values: Any) -> Any:
    return _pandas().Index(values, name=f"{name} [s]" if name == "time" else name)


def _axis(name: str, values: Any) -> tuple[str, Any, dict[str, str]]:
    return (
        name,
        values,
        {"long_name": "time", "units": "s"} if name == "time" else {"long_name": "number of the sample"},
    )


def _sampling(dt: float | None) -> dict[str, float]:
    return {} if dt is None else {"dt": float(dt)}


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as cause:
        raise MissingDependencyError("to_pandas needs pandas: pip install 'replant[frames]'") from cause
    return pandas


def _xarray() -> Any:
    try:
        import xarray
    except ImportError as cause:
        raise MissingDependencyError("to_xarray needs xarray: pip install 'replant[frames]'") from cause
    return xarray
