"""Interoperation with other libraries: data frames, systems, units, and their names for our arguments."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, needs, shown
from replant.numerics.arguments import FloatArray, array_of_reals, coefficients
from replant.numerics.limits import duration

_INDEX = r"[\d\s:,]+[\])]"  # the index of a MATLAB column, as in data.y[:,0], is no unit
_UNIT = rf"\s*[\[(](?!{_INDEX})([^\[\]()]+)[\])]\s*$"


def unit_of(label: str) -> str:
    """Return the unit in brackets at the end of a label; an empty string if there is none."""
    found = re.search(_UNIT, label)
    return found[1].strip() if found else ""


def without_unit(label: str) -> str:
    """Return a label without its unit."""
    return re.sub(_UNIT, "", label)


def trace_frame(
    names: Sequence[str], parameters: FloatArray, errors: FloatArray, dt: float | None, time: FloatArray | None = None
) -> Any:
    """Return the estimate and the error of each sample as a `pandas.DataFrame`."""
    along, clock = _along(errors.size, dt, time)
    frame = _library("pandas").DataFrame(parameters, columns=list(names), index=_index(along, clock), copy=True)
    frame["error"] = errors
    frame.attrs = {**_sampling(dt), "units": {**parameter_units(names), "error": "y"}}
    return frame


def trace_dataset(
    names: Sequence[str], parameters: FloatArray, errors: FloatArray, dt: float | None, time: FloatArray | None = None
) -> Any:
    """Return the estimate and the error of each sample as an `xarray.Dataset`."""
    along, clock = _along(errors.size, dt, time)
    return _library("xarray").Dataset(
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


Signals = Mapping[str, tuple[str, FloatArray]]  # column name and samples of each role in a log
Others = Mapping[str, FloatArray]  # the other columns of a log


def log_frame(signals: Signals, others: Others, time: FloatArray | None, about: Mapping[str, Any]) -> Any:
    """Return a log as a `pandas.DataFrame`, with ``about`` (which has ``dt``), roles and units as its attributes."""
    columns = [*signals.items(), *(("another column", one) for one in others.items())]
    names = [name for _, (name, _) in columns]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        both = " and ".join(role for role, (name, _) in columns if name == twice)
        raise InvalidArgumentError(f"{both} are both named {twice!r}: give them different names")
    clock = _clock(columns[0][1][1].size, about["dt"]) if time is None else time
    frame = _library("pandas").DataFrame(dict(each for _, each in columns), index=_index("time", clock))
    roles = {role: name for role, (name, _) in signals.items()}
    frame.attrs = {**about, **roles, "units": {name: unit_of(name) for name in names if unit_of(name)}}
    return frame


def log_dataset(signals: Signals, others: Others, time: FloatArray | None, about: Mapping[str, Any]) -> Any:
    """Return a log as an `xarray.Dataset`, with variables named after the roles and the other columns."""
    taken = next((name for name in others if name in {*signals, "time"}), None)
    if taken is not None:
        raise InvalidArgumentError(f"another column is named {taken!r}, a name that the dataset uses itself: rename it")
    clock = _clock(signals["input"][1].size, about["dt"]) if time is None else time
    described = {
        key: (("time",), samples.copy(), {"long_name": without_unit(name), "units": unit_of(name)})
        for key, (name, samples) in {**signals, **{name: (name, each) for name, each in others.items()}}.items()
    }
    return _library("xarray").Dataset(described, coords={"time": _axis("time", clock.copy())}, attrs=dict(about))


def parameter_units(names: Sequence[str]) -> dict[str, str]:
    """Return the unit of each parameter, in terms of the unit y of the output and u, or the name, of its input."""
    units = {}
    for name in names:
        parameter, _, given = name.partition(".")  # with several inputs, as in b0.u1
        if parameter == "bias":
            units[name] = "y"
            continue
        poles = sum(each.startswith("a") and each.partition(".")[2] == given for each in names)
        order = poles - int(parameter[1:])
        seconds = "" if order == 0 else "/s" if order == 1 else f"/s^{order}"
        units[name] = f"1{seconds}" if parameter[0] == "a" else f"y/{given or 'u'}{seconds}"
    return units


def _along(samples: int, dt: float | None, time: FloatArray | None) -> tuple[str, FloatArray]:
    """Return the name of a trace's first axis, and its values."""
    if dt is None and time is not None:
        return "time", time.copy()
    return "sample" if dt is None else "time", _clock(samples, dt)


def _clock(samples: int, dt: float | None) -> Any:
    """Return the time of each sample in s, starting at 0; without ``dt`` the number of the sample."""
    return np.arange(samples) if dt is None else duration("dt", dt) * np.arange(samples)


def _index(name: str, values: Any) -> Any:
    return _library("pandas").Index(values, name=f"{name} [s]" if name == "time" else name)


def _axis(name: str, values: Any) -> tuple[str, Any, dict[str, str]]:
    return (
        name,
        values,
        {"long_name": "time", "units": "s"} if name == "time" else {"long_name": "number of the sample"},
    )


def _sampling(dt: float | None) -> dict[str, float]:
    return {} if dt is None else {"dt": float(dt)}


def _library(name: str) -> Any:
    with needs(f"to_{name} needs {name}", "frames"):
        return import_module(name)


P = ParamSpec("P")
R = TypeVar("R")

POLES = "poles=2 is the number of poles"
ZEROS = "zeros=1 is the number of zeros"
DELAY = "delay=0.2 is the dead time in s, samples times dt"
CLOCK = "dt=0.1 is the sampling time in s"
SEARCH = "search(log, poles=range(1, 4)) chooses the structure"
REST = "the initial state is estimated; fit(rp.from_rest(log), ...) takes it as at rest"
LOG = "fit(u, y, dt, poles=2), or fit(frame, input='u', output='y', poles=2)"

#: Names of arguments in MATLAB and CONTSID, SIPPY, SysIdentPy and python-control, and what to write instead.
WORDS = {
    **dict.fromkeys(("na", "np", "nf", "n", "order", "ylag", "n_poles", "na_ord", "ss_order"), POLES),
    **dict.fromkeys(("nz", "n_zeros"), ZEROS),
    **dict.fromkeys(("nb", "xlag", "nb_ord"), f"{ZEROS}, one less than nb, the number of coefficients"),
    **dict.fromkeys(("nk", "theta", "iodelay", "ioDelay", "InputDelay", "Td", "deadtime", "dead_time"), DELAY),
    **dict.fromkeys(("Ts", "ts", "T", "tsample", "sampling_time", "sample_time"), CLOCK),
    **dict.fromkeys(("fs", "Fs", "rate"), f"{CLOCK}, 1 / fs"),
    **dict.fromkeys(("nc", "nd"), "the noise model needs no order: it is chosen by the method"),
    **dict.fromkeys(("na_range", "order_range", "IC", "nanbnk"), SEARCH),
    **dict.fromkeys(("x0", "InitialState", "InitialCondition", "initial_state"), REST),
    **dict.fromkeys(("IO", "X", "data", "df"), LOG),
}


def in_our_words(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that an unknown argument is answered with the one to use instead."""
    known = tuple(name for name in inspect.signature(function).parameters if name != "self")

    @functools.wraps(function)
    def checked(*arguments: P.args, **named: P.kwargs) -> R:
        unknown = next((name for name in named if name not in known), None)
        if unknown is not None:
            raise ArgumentTypeError(f"there is no argument {shown(unknown)}: {_answer(unknown, known)}")
        return function(*arguments, **named)

    return checked


def _answer(name: str, known: tuple[str, ...]) -> str:
    """Return what to write instead of an unknown argument."""
    if name in WORDS:
        return WORDS[name]
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]}?" if near else f"the arguments are {', '.join(known)}"


Polynomials = tuple[FloatArray, FloatArray]


def of_control(system: Any) -> Polynomials:
    """Return num and den of a `control.TransferFunction` or `control.StateSpace`."""
    with needs("from_control needs python-control", "control"):
        import control
    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise ArgumentTypeError(
            f"system must be a control.TransferFunction or control.StateSpace, got {type(system).__name__}"
        )
    _check_single(system.ninputs, system.noutputs)
    if system.dt:  # None: the system's time is unspecified
        _refuse_discrete(system.dt)
    if isinstance(system, control.StateSpace):
        return of_state_space(system.A, system.B, system.C, system.D)
    return _proper(system.num[0][0], system.den[0][0])


def control_matrix(rows: Sequence[Sequence[Any]]) -> Any:
    """Join rows of `control.TransferFunction` systems, one row for each output, to one system of several inputs."""
    import control

    parts = [[[getattr(g, part)[0][0] for g in row] for row in rows] for part in ("num", "den")]
    return control.TransferFunction(*parts)


def of_scipy(system: Any) -> Polynomials:
    """Return num and den of a system of `scipy.signal`: TransferFunction, ZerosPolesGain or StateSpace."""
    from scipy import signal

    if not isinstance(system, signal.TransferFunction | signal.ZerosPolesGain | signal.StateSpace):
        raise ArgumentTypeError(
            "system must be a TransferFunction, ZerosPolesGain or StateSpace of scipy.signal, "
            f"got {type(system).__name__}"
        )
    if system.dt is not None:
        _refuse_discrete(system.dt)
    if isinstance(system, signal.StateSpace):
        _check_single(system.B.shape[1], system.C.shape[0])
        return of_state_space(system.A, system.B, system.C, system.D)
    if isinstance(system, signal.ZerosPolesGain):
        _check_single(1, np.atleast_2d(system.zeros).shape[0])
        return _proper(*signal.zpk2tf(system.zeros, system.poles, system.gain))
    num = np.atleast_2d(system.num)
    _check_single(1, num.shape[0])
    return _proper(num[0], system.den)


def of_state_space(a: Any, b: Any, c: Any, d: Any) -> Polynomials:
    """Return num and den of a state-space model with one input and one output."""
    a, b, c, d = (array_of_reals(name, value) for name, value in zip("ABCD", (a, b, c, d), strict=True))
    if a.size == 0:
        return d.reshape(-1)[:1], np.ones(1)
    from scipy.signal import ss2tf

    # ss2tf leaves rounding errors in leading coefficients that should be zero; the first non-zero coefficient has the
    # index of the first non-zero Markov parameter, h_0 = D, h_k = C A^(k-1) B
    num, den = ss2tf(a, b, c, d)
    num = np.array(num[0], np.float64)
    markov, bound, column, reach = d.item(), abs(d.item()), b, np.abs(b)
    for k in range(num.size):
        if abs(markov) > 100 * num.size * np.finfo(np.float64).eps * bound:
            break
        num[k] = 0.0
        markov, bound = (c @ column).item(), (np.abs(c) @ reach).item()
        column, reach = a @ column, np.abs(a) @ reach
    return num, np.asarray(den, np.float64)


def _proper(num: Any, den: Any) -> Polynomials:
    """Return numerator and denominator, after a check that they are real and form a proper fraction."""
    num, den = coefficients("num", np.real_if_close(num)), coefficients("den", np.real_if_close(den))
    above, below = (np.trim_zeros(polynomial, "f").size - 1 for polynomial in (num, den))
    if above > below:
        raise InvalidArgumentError(
            f"the system is improper, its numerator has order {above} and its denominator order {below}: "
            "add the poles that the plant has at high frequency"
        )
    return num, den


def _check_single(inputs: int, outputs: int) -> None:
    if (inputs, outputs) != (1, 1):
        raise InvalidArgumentError(
            f"the system must have one input and one output, got {inputs} and {outputs}: choose one of each"
        )


def _refuse_discrete(dt: Any) -> None:
    step = "" if dt is True else f" (dt = {float(dt):g} s)"
    raise InvalidArgumentError(f"the system is in discrete time{step}: give a system in continuous time")
